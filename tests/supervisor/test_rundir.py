"""Run directories: locks, sweeps and losses, and what in them or in the environment is
refused with a remedy. And the
memory of sessions: names follow the run directory; only dead segments of lfpipe are unlinked.
"""

import contextlib
import os
import shutil
import stat
import sys
from pathlib import Path

import pytest
import zmq

from lfpipe.host.segment import SHM_DIR
from lfpipe.supervisor import rundir
from lfpipe.transport.session import PREFIX, Session, default_name, place_prefix
from tests.supervisor.holder import ROOT, Holder, gone, holding, remove, remove_lock
from tests.supervisor.states import made_state
from tests.support.processes import printed
from tests.support.refusal import refusal
from tests.support.world import stays


def test_lock_notices_a_removed_run_directory(base: Path, name: str) -> None:
    session = Session(name)
    lock = rundir.acquire(session)
    assert lock.in_place()
    remove_lock(session.run_dir)
    assert not lock.in_place(), "the lock is gone"
    session.run_dir.chmod(0o777)
    other = rundir.acquire(session)
    assert not lock.in_place() and stat.S_IMODE(session.run_dir.stat().st_mode) == 0o700
    rundir.release(session, lock)
    assert rundir.running() == [name], "it is another's now"
    (session.run_dir / "session.json").touch()
    remove_lock(session.run_dir)
    rundir.release(session, other)
    assert not list(base.iterdir()), "removed also without its lock"


LOOK = """
from lfpipe.supervisor import rundir
from lfpipe.host import segment
import sys
print(rundir.running(), rundir.find(sys.argv[1]).name)
rundir.sweep()
"""


def test_rundir_passes_over_entries_of_other_kinds(
    base: Path, name: str, as_nobody: list[str]
) -> None:
    words = ("lockdir", "locklink", "unreadable", "closed", "with folder", "a name", "file")
    lock_dir, lock_link, unreadable, closed, with_folder, odd_name, file = (
        base / f"{PREFIX}{word}" for word in words
    )
    for path in (lock_dir, lock_link, unreadable, closed, with_folder, odd_name):
        path.mkdir(mode=0o700)
    (lock_dir / "lock").mkdir()
    (lock_link / "lock").symlink_to("/nowhere/lock")
    (unreadable / "lock").touch(0o000)
    (with_folder / "folder").mkdir()
    (with_folder / "folder" / "file").touch()
    file.touch()
    closed.chmod(0)
    holder = Holder(base, name, *as_nobody)
    holder.ready()
    assert printed(*as_nobody, sys.executable, "-c", LOOK, name, cwd=ROOT) == f"['{name}'] {name}\n"
    rundir.sweep()
    assert rundir.running() == [name] and (lock_link / "lock").is_symlink(), (
        "a link is not followed"
    )
    holder.end()
    with contextlib.suppress(FileNotFoundError):  # root may have swept it
        closed.chmod(0o700)


@pytest.mark.parametrize(
    "kind", ["directory", pytest.param("link", marks=pytest.mark.native("a lock that is a file"))]
)
def test_rundir_names_a_lock_that_is_none(base: Path, name: str, kind: str) -> None:
    lock = Session(name).lock
    lock.parent.mkdir(mode=0o700)
    if kind == "directory":
        lock.mkdir()
    else:
        lock.symlink_to("/nowhere/lock")
    said = Holder(base, name).failed()
    assert str(lock) in said and "remove it" in said
    lock.rmdir() if kind == "directory" else lock.unlink()
    with holding(base, name):
        pass


def test_sweep_removes_all_of_a_dead_run_directory(base: Path, name: str, tmp_path: Path) -> None:
    """Also folders, and links without what they lead to."""
    kept = tmp_path / "kept"
    kept.mkdir()
    (kept / "file").touch()
    for session in (Session(name), Session(f"{name}.2")):
        (session.run_dir / "a" / "b").mkdir(parents=True)
        (session.run_dir / "a" / "b" / "file").touch()
        (session.run_dir / "link").symlink_to(kept)
    session.run_dir.parent.chmod(0o700)
    with holding(base, name):
        assert sorted(path.name for path in base.iterdir()) == [f"{PREFIX}{name}"]
        assert not (Session(name).run_dir / "a").exists()
    assert (kept / "file").exists() and not list(base.iterdir())


@pytest.mark.native("sockets with a path")
def test_acquire_refuses_a_path_too_long_for_sockets(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    need = zmq.IPC_PATH_MAX_LEN - len(f"/{PREFIX}ab/ctl")  # what a session of two letters leaves
    place = Path(f"{tmp_path}/".ljust(need, "y"))
    place.mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(place))
    long = refusal(rundir.acquire, Session("abc"))
    assert "a socket allows" in long.message
    assert "shorter --session" in long.remedy and "shorter XDG_RUNTIME_DIR" in long.remedy
    assert not list(place.iterdir())
    lock = rundir.acquire(Session("ab"))
    rundir.release(Session("ab"), lock)


def test_acquire_refuses_a_runtime_directory_that_cannot_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    for path in (
        "./run",
        "~/run",
        os.fsdecode(b"/tmp/\xff\xfe"),
        tmp_path / "missing",
        tmp_path / "file",
        "/" + "x" * 5000,
    ):
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(path))
        assert "XDG_RUNTIME_DIR" in str(refusal(rundir.acquire, Session("a"))), path
    assert sorted(tmp_path.iterdir()) == [tmp_path / "file"]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "..",
        "../x",
        "a/b",
        "a\n",
        "-a",
        "a b",
        "a" * 33,
        "é",
        "١",
        "a*",
        "a\0",
        "$(id)",
        "\udcff",
    ],
)
def test_session_refuses_a_name_that_cannot_be(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    refused = refusal(Session, text)
    assert repr(text) in refused.message and "1 to 32" in refused.remedy
    if text and "\0" not in text:
        monkeypatch.setenv("LFPIPE_SESSION", text)
        assert "LFPIPE_SESSION=" in str(refusal(default_name))


NOBODY = 65534


def test_session_by_another_path_is_the_same(base: Path, name: str) -> None:
    link = base.parent / "link"
    link.symlink_to(base)
    with holding(link, name) as segments:
        assert [Session(name).segment(part) for part in ("status", "frames", "eyes")] == segments
        assert rundir.running() == [name]
        assert "is already running" in Holder(base, name).failed()


def test_segment_is_found_from_another_runtime_directory(base: Path, name: str) -> None:
    others = [base.parent / "b", base.parent / "c"]
    for other in others:
        other.mkdir()
    with holding(others[0], name) as first:
        assert [Session(name).segment(part) for part in ("status", "frames", "eyes")] == first
        with pytest.raises(FileNotFoundError):
            Session(f"{name}.2").segment("status")
        before = [(SHM_DIR / name).stat().st_ino for name in first]
        with holding(others[1], name) as second:
            assert not set(first) & set(second)
            with pytest.raises(FileNotFoundError):  # which of the two?
                Session(name).segment("status")
        assert gone(second) and before == [(SHM_DIR / name).stat().st_ino for name in first], (
            "one leaves the other alone"
        )
        with holding(base, name) as own:
            assert Session(name).segment("status") == own[0]
    assert rundir.running() == [] and gone(first)


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
def test_sweep_leaves_alone_what_is_not_ours(base: Path, name: str, kind: str) -> None:
    beside = SHM_DIR / f"{place_prefix(Session(name).run_dir)}{'0' * 16}-frames"
    squat(beside, kind)
    try:
        before = beside.lstat()[:7]  # all but the times
        with holding(base, name):
            pass
        assert beside.lstat()[:7] == before
    finally:
        remove(beside)
    assert not list(base.iterdir())


def test_segment_names_cannot_be_guessed(base: Path, name: str) -> None:
    with holding(base, name) as first:
        pass
    with holding(base, name) as second:
        assert [Session(name).segment(ring) for ring in ("status", "frames", "eyes")] == second
    assert not {part.rpartition("-")[0] for part in first} & {
        part.rpartition("-")[0] for part in second
    }
    leased = {made_state().with_pictures(5).options.pictures for _ in range(20)}
    assert len(leased) == 20


def test_sweep_removes_a_killed_session_alone(base: Path, name: str) -> None:
    killed = Holder(base, name)
    left = killed.ready()
    killed.kill()
    assert not gone(left), "nothing to sweep: this test shows nothing"
    with holding(base, f"{name}.2") as living:
        assert gone(left) and not gone(living)
        assert [path.name for path in base.iterdir()] == [f"{PREFIX}{name}.2"]


@pytest.mark.parametrize("how", ["removed", "base removed", "moved"])
def test_sweep_removes_memory_without_a_run_directory(base: Path, name: str, how: str) -> None:
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


def test_session_without_its_run_directory_leaves_the_next_alone(base: Path, name: str) -> None:
    first = Holder(base, name)
    first.ready()
    shutil.rmtree(base / f"{PREFIX}{name}")
    second = Holder(base, name)
    stays(lambda: second.process.poll() is None, 0.3, "the wait for the first")
    first.end()
    segments = second.ready()
    assert rundir.running() == [name] and not gone(segments)
    second.end()
    assert gone(segments) and not list(base.iterdir())
