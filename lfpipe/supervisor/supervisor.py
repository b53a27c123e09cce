"""Runs a session from its name and lock to the cleanup after any end."""

import contextlib
import logging
from collections.abc import Callable, Iterator
from types import FrameType

from lfpipe import log as session_log
from lfpipe.config import Config, SessionOptions
from lfpipe.host import limits, signals
from lfpipe.host.file_lock import Lock
from lfpipe.scene.open_scene import Packing
from lfpipe.supervisor import rundir
from lfpipe.supervisor.effects import Outcome
from lfpipe.supervisor.live_session import LiveSession
from lfpipe.supervisor.session_state import SessionState
from lfpipe.transport.session import Session

logger = logging.getLogger(__name__)


@contextlib.contextmanager
def _acquired(session: Session) -> Iterator[tuple[Session, Lock]]:
    """The session with its token, and its lock, where the limits of this system allow one. Raises
    UserError.
    """
    limits.allow_files()
    with rundir.filled(session):
        lock = rundir.acquire(session)
    try:
        yield session.with_token(), lock
    finally:
        rundir.release(session, lock)


def try_session(session: Session, config: Config, options: SessionOptions) -> Outcome:
    """As `run_session`, until all stages are ready. Keeps no log, and removes nothing of others."""
    state = SessionState.first(config, options)
    with (
        _acquired(session) as (own, lock),
        rundir.filled(own),
        contextlib.closing(LiveSession(own, state, logger.info)) as live,
    ):
        return live.loop(0.0, (), lock)


def run_session(
    session: Session,
    config: Config,
    options: SessionOptions,
    notify: Callable[[str], None] = print,
    duration_s: float | None = None,
    packing: Packing | None = None,
) -> Outcome:
    """Runs a session to its end: a command, a signal, duration_s (from when all stages are ready),
    the end of the source, or too many failures. notify: receives lines for the user. packing: the
    packer, while it works on the disparity of the first scene.

    Raises UserError before any process starts if the session is impossible: its name is in use,
    /dev/shm is too small, a stage is configured for a missing core, ...
    """
    arrived: list[int] = []
    live: LiveSession | None = None

    def take_signal(signum: int, _frame: FrameType | None) -> None:
        again = signum in arrived and signum not in signals.SENT_TWICE
        arrived.append(signum)
        if again and live is not None:  # the second Ctrl-C ends at once
            live.stages.kill()

    with _acquired(session) as (session, lock):
        try:
            log = session_log.kept_in(session.run_dir)
            signalled = signals.handled(take_signal)
            with signalled, log:
                with rundir.filled(session):
                    if swept := rundir.sweep():
                        logger.info("removed what dead sessions left: %s", ", ".join(swept))
                    state = SessionState.first(config, options)
                    live = LiveSession(session, state, notify, packing)
                with contextlib.closing(live):
                    outcome = live.loop(duration_s, arrived, lock)
                what = outcome.failure or "no failure"
                logger.info("session %s: %s; %s", session.name, outcome.reason, what)
        finally:
            session_log.keep_last(session.run_dir)
    return outcome
