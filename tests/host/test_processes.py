"""A descriptor that was kept open reaches the process that is started next, and only that one."""

import multiprocessing
import os
from pathlib import Path

import pytest

from lfpipe.host import processes


def read_on(kept: processes.HandedOver, out: str) -> None:
    """In a child: goes on reading where the parent stopped."""
    kept.adopt()
    fd = processes.receive("file")
    assert fd is not None and not os.get_inheritable(fd)
    Path(out).write_bytes(os.read(fd, 100))


def test_a_child_reads_on(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("first second")
    fd = os.open(tmp_path / "a", os.O_RDONLY)
    os.read(fd, 6)
    processes.hand_over("file", fd)
    child = multiprocessing.get_context("spawn").Process(target=read_on, args=(processes.HandedOver(), str(tmp_path / "out")))
    child.start()
    processes.close_handed_over()
    assert processes.receive("file") is None
    child.join()
    assert child.exitcode == 0 and (tmp_path / "out").read_text() == "second"


def test_what_is_kept_is_closed_when_another_takes_its_name() -> None:
    first, second = os.pipe()
    processes.hand_over("x", first)
    processes.hand_over("x", second)
    assert processes.receive("x") == second
    os.close(second)
    with pytest.raises(OSError):
        os.fstat(first)
