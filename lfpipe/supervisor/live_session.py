"""A running session: its memory, stages and sockets, and the loop that decides.

The loop runs in the main thread; it never blocks on a child, and polls sockets and sentinels in one
place.
"""

import contextlib
import logging
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from functools import partial

import attrs
import zmq

from lfpipe._version import __version__
from lfpipe.config import converter
from lfpipe.config.modes import Lossless
from lfpipe.errors import UserError, plain, redacted
from lfpipe.host.file_lock import Lock
from lfpipe.host.processes import usable_cores
from lfpipe.scene.open_scene import Packing
from lfpipe.supervisor import child, process_table
from lfpipe.supervisor.control_sockets import ControlSockets, Request
from lfpipe.supervisor.file_checks import CheckEvent, FileChecks
from lfpipe.supervisor.file_dialog import FileDialog
from lfpipe.supervisor.governor import QualityControl, Step
from lfpipe.supervisor.metrics import SessionMetrics, session_metrics
from lfpipe.supervisor.pending_answers import PendingAnswers
from lfpipe.supervisor.process_table import NAMES, SHOWN_BY, SOURCE, STAGES, TRACKED_BY, Stage
from lfpipe.supervisor.requests import (
    Reply,
    on_chosen,
    on_complete,
    on_load,
    respond,
    respond_checked,
)
from lfpipe.supervisor.scene_loads import SceneEvent, SceneLoads, ScenePreviews
from lfpipe.supervisor.session_state import ConfigRollback, SessionState
from lfpipe.supervisor.session_store import SessionStore
from lfpipe.supervisor.stage_process import (
    MAX_FAILURES,
    MAX_RESTARTS_WINDOW_S,
    StageProcess,
    StageProcesses,
)
from lfpipe.transport.clock import MS_NS, SECOND_NS, now_ns
from lfpipe.transport.control import EXECUTED, BadMessage, Message
from lfpipe.transport.notices import faults
from lfpipe.transport.ring_io import StageSpec
from lfpipe.transport.session import Session, SessionManifest

PENDING_MS = 4  # the loop's period while answers wait for the stages
ASKED_OFTEN = ("hello", "status", "pictures")  # requests that change nothing
MAX_ERROR_CHARS = 2000  # of an answer: parts of the text came from outside
INTERNAL = {
    "ok": False,
    "error": "internal error",
    "remedy": "report the stack in its log; the session continues",
}
REPLACED = {
    "ok": False,
    "error": "another scene was requested meanwhile",
    "remedy": "load it again",
    "replaced": True,
}
TICK_MS = 100  # beats are due as often; a sentinel or a message wakes the loop sooner
SOURCE_ENDED = "the source has ended"
logger = logging.getLogger(__name__)


@attrs.define
class Outcome:
    """How a session ended. reason: in a few words. failure: None for a normal end, else the message
    for the user. user_error: a restart cannot help until the user has changed something. final: the
    state at the end.
    """

    reason: str
    failure: str | None = None
    remedy: str = ""
    user_error: bool = False
    final: SessionMetrics | None = None


class LiveSession:
    """One session. stages: its processes.

    Raises UserError, OSError, zmq.ZMQError if it cannot begin; then nothing is left behind.
    """

    def __init__(
        self,
        ctx: zmq.Context[zmq.Socket[bytes]],
        session: Session,
        state: SessionState,
        tell: Callable[[str], None],
        packing: Packing | None = None,
    ) -> None:
        placed = state.config.governor.affinity == "auto" and not isinstance(
            state.options.clock, Lossless
        )
        self._cpus = process_table.cores(usable_cores()) if placed else {}
        self._session = session
        self._tell = tell
        self._outcome: Outcome | None = None
        self._end_ns: int | None = None  # of --duration, once all stages are ready
        self._rollback = ConfigRollback()
        self._busy_reported = False
        # part that does not work -> whether it ever has
        self._faults: dict[str, bool] = {}
        self._pending = PendingAnswers()
        self._quality = QualityControl(self._cpus)
        with contextlib.ExitStack() as parts:  # each is closed, even if another one raises
            self._store = parts.enter_context(closing(SessionStore(session, state)))
            self._started_ns = self._begin().started_ns
            self._sockets = parts.enter_context(closing(ControlSockets(ctx, session.run_dir)))
            send = partial(self._sockets.send, SHOWN_BY)
            self._loads = parts.enter_context(closing(SceneLoads(send, packing)))
            self._previews = parts.enter_context(closing(ScenePreviews(send)))
            self._dialog = parts.enter_context(closing(FileDialog()))
            self._checks = parts.enter_context(closing(FileChecks()))
            ask_to_stop = partial(self._sockets.send, message={"cmd": "stop"})
            self.stages = parts.enter_context(
                closing(
                    StageProcesses(session, self._store.table, self._spec, ask_to_stop, self.log)
                )
            )
            self._parts = parts.pop_all()

    def close(self) -> None:
        """Stops the stages and removes the memory."""
        self._parts.close()

    def loop(self, duration_s: float | None, signals: Sequence[int], lock: Lock) -> Outcome:
        """Runs the session to its end. signals: those that have arrived. lock: the session's;
        without it, the session receives no commands any more, and the next one of that name cannot
        detect it.
        """
        while self._outcome is None:
            self._step(duration_s)
            if not lock.in_place():
                self._end(
                    "its run directory was removed",
                    f"{self._session.run_dir} was removed while the session ran",
                    "set XDG_RUNTIME_DIR to a directory that no program cleans",
                )
            if removed := self._store.removed():
                self._end(
                    "its shared memory was removed",
                    f"{removed} was removed while the session ran",
                    "find the program that cleans that folder, and exclude lfp-*",
                )
            if signals:
                self._end("interrupted")
            elif self._end_ns is not None and now_ns() >= self._end_ns:
                self._end("finished (--duration reached)")
        outcome = self._outcome
        final = self.metrics()
        self._faults = dict(faults(self._store.table.rows, now_ns()))
        self.stages.stop()
        if outcome.failure is None:
            outcome = next(self._late_failures(outcome.reason), outcome)
        self._serve()  # final messages of the stages
        return attrs.evolve(outcome, final=final)

    def _step(self, duration_s: float | None) -> None:
        """One turn of the loop."""
        self._show_level()
        self.stages.ensure_running(self._state.options)
        if (
            duration_s is not None
            and self._end_ns is None
            and all(int(p.row["ready_ns"]) for p in self.stages.needed(self._state.options))
        ):
            self._end_ns = now_ns() + int(duration_s * SECOND_NS)
        poller = zmq.Poller()
        self._sockets.register(poller)
        for fd in (
            *self._loads.fds,
            *self._previews.fds,
            *self._checks.fds,
            *self._dialog.fds,
            *self.stages.sentinels,
        ):
            poller.register(fd, zmq.POLLIN)
        poller.poll(self._wait_ms())
        for process, code in self.stages.judge():
            self._failed(process, code)
        self._follow_up()
        self._serve()
        if self.stages.finished(self._state.level.every):
            self._end(SOURCE_ENDED)
        if not self.stages.needed(self._state.options, or_alive=True):
            why = "the recording, the only work of the session, ended early"
            self._end(why, why, "see the messages above")

    def _begin(self) -> SessionManifest:
        """Writes the session's manifest and the head of its log."""
        options = converter().unstructure(self._state.options)
        options["display"].pop("lock_code", None)
        if "source" in options["viewer"]:
            options["viewer"]["source"] = redacted(options["viewer"]["source"])
        manifest = SessionManifest.begin(self._session, options)
        logger.info("session %s: lfpipe %s, pid %d", manifest.session, __version__, manifest.pid)
        logger.info("options: %s", {key: value for key, value in options.items() if value})
        return manifest

    @property
    def _state(self) -> SessionState:
        return self._store.state

    def _spec(self, stage: Stage) -> StageSpec:
        state = self._state
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

    def _follow_up(self) -> None:
        """Changes of state without a request: a change has proved good, a lease has expired, the
        load requires another level.
        """
        state = self._state
        t_ns = now_ns()
        outputs = {
            process.stage.name: int(process.row["seq"])
            for process in self.stages.needed(state.options)
        }
        state = self._rollback.watch(state, self._applied(state.rev), outputs, t_ns)
        if state.options.pictures and t_ns > state.pictures_until_ns:
            state = state.without_pictures()
        broken = dict(faults(self._store.table.rows, t_ns))
        for words in broken:
            if words not in self._faults:
                self.log(words)
        self._faults = broken or self._faults
        step = self._quality.sample(state, self._store.table.rows, t_ns)
        if step is not None:
            state = state.with_level(step.level)
        if state is not self._state:
            self._store.apply(state)
        if step is not None:
            self._report_level(step)

    def _report_level(self, step: Step) -> None:
        """Tells monitors, the log and, once, the person of a change of quality."""
        level = self._state.level
        lowest = len(self._state.levels) - 1
        self._sockets.publish(
            "level",
            level=level.number,
            lowest=lowest,
            words=level.words,
            stage=step.stage,
            why=step.reason,
        )
        logger.info(
            "quality level %d of %d, %s: %s", level.number, lowest, level.words, step.reason
        )
        if level.number and not self._busy_reported:
            self._busy_reported = True
            self.log("busy computer: simpler picture for now (`lfpipe monitor` shows how and why)")

    def _end(
        self, reason: str, failure: str | None = None, remedy: str = "", user_error: bool = False
    ) -> None:
        """Ends the session, see `Outcome`; only the first reason counts."""
        self._outcome = self._outcome or Outcome(reason, failure, remedy, user_error)

    def _failed(self, process: StageProcess, code: int) -> None:
        """Rolls back, ends the session, or leaves the stage to be restarted."""
        state = self._state
        name = process.stage.name
        row = process.row
        mistake = process.mistake() if code == child.EXIT_USER else None
        if self._rollback.to_blame(state, code, int(row["config_rev"]) >= state.rev):
            why = f"{mistake.message} ({mistake.remedy})" if mistake else f"{name} fails with it"
            self._roll_back(name, why)
            return
        first = not row["seq"]  # it has never worked
        # later in a live session, the missing thing may return
        if mistake and (first or isinstance(state.options.clock, Lossless)):
            reason = f"{name} could not {'start' if first else 'continue'}"
            self._end(reason, mistake.message, mistake.remedy, user_error=True)
            return
        phase = "RUNNING" if row["ready_ns"] else "STARTING"
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        why = f": {mistake.message}" if mistake else ""
        last = int(row["source_seq"])
        self._sockets.publish("failed", stage=name, code=code, phase=phase, source_seq=last)
        if not process.failed():
            self.log(f"{name} ended with {how} in {phase}{why}; restarting")
            return
        stack = process.last_stack()
        many = f"{name} failed {MAX_FAILURES} times in {MAX_RESTARTS_WINDOW_S:.0f} s"
        left = f"its last stack:\n{stack}" if stack else "it left no stack"
        self._end(
            many,
            f"{many}, last in {phase} with {how}{why}, after source_seq {last}; {left}",
            "see the messages above; `lfpipe doctor` checks the machine",
        )

    def _roll_back(self, name: str, why: str) -> None:
        """Undoes the newest change.

        This does not count as a failure of the stage: `ctl set` must not end a session.
        """
        self._store.apply(self._state.rolled_back())
        for request, answer in self._pending.refuse_changes(why):
            self._sockets.answer(request, self._state.rev, answer)
        self._sockets.publish("refused", stage=name, why=why)
        self.log(f"the last change is rolled back: {why}")

    def _late_failures(self, reason: str) -> Iterator[Outcome]:
        """What makes a session that ended for this reason a failure: an output that a stage of a
        lossless session could not write at its end, a part that never worked, an output that ended
        early.
        """
        for process in self.stages if isinstance(self._state.options.clock, Lossless) else ():
            if mistake := process.mistake():
                name = f"{process.stage.name} could not end"
                yield Outcome(name, mistake.message, mistake.remedy, user_error=True)
        rows = self._store.table.rows
        never = [words for words, outputs_ok in self._faults.items() if not outputs_ok]
        if rows[TRACKED_BY]["restarts"] and not rows[TRACKED_BY]["seq"]:
            never.append(f"{TRACKED_BY} failed before its first eyes")
        if never:
            remedy = "choose another one with --set track.engine or track.filter"
            yield Outcome(reason, f"{reason}, but {never[0]}: it never worked", remedy)
        if lost := sum(int(row["lost_outputs"]) for row in rows.values()):
            files = "a file of the session is" if lost == 1 else f"{lost} files of the session are"
            remedy = "see the messages above; make room on the disk, or name files on another one"
            yield Outcome(reason, f"{reason}, but {files} incomplete", remedy)

    # Requests and telemetry.

    def _wait_ms(self) -> int:
        """How long the loop may sleep unless something wakes it."""
        times_ms = [TICK_MS]
        if rest_ns := self._sockets.rest_ns():
            times_ms.append(rest_ns // MS_NS + 1)
        if self._pending:
            times_ms.append(PENDING_MS)
        if self._end_ns is not None:
            times_ms.append((self._end_ns - now_ns()) // MS_NS + 1)
        return max(0, min(times_ms))

    def _serve(self) -> None:
        """Handles what has arrived, and sends the state to the stages if it is new."""
        for request in self._sockets.requests():
            self._guard(request, self._take, request)
        for message in self._sockets.telemetry():
            self._guard(None, self._report, message)
        connections = self._sockets.connected()
        for event in self._loads.update(connections):
            self._guard(event.request, self._take_event, event)
        self._guard(None, self._previews.update)
        for check in self._checks.update(connections):
            self._guard(check.request, self._take_check, check)
        if chosen := self._dialog.update(connections):
            self._guard(chosen[0], self._take_path, *chosen)
        if new_state := self._store.take_message():
            self._sockets.broadcast(NAMES, new_state)
        for request, answer in self._pending.due(self._applied, now_ns()):
            self._sockets.answer(request, self._state.rev, answer)

    def _guard(self, request: Request | None, handle: Callable[..., None], *what: object) -> None:
        """Handles one message; turns every error into an answer."""
        try:
            handle(*what)
            return
        except BadMessage as error:
            answer = {"ok": False, "error": plain(str(error), MAX_ERROR_CHARS)}
        except UserError as error:
            answer = {"ok": False, "error": error.message, "remedy": error.remedy}
        except Exception:
            self.log(
                "internal error while handling a message; the session"
                f" continues\n{traceback.format_exc()}"
            )
            answer = INTERNAL
        logger.info("refused: %s", answer["error"])
        if request is None:
            return
        if request.sender in NAMES:  # nobody reads a stage's answers
            remedy = f" ({answer['remedy']})" if answer.get("remedy") else ""
            self.log(f"{answer['error']}{remedy}")
        self._sockets.answer(request, self._state.rev, answer)

    def _take(self, request: Request) -> None:
        request.decode()
        if request.command == EXECUTED and request.sender in NAMES:
            self._pending.executed(request.sender, request.message)
            return
        level = logging.DEBUG if request.command in ASKED_OFTEN else logging.INFO
        logger.log(level, "request %.500s", request.message)
        self._carry_out(request, respond(self._state, request.message, now_ns(), request.sender))

    def _take_event(self, event: SceneEvent) -> None:
        if isinstance(event.scene, Exception):
            raise event.scene
        if event.request is not None:
            reply = on_load(self._state, event.request.message, event.scene, event.scenes)
            self._carry_out(event.request, reply)
        elif (state := on_complete(self._state, event.scene)) is not self._state:
            logger.info(
                "%s: disparity is complete, method %s", event.scene.name, event.scene.method
            )
            self._store.apply(state)

    def _take_check(self, event: CheckEvent) -> None:
        if isinstance(event.result, Exception):
            raise event.result
        message = event.request.message
        self._carry_out(
            event.request, respond_checked(self._state, message, event.result, now_ns())
        )

    def _take_path(self, request: Request, path: str) -> None:
        request.message, reply = on_chosen(self._state, request.message, path)
        self._carry_out(request, reply)

    def _carry_out(self, request: Request, reply: Reply) -> None:
        """Carries out a reply; answers now, or when it is done."""
        if reply.check is not None:
            self._checks.begin(request, reply.check)
            return
        if reply.dialog is not None:
            self._dialog.open(request, reply.dialog == "folder")
            return
        if reply.load is not None:
            if replaced := self._loads.want(request, reply.load):
                self._sockets.answer(replaced, self._state.rev, REPLACED)
            return
        if reply.previews is not None:
            self._previews.begin(reply.previews, self._state.config.scene)
        if reply.executed_by:
            number = self._pending.await_stages(request, reply.executed_by, now_ns())
            for stage in reply.executed_by:
                self._sockets.send(stage, {**request.message, "number": number})
            return
        answer = {"ok": True, **reply.answer}
        if reply.with_stages:
            answer |= self.metrics().to_dict()
        rev = self._state.rev
        if reply.state is not None:
            self._store.apply(reply.state)
        if self._state.rev != rev:
            self._pending.await_revision(request, answer, self._state.rev, now_ns())
        else:
            self._sockets.answer(request, rev, answer)
        if reply.stop:
            self._end(
                "the window was closed" if request.sender == SHOWN_BY else "stopped by command"
            )

    def metrics(self) -> SessionMetrics:
        """The figures of the stages."""
        return session_metrics(
            self._session.name, self._store.table.rows, self._store.table.session, self._started_ns
        )

    def _applied(self, rev: int) -> bool:
        """Whether every stage has applied revision rev, and those that are no longer needed have
        ended.
        """
        return all(
            int(process.row["config_rev"]) >= rev
            for process in self.stages.needed(self._state.options, or_alive=True)
        )

    def log(self, text: str) -> None:
        """For people, and for the log. text: may quote anything."""
        logger.info(text)
        self._tell(plain(text))

    def _report(self, message: Message) -> None:
        """Logs telemetry that is for people; parallax, which changes with the viewer's distance,
        only in the log.
        """
        topic = message.get("topic")
        if topic not in ("source", "notice", "parallax"):
            return
        notes = message.get("notes")
        for text in notes if isinstance(notes, list) and notes else [message.get("text")]:
            if isinstance(text, str) and text:
                (logger.info if topic == "parallax" else self.log)(text)

    def _show_level(self) -> None:
        """For monitors, which read the table."""
        level = self._state.level
        row = self._store.table.session
        row["level"] = level.number
        row["lowest"] = len(self._state.levels) - 1
        row["words"] = level.words.encode()
