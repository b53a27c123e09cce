"""What every stage's process does before and after its `main`: signals, death with the parent, cores, last words."""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import importlib
import os
import signal
import sys
import traceback
from pathlib import Path
from types import FrameType

from lfpipe.errors import UserError
from lfpipe.supervisor import rundir, signals, streams
from lfpipe.supervisor.placement import settle
from lfpipe.transport.context import Context, StageSpec
from lfpipe.transport.status import State

PR_SET_PDEATHSIG, PR_SET_TIMERSLACK = 1, 29
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
KEPT_BYTES = 32 << 20  # the most that glibc takes; a frame of 4K has 25 MB
EXIT_USER = 2  # a mistake of the user's: starting again cannot help
EXIT_TERMINATED = 128 + signal.SIGTERM


def _prctl(option: int, value: int) -> None:
    ctypes.CDLL(None).prctl(option, value, 0, 0, 0)


def _keep_memory() -> None:
    """Has malloc keep what is freed for the next frame: pictures given back to the kernel and faulted in anew, page by page, cost
    1 ms a frame of 640x480."""
    with contextlib.suppress(AttributeError):  # another C library: it does as it does
        libc = ctypes.CDLL(None)
        libc.mallopt(M_MMAP_THRESHOLD, KEPT_BYTES)
        libc.mallopt(M_TRIM_THRESHOLD, 2 * KEPT_BYTES)


def error_file(run_dir: Path, stage: str) -> Path:
    """Where a stage leaves what it died of."""
    return run_dir / f"error.{stage}"


def stack_file(run_dir: Path, stage: str) -> Path:
    """Where the last stack of a stage goes: of a hung one, on SIGUSR1, of one that fails, and of one that crashes."""
    return run_dir / f"stack.{stage}"


def run(spec: StageSpec, parent_pid: int) -> None:
    """Entry of a spawned process."""
    signals.ignore()  # the terminal sends them to the whole group; the supervisor decides
    streams.protect("stdout", "stderr")
    _prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent_pid:
        return  # it died before the line above
    _prctl(PR_SET_TIMERSLACK, 1)  # sleeps end on time, not up to 50 us after
    _keep_memory()
    Path("/proc/self/comm").write_text(f"lfpipe-{spec.name}"[:15])
    run_dir = spec.session.run_dir
    stack = stack_file(run_dir, spec.name).open("w")
    faulthandler.enable(stack)
    faulthandler.register(signal.SIGUSR1, stack)
    context = Context(spec)

    terminated = []

    def stop(signum: int, _frame: FrameType | None) -> None:
        terminated.append(signum)
        context.stopping = True

    signal.signal(signal.SIGTERM, stop)
    code = 0
    try:
        settle(spec.cpus, spec.nice)
        import cv2

        cv2.setNumThreads(1)  # a core each is the plan; a thread pool per process would break it
        importlib.import_module(spec.module).main(context)
    except UserError as error:
        error_file(run_dir, spec.name).write_text(f"{error.message}\n{error.remedy}")
        code = EXIT_USER
    except Exception:
        if os.getppid() == parent_pid:
            traceback.print_exc(file=stack)
            stack.flush()
            sys.excepthook(*sys.exc_info())
            code = 1
    if terminated and code == 0:
        code = EXIT_TERMINATED  # not the end of the work: who was told to stop by the supervisor is not asked for a code
    context.row["state"] = State.STOPPING
    context.close()
    if os.getppid() != parent_pid:
        rundir.sweep()  # the supervisor was killed: the last one out puts the lights off
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # libraries with threads of their own (MediaPipe, SDL) may not hold up the end
