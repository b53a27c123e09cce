"""A running session: one object whose `step` does, in a fixed order, what there is to do; and a
session from its name and lock to the cleanup after any end.

The loop runs in the main thread; it never blocks on a child, and polls in one place.
"""

import contextlib
import logging
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from functools import partial
from types import FrameType
from typing import Any

import attrs
import zmq

from lfpipe import log as session_log
from lfpipe._version import __version__
from lfpipe.config import Config, SceneSummary, SessionOptions, converter
from lfpipe.config.session_options import Lossless
from lfpipe.errors import UserError, plain, redacted
from lfpipe.host import signals
from lfpipe.host.files import Lock, allow_files
from lfpipe.host.worker import usable_cores
from lfpipe.notices import FAULT_NS, Fault, faults
from lfpipe.scene.pack import Packing
from lfpipe.supervisor import child, process_table, rundir
from lfpipe.supervisor.control_sockets import (
    ControlSockets,
    PendingAnswers,
    Request,
    SceneLoads,
)
from lfpipe.supervisor.metrics import QualityControl, SessionMetrics, session_metrics
from lfpipe.supervisor.process_table import NAMES, SHOWN_BY, SOURCE, STAGES, TRACKED_BY, Stage
from lfpipe.supervisor.requests import Reply, on_complete, on_load, respond
from lfpipe.supervisor.session_state import SessionState, SessionStore
from lfpipe.supervisor.stage_process import (
    MAX_FAILURES,
    MAX_RESTARTS_WINDOW_S,
    StageProcess,
    StageProcesses,
)
from lfpipe.transport.context import BEAT_NS, IDLE_BEAT_NS, StageSpec
from lfpipe.transport.control import EXECUTED, BadMessage, Message, Session, SessionManifest
from lfpipe.transport.ring import MS_NS, SECOND_NS, now_ns
from lfpipe.transport.status import Row

logger = logging.getLogger(__name__)
PENDING_NS = 4 * MS_NS  # between two checks of the stages while answers wait for them
LAST_S = 0.02  # without a message, until those of the stages that have ended were read
IDLE_NS = 10 * SECOND_NS  # longer than a viewer turns away or leans out
ASKED_OFTEN = ("hello", "status", "pictures")  # requests that change nothing
SHOWN_TOPICS = ("source", "notice")  # telemetry for people
LOGGED_TOPICS = ("parallax",)  # it changes with the viewer's distance
REDUCED = "CPU overloaded: picture quality reduced (`lfpipe monitor` shows how and why)"
RECORDER_ENDED = "the recorder stopped early and nothing else was running"
INTERNAL = {
    "ok": False,
    "error": "internal error",
    "remedy": "report the stack in its log; the session continues",
}
REPLACED = {
    "ok": False,
    "error": "another scene was asked for in the meantime",
    "remedy": "",
    "replaced": True,
}


@attrs.define(kw_only=True)
class Outcome:
    """The end of a session."""

    reason: str
    """In a few words."""
    source_ended: bool = False
    """Whether the source has ended."""
    signum: int = 0
    """The signal, if that is the cause."""
    failure: str | None = None
    """The message for the user; None for a normal end."""
    remedy: str = ""
    user_error: bool = False
    """Whether a restart cannot help until the user has changed something."""
    final: SessionMetrics | None = None
    """The state at the end."""


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
        free = isinstance(state.options.clock, Lossless)
        self._cpus = {} if free else process_table.cores(usable_cores())
        self._session = session
        self._notify_user = notify
        with contextlib.ExitStack() as parts:  # each is closed, even if another one raises
            self._store = parts.enter_context(closing(SessionStore(session, state)))
            self._table = table = self._store.table
            self._started_ns = self._begin().started_ns
            self._sockets = sockets = parts.enter_context(closing(ControlSockets(session.run_dir)))
            show = partial(sockets.send, SHOWN_BY)
            self._loads = parts.enter_context(closing(SceneLoads(show, packing)))
            ask_to_stop = partial(sockets.send, message={"cmd": "stop"})
            self.stages = parts.enter_context(
                closing(StageProcesses(session, table, self._spec, ask_to_stop, self.notify))
            )
            self.close = parts.pop_all().close  # stops the stages and removes the memory
        self._apply = self._store.apply
        self._pending = PendingAnswers()
        # since when all stages work with the newest change, and their outputs then
        self._trial: tuple[int, dict[str, int]] | None = None
        self._quality = QualityControl(self._cpus)
        self._reduced = False  # whether the user knows
        self._faults: list[Fault] = []  # the last ones
        self._failures: deque[tuple[StageProcess, int]] = deque()  # failed, not handled yet
        self._active_ns = 0  # when somebody looked
        self._end_ns: int | None = None  # of the duration, once all stages are ready
        self._outcome: Outcome | None = None

    @property
    def state(self) -> SessionState:
        """The current state."""
        return self._store.state

    def loop(self, duration_s: float | None, signals: Sequence[int], lock: Lock) -> Outcome:
        """Runs the session to its end. duration_s: from when all stages are ready. signals:
        received signals. lock: that of the session.
        """
        while True:
            self.step()
            self._check_files(lock)
            self._check_limits(duration_s, signals)
            if self._outcome is not None:
                return self._ending(self._outcome)
            self._poll()

    def step(self) -> None:
        """Does what there is to do, in this order: a failed stage may undo a change, which requests
        that arrive now must see; answers follow what has changed; stages start last, as the state
        is by then.
        """
        self._handle_failures()
        self._confirm_change()
        self._end_lease()
        self._watch_faults()
        self._adapt_quality()
        self._watch_idle()
        for receive in (self._receive_messages, self._receive_scenes):
            try:
                receive()
            except Exception as error:  # their content comes from outside
                self.refusal(error)
        self._deliver()
        self._start_stages()

    def _poll(self) -> None:
        """Sleeps until a descriptor can be read, or something is due."""
        poller = zmq.Poller()
        for part in (self.stages, self._sockets, self._loads):
            for fd in part.fds:
                poller.register(fd, zmq.POLLIN)
        waits_ns = [IDLE_BEAT_NS if self.state.idle else BEAT_NS]  # as the stages
        if self._failures:
            waits_ns.append(0)
        if self._pending:
            waits_ns.append(PENDING_NS)
        if self._end_ns is not None:
            waits_ns.append(self._end_ns - now_ns())
        poller.poll(max(0, -(-min(waits_ns) // MS_NS)))

    def _ending(self, outcome: Outcome) -> Outcome:
        """Stops the stages; returns how the session has ended."""
        final = self.metrics()
        self._faults = list(faults(self._table.rows, now_ns()))  # before the stages stop
        self.stages.stop()
        if outcome.failure is None:
            outcome = self._with_failure(outcome)
        end_ns = now_ns() + SECOND_NS
        # the last messages of the stages
        while zmq.select(self._sockets.fds, [], [], LAST_S)[0] and now_ns() < end_ns:
            self._receive_messages()
        self._deliver()
        return attrs.evolve(outcome, final=final)

    def _end(self, reason: str, **more: Any) -> None:
        """Ends the session; only the first outcome counts. more: as in `Outcome`."""
        self._outcome = self._outcome or Outcome(reason=reason, **more)

    # stages

    def _handle_failures(self) -> None:
        """Handles a failed stage by a rollback, a restart, or the end of the session."""
        self._failures.extend(self.stages.check())
        if not self._failures:
            return
        # one at a time: the next one may fail on another state
        process, code = self._failures.popleft()
        name = process.stage.name
        row = process.row
        state = self.state
        mistake = process.mistake() if code == child.EXIT_USER else None
        # once a stage has acknowledged a change, only its own error is blamed on it
        own_error = code > 0 and code != child.EXIT_TERMINATED
        is_new = state.revertible != state.known_good
        if is_new and (own_error or int(row["config_rev"]) < state.rev):
            self._undo(name, mistake or UserError(f"{name} fails with it"))
            return
        first = not row["seq"]  # it has never worked
        # later in a live session, the missing thing may return
        if mistake and (first or isinstance(state.options.clock, Lossless)):
            self._end(
                f"{name} could not {'start' if first else 'continue'}",
                failure=mistake.message,
                remedy=mistake.remedy,
                user_error=True,
            )
            return
        phase = "RUNNING" if row["ready_ns"] else "STARTING"
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        why = f": {mistake.message}" if mistake else ""
        last = int(row["source_seq"])
        self._sockets.publish("failed", stage=name, code=code, phase=phase, source_seq=last)
        if not process.failed():
            self.notify(f"{name} ended with {how} in {phase}{why}; restarting")
            return
        stack = process.last_stack()
        many = f"{name} failed {MAX_FAILURES} times in {MAX_RESTARTS_WINDOW_S:.0f} s"
        ending = f"its last stack:\n{stack}" if stack else "it left no stack"
        self._end(
            many,
            failure=f"{many}, last in {phase} with {how}{why}, after source_seq {last}; {ending}",
            remedy="see the messages above; `lfpipe doctor` checks the machine",
        )

    def _undo(self, stage: str, error: UserError) -> None:
        """Undoes the newest change, on which a stage failed.

        This does not count as a failure of the stage: `ctl set` must not end a session.
        """
        self._apply(self.state.rolled_back())
        refusal = {"error": error.message, "remedy": error.remedy}
        for request, answer in self._pending.refuse_changes(refusal):
            self._answer(request, answer)
        why = f"{error.message} ({error.remedy})" if error.remedy else error.message
        self._sockets.publish("refused", stage=stage, why=why)
        self.notify(f"the last change is rolled back: {why}")

    def _confirm_change(self) -> None:
        """Marks the newest change as known to work once every stage has used it and produced
        outputs for FAULT_NS: a stage that cannot use it fails sooner, and a part that does not work
        is reported by then.
        """
        state, t_ns = self.state, now_ns()
        processes = self.stages.needed(state.options)
        outputs = {process.stage.name: int(process.row["seq"]) for process in processes}
        applied = self.stages.have_applied(state.rev, state.options)
        if state.revertible == state.known_good or not applied:
            self._trial = None
        elif self._trial is None:
            self._trial = t_ns, outputs
        elif t_ns - self._trial[0] >= FAULT_NS and all(
            count > self._trial[1].get(name, 0) for name, count in outputs.items()
        ):
            self._apply(state.settled())

    def _start_stages(self) -> None:
        """Starts the stages that the session needs, and ends one that needs none any more."""
        options = self.state.options
        self.stages.ensure_running(options)
        if self.stages.finished(self.state.level.every):
            self._end("the source has ended", source_ended=True)
        if not self.stages.needed(options, or_alive=True):
            self._end(RECORDER_ENDED, failure=RECORDER_ENDED, remedy="see the messages above")

    # the course of the session

    def _end_lease(self) -> None:
        """Removes the ring of pictures when its lease expires."""
        if self.state.options.pictures and now_ns() > self.state.pictures_until_ns:
            self._apply(self.state.without_pictures())

    def _watch_faults(self) -> None:
        """Notifies of new faulty parts of stages."""
        texts = {fault.text for fault in self._faults}
        broken = list(faults(self._table.rows, now_ns()))
        self._faults = broken or self._faults
        for fault in broken:
            if fault.text not in texts:
                self.notify(fault.text)

    def _adapt_quality(self) -> None:
        """Changes the level of quality with the load of the stages."""
        state = self.state
        if state.idle:
            return  # with little to do, the stages say nothing about the load
        step = self._quality.sample(state, self._table.rows, now_ns())
        if step is not None:
            self._apply(state.with_level(step.level))
        level, lowest = self.state.level, len(state.levels) - 1
        self._table.session[()] = level.number, lowest, level.words.encode()  # for monitors
        if step is None:
            return
        words, why = level.words, step.reason
        logger.info("quality level %d of %d, %s: %s", level.number, lowest, words, why)
        self._sockets.publish(
            "level", level=level.number, lowest=lowest, words=words, stage=step.stage, why=why
        )
        if level.number and not self._reduced:
            self._reduced = True
            self.notify(REDUCED)

    def _watch_idle(self) -> None:
        """Notices that nobody has looked, or moved the mouse, for a while, so that stages work
        less.
        """
        state, t_ns = self.state, now_ns()
        options = state.options
        track, render = (
            Row(self._table.rows[name], self._table.metrics[name])
            for name in (TRACKED_BY, SHOWN_BY)
        )
        looks = track["face"] if options.viewer.tracked else not render["resting"]
        must_not_rest = options.record or isinstance(options.clock, Lossless)
        if looks or must_not_rest or state.paused or not self._active_ns:
            self._active_ns = t_ns
        idle = t_ns - self._active_ns > IDLE_NS
        if idle != options.idle:
            self._apply(state.changed(idle=idle))

    def _check_files(self, lock: Lock) -> None:
        """Ends a session whose lock was removed: it no longer receives commands, and the next
        session of that name cannot detect it.
        """
        if not lock.in_place():
            self._end(
                "its files were removed",
                failure=f"{self._session.run_dir} was removed while the session ran",
                remedy="find the program that cleans that folder, and exclude lfpipe-*",
            )

    def _check_limits(self, duration_s: float | None, signals: Sequence[int]) -> None:
        """Ends a session on a signal, or after its duration."""
        if signals:
            self._end("interrupted", signum=signals[0])
        if duration_s is None:
            return
        t_ns = now_ns()
        if self._end_ns is None and all(
            process.row["ready_ns"] for process in self.stages.needed(self.state.options)
        ):
            self._end_ns = t_ns + int(duration_s * SECOND_NS)
        if self._end_ns is not None and t_ns >= self._end_ns:
            self._end("finished (--duration reached)")

    def _with_failure(self, outcome: Outcome) -> Outcome:
        """The outcome, or a failure that overrides a normal end: an output that a stage of a
        lossless session could not write at its end, a part that never worked, an output that ended
        early.
        """
        for process in self.stages if isinstance(self.state.options.clock, Lossless) else ():
            if mistake := process.mistake():
                return Outcome(
                    reason=f"{process.stage.name} could not end",
                    failure=mistake.message,
                    remedy=mistake.remedy,
                    user_error=True,
                )
        rows = self._table.rows
        never = [fault.text for fault in self._faults if not fault.has_worked]
        if rows[TRACKED_BY]["restarts"] and not rows[TRACKED_BY]["seq"]:
            never.append(f"{TRACKED_BY} failed before its first eyes")
        lost = sum(int(row["lost_outputs"]) for row in rows.values())
        if never:
            failure = f"{outcome.reason}, but {never[0]}: it never worked"
            remedy = "choose another one with --set track.engine or track.filter"
        elif lost:
            files = "a file of the session is" if lost == 1 else f"{lost} files of the session are"
            failure = f"{outcome.reason}, but {files} incomplete"
            remedy = "see the messages above; free disk space, or use files on another disk"
        else:
            return outcome
        return attrs.evolve(outcome, failure=failure, remedy=remedy)

    # requests and telemetry

    def _receive_messages(self) -> None:
        """Handles the requests and telemetry that have arrived."""
        for message in self._sockets.messages():
            if isinstance(message, Request):
                self._respond(message, partial(self._reply, message))
            elif message.get("topic") in (*SHOWN_TOPICS, *LOGGED_TOPICS):
                self._show(message)

    def _show(self, message: Message) -> None:
        """Shows the user telemetry for people, or logs it."""
        notes = message.get("notes")
        for text in notes if isinstance(notes, list) and notes else [message.get("text")]:
            if isinstance(text, str) and text:
                if message["topic"] in LOGGED_TOPICS:
                    logger.info("%.500s", text)
                else:
                    self.notify(plain(text))

    def _reply(self, request: Request) -> Reply | None:
        request.decode()
        if request.command == EXECUTED and request.sender in NAMES:
            self._pending.executed(request.sender, request.message)
            return None
        level = logging.DEBUG if request.command in ASKED_OFTEN else logging.INFO
        logger.log(level, "request %.500s", request.message)
        return respond(self.state, request.message, now_ns(), request.sender)

    def _respond(self, request: Request, reply: Callable[[], Reply | None]) -> None:
        """Executes the reply to a request, if it has one; any error becomes the answer."""
        try:
            if result := reply():
                self._execute(request, result)
        except Exception as error:
            answer = self.refusal(error)
            if request.sender in NAMES:  # nobody reads a stage's answers
                remedy = f" ({answer['remedy']})" if answer.get("remedy") else ""
                self.notify(f"{answer['error']}{remedy}")
            self._answer(request, answer)

    def refusal(self, error: Exception) -> Message:
        """The answer for an error; a defect is logged with its stack."""
        if isinstance(error, UserError):
            answer = {"ok": False, "error": error.message, "remedy": error.remedy}
        elif isinstance(error, BadMessage):
            # parts of the text come from outside
            answer = {"ok": False, "error": plain(str(error))}
        else:
            stack = "".join(traceback.format_exception(error))
            self.notify(f"internal error while handling a message; the session continues\n{stack}")
            answer = INTERNAL
        logger.info("refused: %s", answer["error"])
        return answer

    def _answer(self, request: Request, answer: Message) -> None:
        self._sockets.answer(request, self.state.rev, answer)

    def _execute(self, request: Request, reply: Reply) -> None:
        """Executes a reply; answers now, or once the stages have applied its state, or executed the
        request: those that run by a message, and those that start with the state by their
        `StageSpec`.
        """
        if reply.load is not None:
            if replaced := self._loads.want(request, reply.load):
                self._answer(replaced, REPLACED)
            return
        answer = {"ok": True, **reply.answer}
        if reply.with_stages:
            answer |= self.metrics().to_dict()
        before = self.state
        self._apply(reply.state or before)
        state = self.state
        if not reply.executed_by and state.rev == before.rev:
            self._answer(request, answer)
        else:
            on_trial = state.replaces_revertible_of(before)
            number = self._pending.add(request, reply, answer, state.rev, on_trial, now_ns())
            for stage in reply.executed_by if reply.state is None else ():
                # nothing else of the request reaches a stage
                command = {"cmd": request.command, "number": number, **reply.payload}
                self._sockets.send(stage, command)
        if reply.stop:
            closed = request.sender == SHOWN_BY
            self._end("the window was closed" if closed else "stopped by command")

    def _receive_scenes(self) -> None:
        """Shows scenes that are packed now."""
        for load, scene in self._loads.events():
            if load.request is not None:
                message = load.request.message
                self._respond(load.request, partial(self._loaded, message, load.packing, scene))
            elif isinstance(scene, Exception):
                logger.info("refused: %s", scene)
            else:
                self._apply(on_complete(self.state, scene))

    def _loaded(self, message: Message, packing: Packing, scene: SceneSummary | Exception) -> Reply:
        unusable = self.state.options.unusable
        if isinstance(scene, Exception):
            self._apply(self.state.changed().without(packing.unusable))
            if "step" in message and not packing.unusable.keys() <= unusable.keys():
                return respond(self.state, message, now_ns())
            raise scene
        reply = on_load(self.state, scene, packing.scenes, packing.unusable)
        return attrs.evolve(reply, answer={**reply.answer, "note": packing.note})

    def _deliver(self) -> None:
        """Sends a new state to the stages, and the answers that waited for them."""
        if new_state := self._store.next_message():
            for stage in NAMES:
                self._sockets.send_encoded(stage.encode(), new_state)

        def applied(rev: int) -> bool:
            return self.stages.have_applied(rev, self.state.options)

        for request, answer, then in self._pending.due(applied, now_ns()):
            if then is None:
                self._answer(request, answer)
            else:
                before = self.state.options.viewer.source
                self._respond(request, partial(then, self.state, answer.get("stages", {})))
                for process in self.stages:
                    if process.source == before:  # by another name now: none starts again for it
                        process.source = self.state.options.viewer.source

    # what others see

    def _begin(self) -> SessionManifest:
        """Writes the session's manifest and the head of its log."""
        options = converter().unstructure(self.state.options)
        options["display"].pop("lock_code", None)
        if "source" in options["viewer"]:
            options["viewer"]["source"] = redacted(options["viewer"]["source"])
        manifest = SessionManifest.begin(self._session, options)
        logger.info("session %s: lfpipe %s, pid %d", manifest.session, __version__, manifest.pid)
        logger.info("options: %s", {key: value for key, value in options.items() if value})
        return manifest

    def _spec(self, stage: Stage) -> StageSpec:
        state = self.state
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
            request=self._pending.number_for(stage.name),
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


@contextlib.contextmanager
def _acquired(session: Session) -> Iterator[Lock]:
    """The lock of the session, where the limits of this system allow one. Raises UserError."""
    allow_files()
    with rundir.filled(session):
        lock = rundir.acquire(session)
    try:
        yield lock
    finally:
        rundir.remove(session.run_dir, lock)


def try_session(session: Session, config: Config, options: SessionOptions) -> Outcome:
    """As `run_session`, until all stages are ready. Keeps no log, and removes nothing of others."""
    state = SessionState.first(config, options)
    with (
        _acquired(session) as lock,
        rundir.filled(session),
        closing(LiveSession(session, state, logger.info)) as live,
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
    signums: list[int] = []
    live: LiveSession | None = None

    def on_signal(signum: int, _frame: FrameType | None) -> None:
        again = signum in signums and signum not in signals.SENT_TWICE
        signums.append(signum)
        for process in live.stages if again and live is not None else ():
            process.signal(signals.KILL)  # the second Ctrl-C ends at once

    with _acquired(session) as lock:
        try:
            log = session_log.kept_in(session.run_dir)
            signalled = signals.handled(on_signal)
            with signalled, log:
                with rundir.filled(session):
                    if names := rundir.sweep():
                        logger.info("removed what dead sessions left: %s", ", ".join(names))
                    state = SessionState.first(config, options)
                    live = LiveSession(session, state, notify, packing)
                with closing(live):
                    outcome = live.loop(duration_s, signums, lock)
                what = outcome.failure or "no failure"
                logger.info("session %s: %s; %s", session.name, outcome.reason, what)
        finally:
            session_log.keep_last(session.run_dir)
    return outcome
