"""Every import between the rooms of the package points down: no room knows those above it, and
stages do not know each other.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import lfpipe

PACKAGE = Path(lfpipe.__file__).parent
# From the bottom up; rooms of one layer do not know each other. Loose modules (`errors`, `eyes`)
# are below them all.
LAYERS = (
    {"host"},
    {"files"},
    {"config"},
    {"transport"},
    {"scene", "sequence"},
    {"capture", "track", "render", "record", "share"},
    {"supervisor"},
    {"replays", "observe", "export"},
    {"api"},
    {"bench"},
    {"sweep"},
    {"cli"},
)
LAYER = {room: layer for layer, rooms in enumerate(LAYERS) for room in rooms}


def imported(path: Path) -> Iterator[str]:
    """Names of the parts of lfpipe that a file imports, at its head or within a function."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield from (f"{node.module}.{one.name}" for one in node.names)
        elif isinstance(node, ast.Import):
            yield from (one.name for one in node.names)
        elif (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and re.match(r"lfpipe\.\w+(\.\S*)?$", node.value)
        ):
            yield node.value  # a module that is named and not imported, to be run or imported later


# Programs of rooms above that a file starts, with limits and an answer in JSON: no import.
PROGRAMS = {"scene/open_scene.py": "lfpipe.render.packer"}


def room(path: Path) -> str:
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


def test_rooms_import_downwards() -> None:
    folders = {
        entry.name for entry in PACKAGE.iterdir() if entry.is_dir() and any(entry.glob("*.py"))
    }
    assert folders == set(LAYER)
    assert len({path.stem for path in PACKAGE.glob("*.py")} - {"__init__", "__main__"}) <= 4, (
        "few modules stand loose"
    )
    wrong = []
    for path in PACKAGE.rglob("*.py"):
        here = room(path)
        for name in imported(path):
            there = name.split(".")[1] if name.startswith("lfpipe.") else here
            if (
                there != here
                and there in LAYER
                and LAYER[there] >= LAYER.get(here, 0)
                and here not in ("__init__", "__main__")
                and PROGRAMS.get(path.relative_to(PACKAGE).as_posix()) != name
            ):
                wrong.append(f"{path.relative_to(PACKAGE)}: {name}")
    assert not wrong, "\n".join(wrong)


# Modules, functions and paths that not every operating system has: `host` alone may name them.
SYSTEM_MODULES = {"ctypes", "fcntl", "grp", "pwd", "resource", "select", "termios", "tty"}
SYSTEM_FUNCTIONS = {
    "AF_UNIX",
    "CLOCK_BOOTTIME",
    "O_DIRECTORY",
    "O_NOCTTY",
    "O_NOFOLLOW",
    "O_NONBLOCK",
    "SIGCONT",
    "SIGHUP",
    "SIGKILL",
    "SIGSTOP",
    "SIGUSR1",
    "posix_fadvise",
    "set_blocking",
    "fork",
    "getpgid",
    "getpriority",
    "getsid",
    "geteuid",
    "killpg",
    "mkfifo",
    "posix_fallocate",
    "sched_getaffinity",
    "sched_setaffinity",
    "sched_setscheduler",
    "setpgid",
    "setpriority",
    "setsid",
    "sysconf",
    "uname",
    "pthread_sigmask",
}
SYSTEM_PATHS = ("/proc", "/sys/", "/dev/shm", "/dev/dri")
# What is about one system by its nature, or the C library of a dependency; each with its reason.
ALLOWED = {
    "lfpipe/capture/camera_list.py": "Video4Linux is Linux's own",
    "lfpipe/capture/camera.py": "a parameter of Linux's driver for webcams",
    "lfpipe/capture/v4l2_abi.py": "Video4Linux is Linux's own",
    "lfpipe/capture/v4l2_device.py": "Video4Linux is Linux's own",
    "lfpipe/render/open_display.py": "X and Wayland listen at Unix sockets",
    "lfpipe/render/window_system.py": "calls the SDL library that pygame loads",
    "lfpipe/track/network.py": "maps a tensor's memory",
}


def system_names(path: Path) -> Iterator[str]:
    """What in a file belongs to an operating system."""
    tree = ast.parse(path.read_text())
    bodies = (
        node.body
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
    )
    documents = {id(body[0].value) for body in bodies if body and isinstance(body[0], ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (one.name for one in node.names if one.name in SYSTEM_MODULES)
        elif isinstance(node, ast.ImportFrom) and node.module in SYSTEM_MODULES:
            yield node.module
        elif isinstance(node, ast.Attribute) and node.attr in SYSTEM_FUNCTIONS:
            yield node.attr
        elif (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and id(node) not in documents
        ):
            yield from (start for start in SYSTEM_PATHS if node.value.startswith(start))


def test_host_alone_names_an_operating_system() -> None:
    wrong = []
    for path in PACKAGE.rglob("*.py"):
        name = f"lfpipe/{path.relative_to(PACKAGE)}"
        if room(path) != "host" and name not in ALLOWED:
            wrong += [f"{name}: {found}" for found in system_names(path)]
    assert not wrong, "\n".join(wrong)


def test_paths_are_examined_without_exceptions() -> None:
    """`Path.exists` and its like raise up to Python 3.13, for a folder that may not be searched:
    `host.files` does not.
    """
    wrong = []
    for path in PACKAGE.rglob("*.py"):
        if room(path) in ("scene", "files"):
            continue
        calls = (
            node
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.Call) and not node.args
        )
        methods = [call.func.attr for call in calls if isinstance(call.func, ast.Attribute)]
        wrong += [
            f"{path.relative_to(PACKAGE)}: {name}"
            for name in methods
            if name in ("exists", "is_file", "is_dir")
        ]
    assert not wrong, wrong
