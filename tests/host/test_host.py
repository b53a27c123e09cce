"""What `host` does on every system: wake-ups, locks that end with their process, the fence of machines that need one, and sums
that have the same bits under every Python."""

import ctypes
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import zmq
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.errors import UserError
from lfpipe.host import file_lock, machine, wake
from lfpipe.transport import ring


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


@pytest.fixture(autouse=True)
def forgotten() -> Iterator[None]:
    machine._full_fence.cache_clear()
    yield
    machine._full_fence.cache_clear()


def only(monkeypatch: pytest.MonkeyPatch, **libraries: Any) -> None:
    """The only libraries of this machine; "own" is the C library."""

    def load(name: str | None) -> Any:
        if (key := (name or "own").partition(".")[0]) not in libraries:
            raise OSError(f"{name}: cannot open shared object file")
        return libraries[key]

    monkeypatch.setattr(ctypes, "CDLL", load)


def test_the_fence_is_libatomic_s_or_the_c_library_s(monkeypatch: pytest.MonkeyPatch) -> None:
    called: list[object] = []
    barrier = SimpleNamespace(OSMemoryBarrier=lambda: called.append("own"))
    for libraries in ({"libatomic": SimpleNamespace(atomic_thread_fence=called.append), "own": barrier}, {"own": barrier}):
        machine._full_fence.cache_clear()
        only(monkeypatch, **libraries)
        machine._fence()
    assert called == [machine.SEQ_CST, "own"]


def test_a_machine_without_a_fence_is_refused_before_a_ring_exists(monkeypatch: pytest.MonkeyPatch) -> None:
    only(monkeypatch, own=SimpleNamespace())
    monkeypatch.setattr(ring, "fence", machine._fence)
    with pytest.raises(UserError, match="libatomic is not installed") as error:
        ring.create("lfpipe-test-no-fence", ring.RingSpec((4,), np.dtype("u1")))
    assert "libatomic1" in error.value.remedy
    monkeypatch.undo()
    with pytest.raises(FileNotFoundError):
        ring.Reader("lfpipe-test-no-fence")


def test_the_fence_of_this_machine_runs() -> None:
    try:
        machine._fence()
    except UserError as error:  # x86-64 needs none, and may have none
        assert "libatomic" in error.message


@given(st.lists(st.integers(-(2**40), 2**40), max_size=9))
def test_sums_have_the_same_bits_under_every_python(values: list[int]) -> None:
    assert machine.add(map(float, values)) == sum(values)
    assert machine.add([1e16, 1.0, -1e16]) == 0.0  # `sum` gives 1.0 from Python 3.12 on, 0.0 before
