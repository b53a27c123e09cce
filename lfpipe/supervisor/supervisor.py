"""A session: takes its name and lock, runs it, and cleans up, however it ends."""

import logging
from collections.abc import Callable
from types import FrameType

from lfpipe import log as session_log
from lfpipe.config import Config, SessionOptions
from lfpipe.host import limits, signals
from lfpipe.host.processes import usable_cores
from lfpipe.host.terminal import protect_output
from lfpipe.scene.open_scene import Packing
from lfpipe.supervisor import placement, rundir
from lfpipe.supervisor.live_session import LiveSession, Outcome
from lfpipe.supervisor.process_table import NAMES, STAGES
from lfpipe.supervisor.session_state import SessionState
from lfpipe.transport import control
from lfpipe.transport.session import Session

logger = logging.getLogger(__name__)


class Supervisor:
    """A session that begins with `run`. log: receives lines for people. packing: the packer, while it works on the disparity of
    the first scene.

    Raises UserError if a stage is configured for a missing core or an invalid niceness.
    """

    def __init__(
        self,
        session: Session,
        config: Config,
        options: SessionOptions,
        log: Callable[[str], None] = print,
        packing: Packing | None = None,
    ) -> None:
        self._session, self._tell, self._packing = session, log, packing
        self._signals: list[int] = []
        self._kill: Callable[[], None] = lambda: None
        where = "none" if options.lossless and config.governor.affinity == "auto" else config.governor.affinity
        self._cpus = placement.cores(where, {stage.name: stage.own_core for stage in STAGES}, usable_cores())
        self._nice = placement.niceness(config.governor.nice, NAMES)
        self._first = SessionState.first(config, options)

    def run(self, duration_s: float | None = None) -> Outcome:
        """Runs the session to its end: a command, a signal, duration_s (from when all stages are ready), the end of the
        source, or too many failures.

        Raises UserError before any process starts if the session is impossible (name in use, /dev/shm too small, ...).
        """
        limits.allow_files()
        with rundir.filled(self._session):
            swept = rundir.sweep()
            lock = rundir.acquire(self._session)
        protect_output("stdout", "stderr")
        try:
            log, signalled = session_log.kept_in(self._session.run_dir), signals.handled(self._signalled)
            with signalled, log, control.context() as ctx:
                if swept:
                    logger.info("removed what dead sessions left: %s", ", ".join(swept))
                with rundir.filled(self._session):
                    live = LiveSession(ctx, self._session, self._first, self._cpus, self._nice, self._tell, self._packing)
                self._kill = live.stages.kill
                with live:
                    outcome = live.loop(duration_s, self._signals, lambda: rundir.lost(self._session, lock))
                logger.info("session %s: %s; %s", self._session.name, outcome.reason, outcome.failure or "no failure")
        finally:
            session_log.keep_last(self._session.run_dir)
            rundir.release(self._session, lock)
        return outcome

    def _signalled(self, signum: int, _frame: FrameType | None) -> None:
        again = signum in self._signals and signum not in signals.SENT_TWICE
        self._signals.append(signum)
        if again:  # the second Ctrl-C ends at once
            self._kill()
