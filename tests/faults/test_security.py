"""Only the user who started a session can access it."""

import ast
import fcntl
import os
import stat
from pathlib import Path
from typing import Any

import pytest
import zmq

from lfpipe.errors import UserError
from lfpipe.supervisor import rundir
from lfpipe.transport import control
from lfpipe.transport.segment import SHM_DIR
from lfpipe.transport.session import PREFIX, Session
from tests.world import World

pytestmark = pytest.mark.live

FORBIDDEN = {"pickle", "marshal", "shelve", "dill", "cloudpickle"}
QUEUES = {"Queue", "SimpleQueue", "JoinableQueue", "Manager", "Pipe", "Lock", "Event", "Condition", "Value"}


def test_no_module_unpickles_or_shares_a_lock() -> None:
    """Pickle executes its input; a killed process takes a multiprocessing queue or lock with it."""
    root = Path(rundir.__file__).parents[1]
    for path in root.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names: set[str] = set()
            if isinstance(node, ast.Import):
                names = {alias.name.split(".")[0] for alias in node.names} & FORBIDDEN
            elif isinstance(node, ast.ImportFrom) and node.module:
                top = node.module.split(".")[0]
                wanted = {alias.name for alias in node.names}
                names = ({top} & FORBIDDEN) | (wanted & QUEUES if top == "multiprocessing" else set())
            elif (
                isinstance(node, ast.Attribute)
                and isinstance(node.value, ast.Name)
                and node.value.id in ("multiprocessing", "mp")
            ):
                names = {node.attr} & QUEUES
            elif isinstance(node, ast.keyword) and node.arg == "allow_pickle":
                names = {"allow_pickle"} if not (isinstance(node.value, ast.Constant) and node.value.value is False) else set()
            assert not names, f"{path.relative_to(root)}: {names}"


@pytest.mark.native("FIFOs, sockets and segments that are files")
def test_every_file_and_segment_of_a_session_is_the_users_alone(world: World, scene: Path) -> None:
    world.up(scene, preexec_fn=lambda: os.umask(0))  # whatever the user's shell allows to others
    world.pictures(5)
    with control.context() as ctx, ctx.socket(zmq.DEALER) as socket:
        run_dir = next(world.run_dir.glob("lfpipe-*"))
        control.connect(socket, run_dir, "ctl")
        socket.send(control.encode({"cmd": "pictures", "lease_s": 30}))
        assert socket.poll(5000) and control.decode(socket.recv())["ok"]
    assert stat.S_IMODE(run_dir.stat().st_mode) == 0o700
    found = list(run_dir.iterdir())
    kinds = [stat.S_IFMT(path.stat().st_mode) for path in found]
    assert {stat.S_IFSOCK, stat.S_IFIFO, stat.S_IFREG} <= set(kinds)
    segments = [SHM_DIR / name for name in world.segments()]
    assert len(segments) >= 4, "status, frames, eyes, pictures"
    doors = [
        path for path in (*found, *segments) if not (path.is_file() and path.parent == run_dir)
    ]  # the directory guards its files
    assert not [str(path) for path in doors if stat.S_IMODE(path.stat().st_mode) != 0o600]
    assert all(path.stat().st_uid == os.getuid() for path in (run_dir, *found, *segments))


@pytest.mark.parametrize("kind", ["link", "file"])
def test_a_run_directory_that_is_another_thing_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    session = Session("mine")
    if kind == "link":
        (tmp_path / "elsewhere").mkdir()
        session.run_dir.symlink_to(tmp_path / "elsewhere")
    else:
        session.run_dir.write_text("")
    with pytest.raises(UserError, match="not a directory of yours"):
        rundir.acquire(session)
    assert not rundir.sweep() and rundir.running() == []


@pytest.mark.skipif(os.getuid() != 0, reason="only root can give a directory away")
def test_a_run_directory_of_another_user_is_refused_and_left_alone(world: World, scene: Path) -> None:
    theirs = world.run_dir / f"{PREFIX}{world.name}"
    theirs.mkdir(mode=0o777)
    lock = (theirs / "lock").open("w")
    fcntl.flock(lock, fcntl.LOCK_EX)  # it looks like a running session
    os.chown(theirs, 65534, 65534)
    done = world.run("up", scene, "--camera", "demo", "--display", "none", "--session", world.name)
    assert done.returncode == 2 and "is not a directory of yours" in done.stderr and "Traceback" not in done.stderr
    assert (theirs / "lock").exists() and stat.S_IMODE(theirs.stat().st_mode) == 0o777 - (0o777 & _umask())
    for words in (("monitor", "--once"), ("ctl", "stop")):
        done = world.run(*words, "--session", world.name)
        assert done.returncode == 2 and "no session" in done.stderr, "a command went to a stranger's session"
    lock.close()


def _umask() -> int:
    before = os.umask(0)
    os.umask(before)
    return before


BAD_SCENES: list[tuple[Any, str]] = [
    ("views", "absolute path"),
    ("../views", "absolute path"),
    ("", "absolute path"),
    ("/nowhere/at/all", "no such"),
    ("/a\0b", "absolute path"),
    ("/" + "x" * 5000, ""),
    (["/"], "absolute path"),
    (None, "absolute path"),
    ("/dev/null", ""),
    ("/proc/self/mem", ""),
    ("--help", "absolute path"),
]


def test_paths_over_ctl_are_checked_as_on_the_command_line(world: World, scene: Path, tmp_path: Path) -> None:
    world.up(scene, "--set", "render.clock=camera")
    world.pictures(5)
    run_dir = next(world.run_dir.glob("lfpipe-*"))
    before = control.request(run_dir, {"cmd": "hello"}, 30)
    closed = tmp_path / "closed"
    closed.mkdir()
    (closed / "view_00_00.png").write_bytes(b"not a picture")
    for path, said in [*BAD_SCENES, (str(closed), "")]:
        with pytest.raises(UserError) as refused:
            control.request(run_dir, {"cmd": "load", "scene": path}, 30)
        assert said in refused.value.message.lower() and "Traceback" not in refused.value.message, (path, refused.value.message)
    typed = world.run("up", closed, "--camera", "demo", "--display", "none", "--session", "other")
    assert typed.returncode == 2 and refused.value.message.splitlines()[0] in typed.stderr, (
        "the same words as on the command line"
    )
    for word in ("trace", "record"):
        for path in ("relative", "../x", "a\0b", 5, None, "/dev/null/x"):
            with pytest.raises(UserError):
                control.request(run_dir, {"cmd": word, "path": path}, 30)
    after = control.request(run_dir, {"cmd": "hello"}, 30)
    assert (after["options"], after["config"]) == (before["options"], before["config"])
    world.pictures(len(world.lines()) + 5)


@pytest.mark.skipif(os.getuid() == 0, reason="root may read everything")
def test_a_scene_that_may_not_be_read_is_refused_over_ctl(world: World, scene: Path, tmp_path: Path) -> None:
    world.up(scene)
    world.pictures(5)
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o000)
    with pytest.raises(UserError, match="ermission"):
        control.request(next(world.run_dir.glob("lfpipe-*")), {"cmd": "load", "scene": str(closed)}, 30)


def test_one_scene_is_loaded_at_a_time(world: World, scene: Path) -> None:
    """Each load is a process: a flood of them may not become a flood of processes."""
    supervisor = world.up(scene)
    world.pictures(5)
    run_dir = next(world.run_dir.glob("lfpipe-*"))
    with control.context() as ctx, ctx.socket(zmq.DEALER) as socket:
        control.connect(socket, run_dir, "ctl")
        for _ in range(30):
            socket.send(control.encode({"cmd": "load", "scene": str(scene)}))
        answers = []
        while len(answers) < 30 and socket.poll(20000):
            answers.append(control.decode(socket.recv()))
            children = Path(f"/proc/{supervisor.pid}/task/{supervisor.pid}/children").read_text().split()
            assert len(children) <= 5, "three stages, the tracker of shared memory, one loader"
    assert sum(answer["ok"] for answer in answers) >= 1 and len(answers) == 30
    assert any(answer.get("replaced") for answer in answers)
