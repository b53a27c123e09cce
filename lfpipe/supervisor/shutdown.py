"""Ends the processes of a session, with time for stages that still write results."""

from collections.abc import Callable, Iterable

import attrs

from lfpipe.host import signals
from lfpipe.supervisor.stage_process import StageProcess
from lfpipe.transport.clock import now_ns

STOP_S, TERM_S, KILL_S = 0.9, 0.5, 5.0  # time limits after "stop", after SIGTERM, after SIGKILL
PASSES = ((STOP_S, signals.END), (TERM_S, signals.KILL), (KILL_S, None))


@attrs.define
class _Ending:
    process: StageProcess
    due_ns: int
    passes: int = 0
    logged: bool = False


def wait_for_end(processes: Iterable[StageProcess], log: Callable[[str], None]) -> None:
    """Waits until all processes have ended; the caller has asked them to stop. A late one gets SIGTERM, then SIGKILL, unless it
    saves results and makes progress. log: reports to people what the session waits for.
    """
    begin_ns = now_ns()
    waiting = [_Ending(process, begin_ns + int(STOP_S * 1e9)) for process in processes if process.alive]
    while waiting:
        for each in list(waiting):
            process = each.process
            process.join(0.01)
            process.reap()
            if not process.alive:
                waiting.remove(each)
            elif now_ns() < each.due_ns:
                continue
            elif words := process.saves:
                each.due_ns = now_ns() + int(STOP_S * 1e9)
                if not each.logged:
                    log(f"{process.stage.name}: {words}; press Ctrl-C again to end it at once")
                each.logged = True
            elif (signum := PASSES[each.passes][1]) is None:
                waiting.remove(each)
            else:
                process.signal(signum)
                each.passes += 1
                each.due_ns = now_ns() + int(PASSES[each.passes][0] * 1e9)
