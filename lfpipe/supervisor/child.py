"""A stage's process, `python -m lfpipe.supervisor.child`: signals, exit with the parent, cores and
error reports for the stage's `main`. It reads its `StageSpec` from standard input.
"""

import contextlib
import faulthandler
import importlib
import json
import logging
import os
import signal
import sys
import traceback
from pathlib import Path
from types import FrameType
from typing import NoReturn, TextIO

from lfpipe import log
from lfpipe.config import converter
from lfpipe.errors import UserError
from lfpipe.files.safe_files import write_file
from lfpipe.host import signals, worker
from lfpipe.host.worker import end_with_parent
from lfpipe.plugins import IN_USE, blaming
from lfpipe.supervisor import rundir
from lfpipe.transport.context import Context, StageSpec
from lfpipe.transport.status import State

logger = logging.getLogger(__name__)
EXIT_USER = 2  # a user error: a restart cannot help
EXIT_TERMINATED = 128 + signal.SIGTERM  # as a shell reports it


def crash_report_path(run_dir: Path, what: str, stage: str) -> Path:
    """The file to which a stage writes a user error ("error"), or its "stack" when it hangs (on
    SIGUSR1), fails or crashes.
    """
    return run_dir / f"{what}.{stage}"


def start_line(spec: StageSpec) -> bytes:
    """The first input of a stage's process."""
    return json.dumps([os.getpid(), converter().unstructure(spec)]).encode()


def main() -> None:
    """Entry point of the process."""
    # the terminal sends signals to the whole group; only the supervisor acts on them
    signals.ignore()
    parent_pid, plain = json.loads(sys.stdin.buffer.readline())
    end_with_parent()
    if not worker.end_with_thread_of(parent_pid):
        return
    spec = converter().structure(plain, StageSpec)
    worker.set_up(f"lfpipe-{spec.name}")
    run_dir = spec.session.run_dir
    stack = crash_report_path(run_dir, "stack", spec.name).open("w")
    faulthandler.enable(stack)
    faulthandler.register(signals.LEAVE_STACK, stack)
    log.set_up()
    with log.kept_in(run_dir):
        _run_stage(spec, parent_pid, run_dir, stack)


def _run_stage(spec: StageSpec, parent_pid: int, run_dir: Path, stack: TextIO) -> NoReturn:
    context = Context(spec)

    terminated = []

    def stop(signum: int, _frame: FrameType | None) -> None:
        terminated.append(signum)
        context.stopping = True

    signal.signal(signal.SIGTERM, stop)
    code = 0
    try:
        worker.run_on(spec.cpus)
        import cv2

        cv2.setNumThreads(1)  # the plan is one core per stage; thread pools would break it
        with blaming(IN_USE):
            importlib.import_module(spec.module).main(context)
    except UserError as error:
        logger.info("%s: %s", spec.name, error)
        write_file(crash_report_path(run_dir, "error", spec.name), error.to_json())
        code = EXIT_USER
    except Exception:
        logger.exception("%s failed", spec.name)
        if os.getppid() == parent_pid:
            traceback.print_exc(file=stack)
            stack.flush()
            sys.excepthook(*sys.exc_info())
            code = 1
    if terminated and code == 0:
        # its work is not finished; the supervisor ignores this code if it requested the stop
        code = EXIT_TERMINATED
    context.row["state"] = State.STOPPING
    context.close()
    # The supervisor was killed: the last stage cleans up. One that dies closes its files, which
    # ends this process, before another process becomes its parent.
    if terminated or os.getppid() != parent_pid:
        rundir.sweep_own(run_dir)
    with contextlib.suppress(OSError):  # the terminal is closed
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(code)  # threads of libraries (MediaPipe, SDL) must not block the exit


if __name__ == "__main__":
    main()
