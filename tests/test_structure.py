"""Every import between packages points down: no package knows those above it, and stages do not
know each other.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from tests.support.extras import PRESENT
from tests.support.source import PACKAGE, modules, nodes, package_of

# From the bottom up; packages of one layer do not know each other. Top-level modules (`errors`,
# `eyes`) are below them all, except `rings`, which only names parts of others.
LAYERS = (
    {"host"},
    {"files"},
    {"config"},
    {"transport"},
    {"notices"},
    {"scene", "sequence"},
    {"live"},
    {"capture", "track", "render", "record"},
    {"supervisor"},
    {"replays", "monitor", "rings"},
    {"api"},
    {"bench"},
    {"cli"},
    {"extras"},  # registers itself by entry points; nothing imports it
)
LAYER = {package: layer for layer, packages in enumerate(LAYERS) for package in packages}
# the parts of render, each of which knows only those before it
RENDER = (
    "synthesis",
    "display",
    "viewer",
    "metrics",
    "choice",
    "live_input",
    "presentation",
    "presenter",
    "listeners",
    "plan",
    "ui",
    "stage",
)


def imported(node: ast.AST) -> list[str]:
    """Names of the parts of lfpipe that a node imports, at a module's head or within a function."""
    if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
        return [f"{node.module}.{one.name}" for one in node.names]
    if isinstance(node, ast.Import):
        return [one.name for one in node.names]
    text = node.value if isinstance(node, ast.Constant) else None
    # a module that is named and not imported, to be run or imported later
    named = isinstance(text, str) and re.match(r"lfpipe\.\w+(\.\S*)?$", text)
    return [str(text)] if named else []


def test_packages_import_downwards() -> None:
    folders = {
        entry.name for entry in PACKAGE.iterdir() if entry.is_dir() and any(entry.glob("*.py"))
    }
    assert folders | {"extras", "rings"} == set(LAYER)
    top = {path.stem for path in PACKAGE.glob("*.py")} - {"__init__", "__main__", "rings"}
    assert len(top) <= 5, "few modules are outside the packages"
    wrong = []
    for module, node in nodes(ast.AST):
        here = package_of(module)
        for name in imported(node):
            there = name.split(".")[1] if name.startswith("lfpipe.") else here
            if (
                there != here
                and there in LAYER
                and LAYER[there] >= LAYER.get(here, 0)
                and here not in ("__init__", "__main__")
            ):
                wrong.append(f"{module}: {name}")
    assert not wrong, "\n".join(wrong)


def test_parts_of_render_import_downwards() -> None:
    parts = {path.stem for path in (PACKAGE / "render").iterdir() if not path.stem.startswith("_")}
    assert parts == set(RENDER)
    wrong = []
    for module, node in nodes(ast.AST):
        if package_of(module) == "render" and module != "render/__init__.py":
            here = Path(module).with_suffix("").parts[1]
            names = [
                name.split(".") for name in imported(node) if name.startswith("lfpipe.render.")
            ]
            wrong += [
                f"{module}: {'.'.join(name)}"
                for name in names
                if name[2] != here and RENDER.index(name[2]) > RENDER.index(here)
            ]
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
    "lfpipe/render/display/open_display.py": "X and Wayland listen at Unix sockets",
    "lfpipe/render/display/window_system.py": "calls the SDL library that pygame loads",
    "lfpipe/track/network.py": "maps a tensor's memory",
}


def system_names(tree: ast.Module) -> Iterator[str]:
    """What in a module belongs to an operating system."""
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
    wrong = [
        f"{module}: {name}"
        for module, tree in modules().items()
        if package_of(module) != "host" and f"lfpipe/{module}" not in ALLOWED
        for name in system_names(tree)
    ]
    assert not wrong, "\n".join(wrong)


def test_paths_are_examined_without_exceptions() -> None:
    """`Path.exists` and its like raise up to Python 3.13, for a folder that may not be searched:
    `host.files` does not.
    """
    wrong = [
        f"{module}: {ast.unparse(call)}"
        for module, call in nodes(ast.Call)
        if package_of(module) not in ("scene", "files")
        and not call.args
        and isinstance(call.func, ast.Attribute)
        and call.func.attr in ("exists", "is_file", "is_dir")
    ]
    assert not wrong, wrong


FORBIDDEN = {"pickle", "marshal", "shelve", "dill", "cloudpickle"}
QUEUES = {
    "Queue",
    "SimpleQueue",
    "JoinableQueue",
    "Manager",
    "Pipe",
    "Lock",
    "Event",
    "Condition",
    "Value",
}


def unsafe(node: ast.AST) -> set[str]:
    """Names in a node that execute their input (pickle), or that a killed process takes with it
    (queues and locks).
    """
    if isinstance(node, ast.Import):
        return {alias.name.split(".")[0] for alias in node.names} & FORBIDDEN
    if isinstance(node, ast.ImportFrom) and node.module:
        top = node.module.split(".")[0]
        return ({top} & FORBIDDEN) | (
            {alias.name for alias in node.names} & QUEUES if top == "multiprocessing" else set()
        )
    if (
        isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Name)
        and node.value.id in ("multiprocessing", "mp")
    ):
        return {node.attr} & QUEUES
    if isinstance(node, ast.keyword) and node.arg == "allow_pickle":
        return (
            set()
            if isinstance(node.value, ast.Constant) and node.value.value is False
            else {"allow_pickle"}
        )
    return set()


def test_modules_do_not_unpickle_or_share_a_lock() -> None:
    wrong = [f"{module}: {ast.unparse(node)}" for module, node in nodes(ast.AST) if unsafe(node)]
    assert not wrong, wrong


def test_wall_clock_is_not_read_by_a_session() -> None:
    """So a step of the clock has no effect: only names and dates of files use it."""
    wall = {
        "time": {"time", "time_ns", "gmtime", "localtime"},
        "datetime": {"now", "utcnow", "today"},
    }
    packages = ("capture", "track", "render", "transport", "supervisor", "sequence", "replays")
    wrong = [
        f"{module}: {ast.unparse(node)}"
        for module, node in nodes(ast.Attribute)
        if package_of(module) in packages
        and isinstance(node.value, ast.Name)
        and node.attr in wall.get(node.value.id, ())
    ]
    assert not wrong, wrong


# Where the path of the interpreter may stand: elsewhere `host.child.python` makes a command with
# it, whose child imports nothing from the working directory.
INTERPRETER = {
    "host/child.py",
    "host/machine.py",  # printed
    "monitor/doctor.py",  # printed
    "track/models.py",  # an argument of uv
    "extras/exhibition/desktop.py",  # written into a menu entry, with -P
    "extras/sweep/work.py",  # with -P -c
}


def test_children_import_nothing_from_the_working_directory() -> None:
    found = {
        module for module, node in nodes(ast.Attribute) if ast.unparse(node) == "sys.executable"
    }
    assert found == {name for name in INTERPRETER if PRESENT or not name.startswith("extras/")}
