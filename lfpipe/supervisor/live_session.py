"""A running session: its memory, stages, sockets and services, and the loop that applies what the
services yield.

The loop runs in the main thread; it never blocks on a child, and polls in one place.
"""

import contextlib
import logging
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial

import attrs
import zmq

from lfpipe._version import __version__
from lfpipe.config import converter
from lfpipe.config.modes import Lossless
from lfpipe.errors import plain, redacted
from lfpipe.host.file_lock import Lock
from lfpipe.host.processes import usable_cores
from lfpipe.scene.open_scene import Packing
from lfpipe.supervisor import process_table
from lfpipe.supervisor.control_service import Control, Delivery
from lfpipe.supervisor.control_sockets import ControlSockets
from lfpipe.supervisor.effects import (
    IDLE_TICK_NS,
    TICK_NS,
    Answer,
    Change,
    Effect,
    Notify,
    Outcome,
    Publish,
    Respond,
    Service,
)
from lfpipe.supervisor.end_conditions import FilesInPlace, Limits
from lfpipe.supervisor.fault_watch import FaultWatch
from lfpipe.supervisor.idle_watch import IdleWatch
from lfpipe.supervisor.metrics import SessionMetrics, session_metrics
from lfpipe.supervisor.pending_answers import PendingAnswers
from lfpipe.supervisor.picture_lease import PictureLease
from lfpipe.supervisor.process_table import SOURCE, STAGES, Stage
from lfpipe.supervisor.quality_service import Quality
from lfpipe.supervisor.reply_executor import ReplyExecutor
from lfpipe.supervisor.rollback import Rollback
from lfpipe.supervisor.session_state import SessionState
from lfpipe.supervisor.session_store import SessionStore
from lfpipe.supervisor.stage_process import StageProcesses
from lfpipe.supervisor.stage_service import StageFailures, StageStarts
from lfpipe.transport.clock import MS_NS, now_ns
from lfpipe.transport.ring_io import StageSpec
from lfpipe.transport.session import Session, SessionManifest

logger = logging.getLogger(__name__)


class LiveSession:
    """One session. stages: its processes.

    Raises UserError, OSError if it cannot start, and then leaves nothing behind.
    """

    def __init__(
        self,
        session: Session,
        state: SessionState,
        notify: Callable[[str], None],
        packing: Packing | None = None,
    ) -> None:
        placed = state.config.governor.affinity == "auto" and not isinstance(
            state.options.clock, Lossless
        )
        self._cpus = process_table.cores(usable_cores()) if placed else {}
        self._session = session
        self._notify_user = notify
        self._outcome: Outcome | None = None
        with contextlib.ExitStack() as parts:  # each is closed, even if another one raises
            self._store = parts.enter_context(closing(SessionStore(session, state)))
            self._table = self._store.table
            self._started_ns = self._begin().started_ns
            self._sockets = parts.enter_context(
                closing(ControlSockets(session.run_dir, self.notify))
            )
            self._pending = PendingAnswers()
            self._replies = parts.enter_context(
                closing(
                    ReplyExecutor(
                        store=self._store,
                        sockets=self._sockets,
                        pending=self._pending,
                        metrics=self.metrics,
                        notify=self.notify,
                        packing=packing,
                    )
                )
            )
            ask_to_stop = partial(self._sockets.send, message={"cmd": "stop"})
            self.stages = parts.enter_context(
                closing(StageProcesses(session, self._table, self._spec, ask_to_stop, self.notify))
            )
            self._parts = parts.pop_all()
        self._control = Control(self._sockets, self._pending)
        self._delivery = Delivery(self._sockets, self._pending, self._store, self.stages)
        self._faults = FaultWatch(self._table)

    def close(self) -> None:
        """Stops the stages and removes the memory."""
        self._parts.close()

    def loop(self, duration_s: float | None, signals: Sequence[int], lock: Lock) -> Outcome:
        """Runs the session to its end. signals: received signals. lock: that of the session."""
        rollback = Rollback(self.stages, self._pending)
        services: list[Service] = [  # in the order of their updates
            StageFailures(self.stages, rollback),
            rollback,
            PictureLease(),
            self._faults,
            Quality(self._table, self._cpus),
            IdleWatch(self._table),
            self._control,
            *self._replies.services,
            self._delivery,
            StageStarts(self.stages),
            FilesInPlace(lock, str(self._session.run_dir), self._store),
            Limits(self.stages, duration_s, signals),
        ]
        while True:
            for service in services:
                self._update(service)
            if self._outcome is not None:
                break
            self._poll(services)
        outcome = self._outcome
        final = self.metrics()
        self._faults.note_last(now_ns())
        self.stages.stop()
        if outcome.failure is None:
            failures = self._faults.failures_at_end(self.stages, self._store.state, outcome)
            outcome = next(failures, outcome)
        for service in (self._control, self._delivery):  # final messages of the stages
            self._update(service)
        return attrs.evolve(outcome, final=final)

    def _poll(self, services: Sequence[Service]) -> None:
        poller = zmq.Poller()
        for service in services:
            for fd in service.fds:
                poller.register(fd, zmq.POLLIN)
        t_ns = now_ns()
        longest_ns = IDLE_TICK_NS if self._store.state.idle else TICK_NS
        deadlines = (service.wait_ns(t_ns) for service in services)
        wait_ns = min((left for left in deadlines if left is not None), default=longest_ns)
        wait_ns = min(wait_ns, longest_ns)
        poller.poll(max(0, -(-wait_ns // MS_NS)))

    def _update(self, service: Service) -> None:
        try:
            for effect in service.update(self._store.state, now_ns()):
                self._apply(effect)
        except Exception as error:
            if not service.guarded:
                raise
            self._replies.refusal(error)

    def _apply(self, effect: Effect) -> None:
        match effect:
            case Change(change):
                state = change(self._store.state)
                if state is not self._store.state:
                    self._store.apply(state)
            case Respond(request, reply):
                self._end(self._replies.respond(request, lambda: reply(self._store.state)))
            case Answer(request, answer):
                self._replies.answer(request, answer)
            case Publish(topic, values):
                self._sockets.publish(topic, **values)
            case Notify(text):
                self.notify(text)
            case Outcome():
                self._end(effect)

    def _end(self, outcome: Outcome | None) -> None:
        """Ends the session; only the first outcome counts."""
        self._outcome = self._outcome or outcome

    def _begin(self) -> SessionManifest:
        """Writes the session's manifest and the head of its log."""
        options = converter().unstructure(self._store.state.options)
        options["display"].pop("lock_code", None)
        if "source" in options["viewer"]:
            options["viewer"]["source"] = redacted(options["viewer"]["source"])
        manifest = SessionManifest.begin(self._session, options)
        logger.info("session %s: lfpipe %s, pid %d", manifest.session, __version__, manifest.pid)
        logger.info("options: %s", {key: value for key, value in options.items() if value})
        return manifest

    def _spec(self, stage: Stage) -> StageSpec:
        state = self._store.state
        return StageSpec(
            name=stage.name,
            module=stage.module,
            session=self._session,
            config=state.config,
            rev=state.rev,
            options=state.options,
            consumers=process_table.consumers(),
            others=tuple(
                other.name for other in STAGES if other is not stage and other.needed(state.options)
            ),
            source=SOURCE,
            cpus=self._cpus.get(stage.name, ()),
        )

    def metrics(self) -> SessionMetrics:
        """The metrics of the session."""
        table = self._table
        return session_metrics(
            self._session.name, table.rows, table.metrics, table.session, self._started_ns
        )

    def notify(self, text: str) -> None:
        """Notifies the user, and logs it. text: may quote anything."""
        logger.info(text)
        self._notify_user(plain(text))
