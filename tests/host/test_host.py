"""What `host` does on every system: wake-ups, locks that end with their process, descriptors that pass to the next
one."""

import subprocess
import sys
from pathlib import Path

import pytest
import zmq

from lfpipe.host import file_lock, wake


def test_wakes_arrive_also_at_a_restarted_reader(tmp_path: Path) -> None:
    path = tmp_path / "wake"
    wake.make(path)
    assert path.stat().st_mode & 0o777 == 0o600

    def wakes(end: wake.Wake) -> bool:
        poller = zmq.Poller()
        poller.register(end.fd, zmq.POLLIN)
        return bool(poller.poll(60_000))

    writer = wake.Wake(path)
    writer.notify(1)  # nobody reads yet
    reader = wake.Wake(path)
    assert wakes(reader)
    reader.drain()
    for seq in range(1, 20_001):
        writer.notify(seq)  # more than fits: blocks nobody
    assert wakes(reader) and 0 < reader.drain() <= 20_000
    while reader.drain():
        pass
    reader.close()
    reader = wake.Wake(path)
    reader.drain()
    writer.notify(77)
    assert wakes(reader) and reader.drain() == 77
    reader.close()
    writer.close()


def test_a_lock_ends_with_its_process_and_follows_no_link(tmp_path: Path) -> None:
    path = tmp_path / "lock"
    code = "import sys, os; from pathlib import Path; from lfpipe.host.file_lock import take; "
    code += "print(take(Path(sys.argv[1])) is not None, flush=True); os._exit(0)"

    def taken_elsewhere() -> bool:
        done = subprocess.run([sys.executable, "-c", code, path], capture_output=True, text=True, check=True)
        return done.stdout.strip() == "True"

    assert taken_elsewhere() and not file_lock.is_held(path), "the dead hold nothing"
    lock = file_lock.take(path)
    assert lock is not None and file_lock.is_held(path) and lock.in_place()
    assert not taken_elsewhere()
    lock.release()
    (tmp_path / "link").symlink_to(path)
    with pytest.raises(OSError):
        file_lock.take(tmp_path / "link")
