"""A descriptor that was kept open reaches the process that is started next, and only that one."""

import multiprocessing
import os
from pathlib import Path

from lfpipe.host import handover


def read_on(kept: handover.Kept, out: str) -> None:
    """In a child: goes on reading where the parent stopped."""
    kept.adopt()
    fd = handover.take("file")
    assert fd is not None and not os.get_inheritable(fd)
    Path(out).write_bytes(os.read(fd, 100))


def test_a_child_reads_on(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("first second")
    fd = os.open(tmp_path / "a", os.O_RDONLY)
    os.read(fd, 6)
    handover.keep("file", fd)
    child = multiprocessing.get_context("spawn").Process(target=read_on, args=(handover.Kept(), str(tmp_path / "out")))
    child.start()
    handover.release()
    assert handover.take("file") is None
    child.join()
    assert child.exitcode == 0 and (tmp_path / "out").read_text() == "second"


def test_what_is_kept_is_closed_when_another_takes_its_name() -> None:
    first, second = os.pipe()
    handover.keep("x", first)
    handover.keep("x", second)
    assert handover.take("x") == second
    os.close(second)
    try:
        os.fstat(first)
    except OSError:
        return
    raise AssertionError("still open")
