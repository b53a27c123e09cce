"""Processes, and the machine: the sleep of it, the order of its memory, how it rounds, versions of
what computes, screen hardware; of processes cores, load, the settings of a stage's own, the end
with their parent; and child processes with limits that answer one request: a JSON object in, lines
of JSON out.

Parent: `Child(python("MODULE"), b"...")` holds the child's standard input open. Child: reads its
first line and calls `end_with_parent`, which ends the child when that pipe ends.
`python -P -m lfpipe.host.worker MODULE WORD ...` runs any module as a program in this way.

The child of a `Worker` prints a JSON object for each step and, last, its verdict:
{"ok": true, "result": {...}} or {"ok": false, "error": ..., "remedy": ...}. {"reading": path} names
the file that it opens, for messages. The parent never waits longer than it wants, keeps little of
the output, and survives whatever the child does.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import importlib.util
import json
import multiprocessing
import os
import platform
import runpy
import select
import shlex
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from importlib.metadata import PackageNotFoundError, version
from multiprocessing import connection
from pathlib import Path
from typing import Any

from lfpipe._version import __version__
from lfpipe.errors import UserError
from lfpipe.host import signals
from lfpipe.host.files import MemoryLimit

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
# number of sched_setattr, which the C library does not offer; struct sched_attr
SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}
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


def ask_for_short_slices() -> None:
    """Asks for turns of SLICE_NS on a core, for this thread and those that it starts: beside busy
    programs, a thread that wakes then runs sooner, for the same share. Linux grants it since 6.12,
    and not to a process of another policy than the usual one.
    """
    number = SCHED_SETATTR.get(platform.machine()) if sys.platform == "linux" else None
    if number and os.sched_getscheduler(0) == os.SCHED_OTHER:
        nice = os.getpriority(os.PRIO_PROCESS, 0)
        attributes = SCHED_ATTR.pack(SCHED_ATTR.size, 0, 0, nice, 0, SLICE_NS, 0, 0)
        ctypes.CDLL(None).syscall(number, 0, attributes, 0)


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


def end_with_thread_of(parent_pid: int) -> bool:
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


PIPE, NULL = subprocess.PIPE, subprocess.DEVNULL
# multiple of the time limits of children: on an emulator, one face search takes seconds
PATIENCE = float(os.environ.get("LFPIPE_PATIENCE", "1"))


def python(module: str, *words: str) -> list[str]:
    """The command that runs a module with this interpreter. -P: it imports nothing from the working
    directory, which may be anybody's.
    """
    return [sys.executable, "-P", "-m", module, *words]


class Child(subprocess.Popen[bytes]):
    """A running child process. ended_fd: can be read once it has ended. Raises OSError if none can
    be started.
    """

    def __init__(self, command: Sequence[str], line: bytes = b"", **options: Any) -> None:
        """line: written to its standard input. options: of `Popen`."""
        self.ended_fd, write_end = os.pipe()
        try:
            super().__init__(command, bufsize=0, stdin=PIPE, pass_fds=(write_end,), **options)
        except BaseException:
            os.close(self.ended_fd)
            raise
        finally:
            os.close(write_end)
        if line and self.stdin is not None:
            with contextlib.suppress(BrokenPipeError):  # `poll` then reports it
                self.stdin.write(line + b"\n")

    def wait_at_most(self, timeout_s: float | None = None) -> int | None:
        """Waits for its end; the exit code, or None if it still runs after timeout_s."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            return self.wait(timeout_s)
        return None

    def close(self) -> None:
        """Kills the child and closes the pipes. May be called again."""
        with self:  # closes the pipes, and waits
            self.kill()
        if self.ended_fd >= 0:
            os.close(self.ended_fd)
            self.ended_fd = -1


def end_with_parent() -> None:
    """In a child: sends SIGTERM to this process when its parent ends, or closes its standard
    input, which a fork of the parent may hold open.
    """
    signs = [0]
    with contextlib.suppress(AttributeError, OSError):  # not on this system
        signs.append(os.pidfd_open(os.getppid()))
    threading.Thread(target=_wait_for_parent, args=(signs,), name="parent", daemon=True).start()


def _wait_for_parent(signs: list[int]) -> None:
    while select.select(signs, [], [])[0] == [0] and os.read(0, 4096):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


MAX_LINE_BYTES = 1 << 20  # of the child's output; a longer line is not one of ours
MAX_LOG_BYTES = 2000  # the end of what the child wrote to stderr
# how a process ends when a library in it crashes
CRASHES = (signal.SIGSEGV, signal.SIGBUS, signal.SIGABRT, signal.SIGFPE, signal.SIGILL)
DAMAGED = "it is damaged, it seems: download it again, or convert it with another program"
SLOW = "check its disk or network drive; if it lies on neither, it is damaged, it seems"
SMALLER = "use smaller or fewer pictures, or convert them with another program"
LAST_OUTPUT_S = 0.5  # how long what a child wrote before its end may take to arrive

Report = Callable[..., None]  # report(key=value, ...): one line for the parent
# (request, report) -> result; raises UserError
Serve = Callable[[dict[str, Any], Report], dict[str, Any]]


class Worker:
    """The parent's side of a running child.

    module: run as `python -m`. subject: what the request is about, for messages. limit_s: time
    without a step, times PATIENCE. stderr: None for that of this process. fds: for a poller; call
    `read` when they are readable. on_step: called with every step. last: the newest. Raises
    UserError if no child can be started.
    """

    def __init__(
        self,
        module: str,
        request: dict[str, Any],
        subject: str,
        limit_s: float,
        stderr: int | None = PIPE,
    ) -> None:
        self.subject = subject
        self._limit_s = limit_s * PATIENCE
        self._verdict: dict[str, Any] | None = None
        self.last: dict[str, Any] = {}
        line = json.dumps(request).encode()
        with signals.blocked():
            self._process = Child(python(module), line, stdout=PIPE, stderr=stderr)
        pipes = (self._process.stdout, self._process.stderr)
        self._open = [pipe for pipe in pipes if pipe is not None]  # those that have not ended
        for pipe in self._open:
            os.set_blocking(pipe.fileno(), False)
        self._partial_line = self._log = b""  # of the last line, of what it wrote to stderr
        self._step_s = time.monotonic()
        self._reading = ""  # the file that it opened last

    def on_step(self, step: dict[str, Any]) -> None:
        """Keeps a step of the child, not checked. Subclasses keep what they need of it."""
        self.last = step

    @property
    def fds(self) -> list[int]:
        """Descriptors that wake the parent."""
        return [stream.fileno() for stream in self._open]

    @property
    def done(self) -> bool:
        """Whether the child has ended and its output is read, or it has exceeded its time."""
        return self._exit_code() is not None or time.monotonic() - self._step_s > self._limit_s

    def _exit_code(self) -> int | None:
        """The child's exit code, after its last output is read; None while it runs."""
        code = self._process.poll()
        end_s = time.monotonic() + LAST_OUTPUT_S
        while code is not None and self._open:
            left_s = end_s - time.monotonic()
            if left_s < 0 or not connection.wait(self.fds, left_s):
                self._open.clear()  # another process has them, and may write for ever
            self.read()
        return code

    def read(self) -> None:
        """Reads the child's output, at most 1 MB of it: an endless writer does not block the
        parent.
        """
        for _ in range(16):
            for stream in list(self._open):
                data = stream.read(1 << 16)  # None if nothing is available yet
                if data == b"":
                    self._open.remove(stream)
                elif data and stream is not self._process.stdout:
                    self._log = (self._log + data)[-MAX_LOG_BYTES:]
                elif data:
                    *lines, partial = (self._partial_line + data).split(b"\n")
                    self._partial_line = partial[-MAX_LINE_BYTES:]
                    for line in lines:
                        self._read_line(line)

    def _read_line(self, line: bytes) -> None:
        try:
            step = json.loads(line)
        except (ValueError, RecursionError):
            return
        if not isinstance(step, dict):
            return
        if "reading" in step:
            self._reading = str(step["reading"])
            return
        self._step_s = time.monotonic()
        if "ok" in step:
            self._verdict = step
        else:
            self.on_step(step)

    def wait(self, until: Callable[[], bool] = lambda: False) -> None:
        """Waits until the child has ended, or `until` holds."""
        while not self.done and not until():
            if self._open:
                connection.wait(self.fds, 0.1)
            else:
                self._process.wait_at_most(0.1)
            self.read()

    def result(self) -> dict[str, Any]:
        """The child's result, once it is done.

        Raises UserError if it refused, failed or took too long.
        """
        ended = self._exit_code()
        file = self._reading or self.subject
        self.close()
        verdict = self._verdict or {}
        if ended is None:
            raise UserError(f"{file}: no progress within {self._limit_s:g} s", SLOW)
        if verdict.get("ok") is True and isinstance(verdict.get("result"), dict):
            return dict(verdict["result"])
        if verdict.get("ok") is False and isinstance(verdict.get("error"), str):
            raise UserError(verdict["error"], str(verdict.get("remedy", "")))
        how = f"signal {-ended}" if ended < 0 else f"exit code {ended}"
        log = self._log.decode(errors="replace").strip()
        why = f"{file}: the process that read it ended with {how}" + (
            f": {log.splitlines()[-1]}" if log else ""
        )
        raise UserError(why, DAMAGED if ended > 0 or -ended in CRASHES else SMALLER)

    def close(self) -> None:
        """Kills the child."""
        self._process.close()
        self._open.clear()


def serve(work: Serve, memory_bytes: int) -> None:
    """The child's side: reads the request, works with limited memory, prints the verdict and ends
    the process.
    """
    signals.ignore()  # those of the terminal end the parent, which ends this process
    out = os.dup(1)
    os.dup2(2, 1)  # what libraries print does not belong into the answer
    lock = threading.Lock()
    reading = ""

    def report(**step: Any) -> None:
        nonlocal reading
        reading = step.get("reading", reading)
        data = json.dumps(step).encode() + b"\n"
        with lock:
            while data:
                data = data[os.write(out, data) :]

    request = json.loads(sys.stdin.buffer.readline())
    end_with_parent()
    with MemoryLimit(memory_bytes):
        try:
            report(ok=True, result=work(request, report))
        except UserError as error:
            report(ok=False, error=error.message, remedy=error.remedy)
        except MemoryError:
            needs = (
                f"{reading or 'it'}: needs more than {memory_bytes >> 20} MB of memory to be read"
            )
            report(ok=False, error=needs, remedy="use smaller or fewer pictures")
    os._exit(0)  # the thread still blocks in read


if __name__ == "__main__":
    end_with_parent()
    sys.argv = sys.argv[1:]
    runpy.run_module(sys.argv[0], run_name="__main__")
