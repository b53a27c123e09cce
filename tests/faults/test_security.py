"""Only the user who started a session can access it, and no path that a command names escapes the
checks of the command line.
"""

import fcntl
import os
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from lfpipe.errors import UserError
from lfpipe.sequence.folder import open_sequence
from lfpipe.supervisor import rundir
from lfpipe.transport.control import Session
from tests.support.refusal import refusal
from tests.support.world import World

NOBODY = 65534


@pytest.mark.parametrize("kind", ["link", "file"])
def test_run_directory_that_is_another_thing_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.setenv("LFPIPE_RUN_DIR", str(tmp_path))
    session = Session("mine")
    if kind == "link":
        (tmp_path / "elsewhere").mkdir()
        session.run_dir.symlink_to(tmp_path / "elsewhere")
    else:
        session.run_dir.write_text("")
    assert "not a directory of yours" in str(refusal(rundir.acquire, session))
    assert not rundir.sweep() and rundir.running() == []


@pytest.mark.skipif(os.getuid() != 0, reason="only root can give a directory away")
def test_run_directory_of_another_user_is_refused_and_left_alone(world: World, scene: Path) -> None:
    theirs = world.session_dir
    theirs.mkdir(mode=0o755)
    with (theirs / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # it looks like a running session
        os.chown(theirs, NOBODY, NOBODY)
        up = ("up", scene, "--camera", "demo", "--display", "none")
        for command in (up, ("monitor", "--once"), ("ctl", "stop")):
            why = "not a directory of yours" if command is up else "no session"
            assert why in world.refused(*command, "--session", world.name)
        assert (
            sorted(path.name for path in theirs.iterdir()) == ["lock"]
            and stat.S_IMODE(theirs.stat().st_mode) == 0o755
        )
    shutil.rmtree(theirs)


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory, scene: Path) -> Iterator[World]:
    """A session whose user's shell allows everything to others."""
    with World(tmp_path_factory.mktemp("guarded")) as made:
        made.shows(
            scene,
            "--set",
            "render.clock=camera",
            "--set",
            "governor.quality=fixed",
            preexec_fn=lambda: os.umask(0),
        )
        made.wait_for(lambda: made.ask(cmd="hello")["options"]["scene"]["complete"], "disparity")
        yield made


@pytest.mark.live
@pytest.mark.native("FIFOs, sockets and segments that are files")
def test_files_and_segments_of_a_session_are_the_users_alone(guarded: World) -> None:
    run_dir = guarded.session_dir
    assert guarded.ask(cmd="pictures", lease_s=30)["ok"]
    assert stat.S_IMODE(run_dir.stat().st_mode) == 0o700
    entries = list(run_dir.iterdir())
    assert {stat.S_IFSOCK, stat.S_IFIFO, stat.S_IFREG} <= {
        stat.S_IFMT(path.stat().st_mode) for path in entries
    }
    segments = [run_dir / name for name in guarded.segments()]
    assert len(segments) >= 4, "status, frames, eyes, pictures"
    # the directory guards its files
    doors = [path for path in entries if path in segments or not path.is_file()]
    assert not [str(path) for path in doors if stat.S_IMODE(path.stat().st_mode) != 0o600]
    assert all(path.stat().st_uid == os.getuid() for path in (run_dir, *entries))


@pytest.mark.live
def test_a_recording_that_comes_to_nothing_leaves_nothing(guarded: World, tmp_path: Path) -> None:
    """The same command works afterwards."""
    out = tmp_path / "new" / "recording"
    file = tmp_path / "file"
    file.touch()
    for _ in range(3):
        with pytest.raises(UserError, match="Not a directory"):
            guarded.ask(cmd="record", path=str(file / "recording"))
        assert not guarded.ask(cmd="hello")["options"]["record"]
    guarded.ask(cmd="record", path=str(out))
    guarded.ask(cmd="record", path="")

    def begun_again() -> bool:
        if out.exists() and open_sequence(out).complete:  # it was quick enough
            shutil.rmtree(out)
        try:
            guarded.ask(cmd="record", path=str(out))
        except UserError:  # the first one is still being written
            return False
        return True

    guarded.wait_for(begun_again, "the second recording")
    guarded.ask(cmd="record", path="")
