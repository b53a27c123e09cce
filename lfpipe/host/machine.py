"""The machine: its sleep, the order of its memory, how it rounds, versions of what computes, screen
hardware. And processes on it: cores, load, the settings of a stage's own, its end with its parent,
what it gets from its parent.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import importlib.util
import multiprocessing
import os
import platform
import shlex
import signal
import struct
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

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


PR_SET_PDEATHSIG, PR_SET_TIMERSLACK = 1, 29  # linux/prctl.h
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # malloc.h
KEPT_BYTES = 32 << 20  # the maximum of glibc; a 4K frame has 25 MB
SLICE_NS = 100_000  # the shortest that the kernel grants
# sched_setattr and sched_getattr, which the C library does not offer; struct sched_attr
SCHED_CALLS = {"x86_64": (314, 315), "aarch64": (274, 275)}
SCHED_ATTR = struct.Struct("=IIQiIQQQ")


def _libc(function: str, *arguments: int) -> None:
    """Calls a function of the C library, if it has it."""
    with contextlib.suppress(AttributeError, OSError, TypeError):
        getattr(ctypes.CDLL(None), function)(*arguments)


def usable_cores(pid: int = 0) -> list[int]:
    """The cores that a process, by default this one, may run on; none if it is gone."""
    if not hasattr(os, "sched_getaffinity"):  # macOS places processes itself
        return list(range(os.cpu_count() or 1))
    try:
        return sorted(os.sched_getaffinity(pid))
    except OSError:
        return []


def run_on(cores: Sequence[int]) -> None:
    """Moves this process or thread to these cores, if there are any and the system can."""
    if cores and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores)


def yield_to_others() -> None:
    """Yields the core to other processes whenever they need it; no effect if the system cannot do
    this.
    """
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def ask_for_short_slices() -> bool:
    """Asks for turns of SLICE_NS on a core, for this thread and those that it starts: beside busy
    programs, a thread that wakes then runs sooner, for the same share. Returns whether the kernel
    grants it, as Linux 6.12 and later do; not to a process of another policy than the usual one.
    """
    known = sys.platform == "linux" and platform.machine() in SCHED_CALLS
    if not known or os.sched_getscheduler(0) != os.SCHED_OTHER:
        return False
    set_them, get_them = SCHED_CALLS[platform.machine()]
    size, nice = SCHED_ATTR.size, os.getpriority(os.PRIO_PROCESS, 0)
    own = ctypes.create_string_buffer(SCHED_ATTR.pack(size, 0, 0, nice, 0, SLICE_NS, 0, 0), size)
    call = ctypes.CDLL(None).syscall
    return bool(call(set_them, 0, own, 0) == call(get_them, 0, own, size, 0) == 0) and (
        SCHED_ATTR.unpack(own.raw)[5] == SLICE_NS
    )


def set_up(name: str) -> None:
    """Sets a process name for tools and the log, short slices, precise sleeps, and an allocator
    that keeps memory for the next frame: returning pictures to the kernel and faulting them in
    again costs 1 ms per frame of 640x480.
    """
    multiprocessing.current_process().name = name
    with contextlib.suppress(OSError):
        Path("/proc/self/comm").write_text(name[:15])
    ask_for_short_slices()
    _libc("mallopt", M_MMAP_THRESHOLD, KEPT_BYTES)
    _libc("mallopt", M_TRIM_THRESHOLD, 2 * KEPT_BYTES)
    _libc("prctl", PR_SET_TIMERSLACK, 1, 0, 0, 0)  # up to 50 us late otherwise


def end_with_parent(parent_pid: int) -> bool:
    """Asks the kernel to send this process SIGTERM when the thread that started it ends: at once,
    and even if no thread of this process runs. Returns False if the parent has already ended.
    """
    _libc("prctl", PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    return os.getppid() == parent_pid


def resume_stage(pid: int) -> None:
    """Resumes a stopped stage; does nothing if it is gone, because another program may have its
    number.
    """
    with contextlib.suppress(OSError):
        if Path(f"/proc/{pid}/comm").read_text().startswith("lfpipe-"):
            os.kill(pid, signal.SIGCONT)


def _ask(pid: int, question: str) -> Any:
    """The answer of one of psutil's methods, None if the process is gone."""
    import psutil  # only for monitors: a stage starts faster without it

    try:
        return getattr(psutil.Process(pid), question)()
    except (psutil.Error, ValueError):
        return None


def is_stopped(pid: int) -> bool:
    """Whether a signal has stopped a process: it waits for nothing."""
    return bool(_ask(pid, "status") == "stopped")


def rss_bytes(pid: int) -> int:
    """Resident memory of a process, including shared pages; 0 if it is gone."""
    memory = _ask(pid, "memory_info")
    return int(memory.rss) if memory else 0
