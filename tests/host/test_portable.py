"""The host without Linux's own features, `LFPIPE_HOST=portable`: a session, its token, its locks, its wake-ups, its end."""

import ast
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

import lfpipe.host
from tests.world import World

HOST = Path(lfpipe.host.__file__).parent
ROOT = HOST.parents[1]


@pytest.fixture(scope="module")
def portable(tmp_path_factory: pytest.TempPathFactory, scene: Path) -> Iterator[World]:
    """A running portable session with its own registry."""
    made = World(tmp_path_factory.mktemp("portable"))
    made.env |= {"LFPIPE_HOST": "portable", "TMPDIR": str(made.root)}
    made.up(scene, "--set=render.method=nearest", "--set=render.alpha_px=12")
    made.pictures(5)
    yield made
    made.end()


def run(world: World, program: str) -> subprocess.CompletedProcess[str]:
    """A program of the portable host in that world."""
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT, env=world.env, timeout=60)


WITH_TOKEN = """
import pathlib, sys, tempfile, zmq
from lfpipe.errors import UserError
from lfpipe.host import endpoints
from lfpipe.transport import control
real = next(pathlib.Path({run_dir!r}).glob("lfpipe-*"))
wrong = pathlib.Path(tempfile.mkdtemp())
where, key = (real / "ctl").read_bytes().split(b"\\n")
for name, token in (("ctl", zmq.curve_keypair()[0]), ("bus", b""), ("tap", key)):
    (wrong / name).write_bytes((real / name).read_bytes().split(b"\\n")[0] + b"\\n" + token)
try:
    control.request(wrong, {{"cmd": "stop"}}, 1.0)
except UserError as error:
    print(error.message)
context = control.context()
plain = context.socket(zmq.DEALER)
plain.connect(where.decode())
plain.send(control.encode({{"cmd": "stop"}}))
print(plain.poll(700))
heard = context.socket(zmq.SUB)
heard.subscribe(b"")
endpoints.connect(heard, wrong, "tap")
print(heard.poll(700), control.request(real, {{"cmd": "hello"}}, 30)["ok"], oct((real / "ctl").stat().st_mode & 0o777))
"""


def test_a_wrong_token_is_refused_by_every_socket_and_the_right_one_is_heard(portable: World) -> None:
    done = run(portable, WITH_TOKEN.format(run_dir=str(portable.run_dir)))
    assert done.returncode == 0, done.stderr
    assert done.stdout.split("\n")[:3] == ["the session did not answer within 1 s", "0", "0 True 0o600"], done.stdout
    assert portable.pictures(len(portable.lines()) + 5), "the session goes on"


def test_nothing_of_linux_is_used(portable: World) -> None:
    """No FIFO and no Unix socket in the run directory, and no lock that the kernel keeps."""
    run_dir = next(portable.run_dir.glob("lfpipe-*"))
    kinds = {path.name: path.is_file() or path.is_dir() for path in run_dir.iterdir()}
    assert {"ctl", "bus", "tap", "wake.frames.track", "lock.d"} <= set(kinds) and all(kinds.values()), kinds
    status = json.loads(portable.run("ctl", "--session", portable.name, "--json", "status").stdout)
    pids = [stage["pid"] for stage in status["stages"].values() if stage["pid"]]
    locks = [line.split() for line in Path("/proc/locks").read_text().splitlines()]
    assert len(pids) == 3 and not [words for words in locks if words[4] in map(str, pids)]


WAKES = """
import pathlib, select, sys, tempfile
from lfpipe.host import wake
path = pathlib.Path(tempfile.mkdtemp()) / "wake"
wake.make(path)
writer = wake.Wake(path)
writer.notify(1)  # nobody is there yet
reader = wake.Wake(path, reads=True)
waits = lambda: bool(select.select([reader.fd], [], [], 5)[0])
print(waits(), reader.drain())  # of its own
for seq in range(1, 5001):
    writer.notify(seq)  # more than its socket holds: blocks nobody
print(waits(), 0 < reader.drain() <= 5000)
while reader.drain():
    pass
reader.close()
reader = wake.Wake(path, reads=True)  # a restarted one
reader.drain()
writer.notify(77)
print(waits(), reader.drain())
"""


def test_wakes_arrive_also_at_a_restarted_reader(portable: World) -> None:
    done = run(portable, WAKES)
    assert done.stdout.split() == ["True", "0", "True", "True", "True", "77"], done.stdout + done.stderr


LOCKS = """
import os, pathlib, subprocess, sys, tempfile
from lfpipe.host import file_lock
path = pathlib.Path(tempfile.mkdtemp()) / "lock"
TAKE = [
    "import os, sys, pathlib",
    "from lfpipe.host import file_lock",
    "print(file_lock.take(pathlib.Path(sys.argv[1]), sys.argv[2] == 'True') is not None, flush=True)",
    "os._exit(0)",
]
def left(shared):
    command = [sys.executable, "-c", ";".join(TAKE), str(path), str(shared)]
    return subprocess.run(command, capture_output=True, text=True).stdout.strip()
print(left(False), file_lock.is_held(path), left(False))  # the dead hold nothing
one, two = file_lock.take(path, shared=True), file_lock.take(path, shared=True)
print(one is not None and two is not None, left(True), left(False), file_lock.is_held(path))
one.release(); two.release()
alone = file_lock.take(path)
print(left(True), left(False), file_lock.is_held(path), alone.in_place())
alone.release()
print(file_lock.is_held(path), sorted(path.parent.iterdir()))
"""


def test_locks_are_those_of_living_processes(portable: World) -> None:
    done = run(portable, LOCKS)
    words = [line.split() for line in done.stdout.splitlines()]
    assert words == [
        ["True", "False", "True"],
        ["True", "True", "False", "False"],
        ["False", "False", "True", "True"],
        ["False", "[]"],
    ], done.stdout + done.stderr


def test_an_implementation_that_is_none_is_named(portable: World) -> None:
    env = {**portable.env, "LFPIPE_HOST": "linux"}
    done = subprocess.run([sys.executable, "-m", "lfpipe", "cameras"], capture_output=True, text=True, env=env)
    assert done.returncode == 2 and "LFPIPE_HOST='linux'" in done.stderr and "portable" in done.stderr, done.stderr


WITHOUT = """
import importlib, os, pkgutil, sys
import cv2, distributed, h5py, matplotlib, psutil, rich.live, tornado.web, zmq.asyncio
import asyncio, getpass, multiprocessing.shared_memory, shutil, subprocess, tarfile, tempfile
for name in ("fcntl", "grp", "pwd", "resource", "termios", "tty"):
    sys.modules[name] = None
for name in ("O_NONBLOCK", "O_NOFOLLOW", "O_DIRECTORY", "O_NOCTTY", "O_TMPFILE", "getuid", "mkfifo", "pathconf",
             "posix_fallocate", "pread", "pwrite", "sched_getaffinity", "setpriority", "sysconf"):
    delattr(os, name)
import lfpipe
for each in pkgutil.walk_packages(lfpipe.__path__, "lfpipe."):
    try:
        importlib.import_module(each.name) if not each.name.endswith("__main__") else None
    except ImportError as error:
        print(each.name)
"""


def test_everything_can_be_imported_without_what_windows_lacks(portable: World) -> None:
    """Except Video4Linux. Packages that check for these themselves, such as Dask, come first."""
    done = run(portable, WITHOUT)
    assert done.returncode == 0, done.stderr
    video4linux = {"camera", "camera_controls", "camera_list", "pixel_formats", "v4l2_device", "v4l2_stream"}
    assert {name.removeprefix("lfpipe.capture.") for name in done.stdout.split()} == video4linux


def signatures(path: Path) -> dict[str, str]:
    """Public functions, methods and classes of a module, with their arguments."""
    found: dict[str, str] = {}

    def add(nodes: list[ast.stmt], prefix: str) -> None:
        for node in nodes:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                found[prefix + node.name] = ""
                add(node.body, f"{prefix}{node.name}.")
            elif isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
                found[prefix + node.name] = ast.unparse(node.args)
            elif isinstance(node, ast.Assign):
                names = [each.id for target in node.targets for each in ast.walk(target) if isinstance(each, ast.Name)]
                found.update({prefix + name: "" for name in names if not name.startswith("_")})

    add(ast.parse(path.read_text()).body, "")
    return found


def test_both_implementations_have_the_same_functions() -> None:
    """The names that the rooms above import, with the same arguments."""
    used: dict[str, set[str]] = {}
    for path in HOST.parent.rglob("*.py"):
        for line in path.read_text().splitlines() if path.parent != HOST else ():
            head, _, names = line.strip().partition(" import ")
            if head.startswith("from lfpipe.host."):
                words = [name.split()[0] for name in names.split(",")]
                used.setdefault(head.removeprefix("from lfpipe.host."), set()).update(words)
    for path in (HOST / "portable").glob("[a-z]*.py"):
        native = HOST / path.name
        if native.exists():
            one, other = signatures(native), signatures(path)
            shared = {name for name, arguments in one.items() if name in other and arguments != other[name] and name != "read_at"}
            assert not shared - {"write_at"}, f"{path.name}: {shared}"
            assert used.get(path.stem, set()) - {"Segment"} <= set(other), path.name


def test_a_killed_session_leaves_nothing_once_the_next_has_begun(portable: World) -> None:
    """The last test here: it ends the session."""
    (supervisor,) = portable._running[:1]
    stages = psutil.Process(supervisor.pid).children(recursive=True)
    os.kill(supervisor.pid, signal.SIGKILL)
    supervisor.communicate()
    _, alive = psutil.wait_procs(stages, timeout=30)
    assert not alive, "they end with their parent"
    assert portable.run("up", "--session", portable.name, "nothing").returncode == 2
    registry = next(portable.root.glob("lfpipe-*-segments"))
    assert not list(portable.run_dir.iterdir()) and not list(registry.glob("lfp-*"))
