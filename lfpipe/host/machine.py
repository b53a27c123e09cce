"""The machine: its sleep, the order of its memory, how it rounds, versions of what computes, screen
hardware.
"""

import contextlib
import ctypes
import functools
import importlib.util
import platform
import shlex
import sys
import time
from collections.abc import Callable, Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from lfpipe._version import __version__
from lfpipe.errors import UserError

# processors that keep program order as far as a ring needs it
TOTAL_STORE_ORDER = ("x86_64", "i686")
SEQ_CST = 5  # memory_order_seq_cst of <stdatomic.h>
OPENCV = "opencv-contrib-python-headless"
PACKAGES = ("numpy", OPENCV, "mediapipe", "ai-edge-litert")


def install_command(*words: str) -> str:
    """The command that installs packages (with options) into the environment that lfpipe runs in:
    pip's, or uv's where that has no pip.
    """
    python = shlex.quote(sys.executable)
    if importlib.util.find_spec("pip"):
        return f"{python} -m pip install {shlex.join(words)}"
    return f"uv pip install --python {python} {shlex.join(words)}"


def asleep_ns() -> int:
    """The time for which the machine has been suspended since it started, where the monotonic clock
    stops then; else 0.
    """
    clock = getattr(time, "CLOCK_BOOTTIME", None)
    return 0 if clock is None else time.clock_gettime_ns(clock) - time.monotonic_ns()


@functools.cache
def _full_fence() -> Callable[[], object]:
    """libatomic's fence, or that of macOS's C library. Raises UserError if there is neither."""
    with contextlib.suppress(OSError, AttributeError):
        return functools.partial(ctypes.CDLL("libatomic.so.1").atomic_thread_fence, SEQ_CST)
    with contextlib.suppress(AttributeError):
        barrier: Callable[[], object] = ctypes.CDLL(None).OSMemoryBarrier
        return barrier
    message = f"{platform.machine()}: no memory fence: the library libatomic is not installed"
    raise UserError(
        message,
        "install it: apt-get install libatomic1, dnf install libatomic, or apk add libatomic",
    )


def _fence() -> None:
    _full_fence()()


# no store or load before it is observed after one that follows it
fence: Callable[[], None] = (lambda: None) if platform.machine() in TOTAL_STORE_ORDER else _fence


def add(values: Iterable[float]) -> float:
    """The sum, rounded at each step from the first to the last.

    `sum` compensates rounding errors from Python 3.12 on.
    """
    total = 0.0
    for value in values:
        total += value
    return total


def processor() -> str:
    """Name of the processor: networks and numpy choose their code by it, and round differently."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def versions() -> dict[str, str]:
    """Name -> version of lfpipe, Python, the packages that compute, and the processor."""
    import cv2  # a tenth of a second, which the command line does not spend

    conditions = {"lfpipe": __version__, "python": platform.python_version()}
    conditions |= {"machine": platform.machine(), "processor": processor()}
    for name in PACKAGES:
        try:
            conditions[name] = version(name)
        except PackageNotFoundError:
            # another of the four packages that provide cv2
            conditions[name] = cv2.__version__ if name == OPENCV else "none"
    return conditions


def has_gpu() -> bool:
    """Whether there is a rendering device; true if the system cannot report it."""
    return sys.platform != "linux" or any(Path("/dev/dri").glob("renderD*"))


def has_desktop() -> bool:
    """Whether windows need no display server named in the environment: on macOS."""
    return sys.platform == "darwin"
