"""The directories of sessions: locks, sweeps and losses, and what in them or in the environment is
refused with a remedy.
"""

import contextlib
import shutil
import stat
import sys
from pathlib import Path
from threading import Timer

import pytest
import zmq

from lfpipe.host import files
from lfpipe.supervisor import rundir
from lfpipe.transport.control import LIVE, PREFIX, Session
from tests.supervisor.holder import ROOT, Holder, holding
from tests.support.processes import printed
from tests.support.refusal import refusal


def test_lock_notices_a_removed_run_directory(base: Path, name: str) -> None:
    session = Session(name)
    lock = rundir.acquire(session)
    assert lock.in_place()
    (session.run_dir / "lock").unlink()
    assert not lock.in_place(), "the lock is gone"
    session.run_dir.chmod(0o777)
    other = rundir.acquire(session)
    assert not lock.in_place() and stat.S_IMODE(session.run_dir.stat().st_mode) == 0o700
    rundir.remove(session.run_dir, lock)
    assert rundir.running() == [name], "it is another's now"
    (session.run_dir / "session.json").touch()
    (session.run_dir / "lock").unlink()
    rundir.remove(session.run_dir, other)
    rundir.sweep()
    assert not list(base.iterdir()), "swept, without its lock"


LOOK = """
from lfpipe.host import files
from lfpipe.supervisor import rundir
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


def test_a_lock_whose_directory_was_removed_meanwhile_is_taken_again(
    base: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = Session(name).run_dir / "lock"
    take = files.lock_file
    swept = iter([True, False])

    def taken(at: Path) -> files.Lock | None:
        lock = take(at)
        if next(swept):  # by another process, just before
            shutil.rmtree(at.parent)
        return lock

    monkeypatch.setattr(rundir, "lock_file", taken)
    lock = rundir.try_lock(path, make=True)
    assert lock is not None and lock.in_place() and path.exists()
    rundir.remove(Session(name).run_dir, lock)


def test_sweep_removes_all_of_a_dead_run_directory(base: Path, name: str, tmp_path: Path) -> None:
    """Also folders, and links without what they lead to."""
    kept = tmp_path / "kept"
    kept.mkdir()
    (kept / "file").touch()
    for session in (Session(name), Session(f"{name}.2")):
        (session.run_dir / "a" / "b").mkdir(parents=True)
        (session.run_dir / "a" / "b" / "file").touch()
        (session.run_dir / "link").symlink_to(kept)
    (base / f"{LIVE}scene").mkdir()  # of a program that was killed
    session.run_dir.parent.chmod(0o700)
    with holding(base, name):
        assert sorted(path.name for path in base.iterdir()) == [f"{PREFIX}{name}"]
        assert not (Session(name).run_dir / "a").exists()
    assert (kept / "file").exists() and not list(base.iterdir())


@pytest.mark.native("sockets with a path")
def test_acquire_refuses_a_path_too_long_for_sockets(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    need = zmq.IPC_PATH_MAX_LEN - len(f"/{PREFIX}ab/.ctl")  # what a session of two letters leaves
    place = Path(f"{tmp_path}/".ljust(need, "y"))
    place.mkdir()
    monkeypatch.setenv("LFPIPE_RUN_DIR", str(place))
    long = refusal(rundir.acquire, Session("abc"))
    assert "a socket allows" in long.message
    assert "shorter --session" in long.remedy and "shorter LFPIPE_RUN_DIR" in long.remedy
    assert not list(place.iterdir())
    lock = rundir.acquire(Session("ab"))
    rundir.remove(Session("ab").run_dir, lock)


def test_sweep_removes_a_killed_session_alone(base: Path, name: str) -> None:
    killed = Holder(base, name)
    killed.ready()
    killed.kill()
    assert Session(name).segment("frames").exists(), "nothing to sweep: this test shows nothing"
    with holding(base, f"{name}.2"):
        assert [path.name for path in base.iterdir()] == [f"{PREFIX}{name}.2"]
        assert Session(f"{name}.2").segment("frames").exists()


def test_a_stage_that_ends_while_another_one_sweeps_tries_again(base: Path, name: str) -> None:
    """The other one gives up, because a file came in the meantime."""
    run_dir = Session(name).run_dir
    lock = rundir.try_lock(run_dir / "lock", make=True)
    assert lock is not None
    (run_dir / "late").touch()
    timer = Timer(0.05, lock.release)
    timer.start()
    rundir.sweep_own(run_dir)
    timer.join()
    assert not list(base.iterdir())


def test_session_without_its_directory_leaves_the_next_alone(base: Path, name: str) -> None:
    first = Holder(base, name)
    first.ready()
    shutil.rmtree(base / f"{PREFIX}{name}")
    with holding(base, name):
        before = sorted(Session(name).run_dir.iterdir())
        first.end()
        assert rundir.running() == [name] and sorted(Session(name).run_dir.iterdir()) == before
    assert not list(base.iterdir())
