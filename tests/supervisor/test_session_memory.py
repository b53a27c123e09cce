"""The memory of sessions: names follow the run directory; only dead segments of lfpipe are unlinked."""

import os
import shutil
import time
from pathlib import Path

import pytest

from lfpipe.host.segment import SHM_DIR
from lfpipe.supervisor import rundir
from lfpipe.transport.session import PREFIX, Session
from tests.supervisor.holder import Holder, gone, holding, inodes, remove

NOBODY = 65534


def test_a_session_of_the_same_name_elsewhere_leaves_a_living_one_alone(base: Path, name: str) -> None:
    other = base.parent / "other"
    other.mkdir()
    with holding(base, name) as first:
        before = inodes(first)
        with holding(other, name) as second:
            assert not set(first) & set(second)
        assert gone(second) and inodes(first) == before
    assert gone(first)


def test_the_same_directory_by_another_path_is_the_same_session(base: Path, name: str) -> None:
    link = base.parent / "link"
    link.symlink_to(base)
    with holding(link, name) as segments:
        assert [Session(name).segment(part) for part in ("status", "frames", "eyes")] == segments
        assert rundir.running() == [name]
        assert "is already running" in Holder(base, name).failed()


def test_a_reader_with_another_runtime_directory_finds_the_one_session_of_that_name(base: Path, name: str) -> None:
    others = [base.parent / "b", base.parent / "c"]
    for other in others:
        other.mkdir()
    with holding(others[0], name) as first:
        assert [Session(name).segment(part) for part in ("status", "frames", "eyes")] == first
        assert Session(f"{name}.2").segment("status") not in first
        with holding(others[1], name) as second:
            assert Session(name).segment("status") not in (*first, *second), "which of the two?"
        with holding(base, name) as own:
            assert Session(name).segment("status") == own[0]
    assert rundir.running() == []


def squat(path: Path, kind: str) -> None:
    """Something at path that is not a segment of ours."""
    if kind == "directory":
        path.mkdir()
    elif kind == "link":
        path.symlink_to("/dev/shm/target")
    else:
        path.write_bytes(bytes(8192))
    if kind == "file of another":
        os.chown(path, NOBODY, NOBODY)


KINDS = ["directory", "link", "zeros"] + (["file of another"] if os.getuid() == 0 else [])


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_not_ours_is_left_alone_in_shared_memory(base: Path, name: str, kind: str) -> None:
    """It is harmless unless a ring needs its name; then the message names it and the remedy works."""
    beside, within = (SHM_DIR / Session(name).segment(part) for part in ("x", "frames"))
    squat(beside, kind)
    try:
        with holding(base, name):
            pass
        squat(within, kind)
        before = [path.lstat()[:7] for path in (beside, within)]  # all but the times
        said = Holder(base, name).failed()
        assert str(within) in said and "remove" in said and "--session" in said
        with holding(base, f"{name}.2"):
            pass
        assert [path.lstat()[:7] for path in (beside, within)] == before
        remove(within)
        with holding(base, name):
            pass
    finally:
        for path in (beside, within):
            if path.exists() or path.is_symlink():
                remove(path)
    assert not list(base.iterdir())


def test_a_killed_session_is_swept_and_a_living_one_is_not(base: Path, name: str) -> None:
    killed = Holder(base, name)
    left = killed.ready()
    killed.kill()
    assert not gone(left), "nothing to sweep: this test shows nothing"
    with holding(base, f"{name}.2") as living:
        assert gone(left) and not gone(living)
        assert [path.name for path in base.iterdir()] == [f"{PREFIX}{name}.2"]


@pytest.mark.parametrize("how", ["removed", "base removed", "moved"])
def test_memory_whose_run_directory_is_gone_is_removed_once_its_session_is_dead(base: Path, name: str, how: str) -> None:
    """By whichever session of this user begins next, wherever its run directory is."""
    other = base.parent / "other"
    other.mkdir()
    holder = Holder(base, name)
    left = holder.ready()
    if how == "moved":
        (base / f"{PREFIX}{name}").rename(base.parent / "moved")
    else:
        shutil.rmtree(base if how == "base removed" else base / f"{PREFIX}{name}")
    with holding(other, "another"):
        assert not gone(left), "its session lives"
    holder.kill()
    with holding(other, "another"):
        assert gone(left)


def test_a_session_that_lost_its_run_directory_leaves_the_next_one_alone(base: Path, name: str) -> None:
    first = Holder(base, name)
    first.ready()
    shutil.rmtree(base / f"{PREFIX}{name}")
    second = Holder(base, name)  # waits for the first
    time.sleep(0.3)
    first.end()
    segments = second.ready()
    assert rundir.running() == [name] and not gone(segments)
    second.end()
    assert gone(segments) and not list(base.iterdir())
