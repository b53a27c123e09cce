"""What every stage's process does before and after its `main`: signals, death with the parent, cores, last words."""

from __future__ import annotations

import faulthandler
import importlib
import os
import signal
import sys
import traceback
from pathlib import Path
from types import FrameType

from lfpipe.errors import UserError
from lfpipe.host import processes, signals, streams
from lfpipe.host.parent import end_with_parent
from lfpipe.supervisor import rundir
from lfpipe.supervisor.placement import settle
from lfpipe.transport.context import Context
from lfpipe.transport.stage_spec import StageSpec
from lfpipe.transport.status import State

EXIT_USER = 2  # a mistake of the user's: starting again cannot help
EXIT_TERMINATED = 128 + signal.SIGTERM


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
    if not end_with_parent(parent_pid):
        return
    processes.set_up(f"lfpipe-{spec.name}")
    run_dir = spec.session.run_dir
    stack = stack_file(run_dir, spec.name).open("w")
    faulthandler.enable(stack)
    signals.leave_stack_on_request(stack)
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
