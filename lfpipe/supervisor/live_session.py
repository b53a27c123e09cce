"""A running session: its memory, stages and sockets, and the loop that decides.

The loop runs in the main thread; it never blocks on a child, and polls sockets and sentinels in one place.
"""

import contextlib
import json
import logging
import os
import time
from collections.abc import Callable, Sequence
from typing import Any

import attrs
import zmq

from lfpipe import __version__
from lfpipe.host.file_lock import Lock
from lfpipe.host.processes import usable_cores
from lfpipe.scene.open_scene import Packing
from lfpipe.supervisor import child, process_table
from lfpipe.supervisor.control_server import ControlServer
from lfpipe.supervisor.governor import QualityControl
from lfpipe.supervisor.process_table import SOURCE, STAGES, Stage
from lfpipe.supervisor.session_state import ConfigRollback, SessionState
from lfpipe.supervisor.session_store import SessionStore
from lfpipe.supervisor.snapshot import snapshot as take_snapshot
from lfpipe.supervisor.stage_process import (
    MAX_FAILURES,
    MAX_RESTARTS_WINDOW_S,
    StageProcess,
    StageProcesses,
)
from lfpipe.transport import control
from lfpipe.transport.clock import MS_NS, SECOND_NS, now_ns
from lfpipe.transport.ring_ends import StageSpec
from lfpipe.transport.session import Session

TICK_MS = 100  # beats are due as often; a sentinel or a message wakes the loop sooner
SOURCE_ENDED = "the source has ended"
logger = logging.getLogger(__name__)


@attrs.define
class Outcome:
    """How a session ended. reason: in a few words. failure: None for a normal end, else the message for the user. user_error: a
    restart cannot help until the user has changed something. final: the state at the end, from `snapshot`."""

    reason: str
    failure: str | None = None
    remedy: str = ""
    user_error: bool = False
    final: dict[str, Any] = attrs.field(factory=dict)


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
        placed = state.config.governor.affinity == "auto" and not state.options.lossless
        self._cpus = process_table.cores(usable_cores()) if placed else {}
        self._session, self._tell = session, tell
        self._outcome: Outcome | None = None
        self._rollback = ConfigRollback()
        self._busy_told = False
        self._parallax: list[str] = []  # last reported
        self._quality = QualityControl(lambda name: self._cpus.get(name, ()))
        with contextlib.ExitStack() as steps:  # each step runs, even if another one raises
            self._store = SessionStore(session, state)
            steps.callback(self._store.close)
            self._show_level()
            self._started_ns = now_ns()
            self._write_about()
            self.stages = StageProcesses(session, self._store.table, self._spec, self._ask_to_stop)
            self._server = ControlServer(ctx, session, self._store, self, packing)
            steps.callback(self._server.close)
            steps.callback(self.stages.close)
            steps.callback(self.stages.stop, self.log)  # returns at once if they have ended
            self._end_steps = steps.pop_all()

    def close(self) -> None:
        """Stops the stages and removes the memory."""
        self._end_steps.close()

    def loop(self, duration_s: float | None, signals: Sequence[int], lock: Lock) -> Outcome:
        """Runs the session to its end. signals: those that have arrived. lock: the session's; without it, the session receives no
        commands any more, and the next one of that name cannot detect it."""
        end_ns: int | None = None
        while self._outcome is None:
            end_ns = self._step(duration_s, end_ns)
            if not lock.in_place():
                why = f"{self._session.run_dir} was removed while the session ran"
                remedy = "set XDG_RUNTIME_DIR to a directory that no program cleans"
                self._end(Outcome("its run directory was removed", why, remedy))
            if signals:
                self._end(Outcome("interrupted"))
            elif end_ns is not None and now_ns() >= end_ns:
                self._end(Outcome("finished (--duration reached)"))
        self._outcome.final = self.snapshot()
        self.stages.stop(self.log)
        outcome = self._checked(self._outcome)
        self._server.serve()  # final messages of the stages
        return outcome

    def _step(self, duration_s: float | None, end_ns: int | None) -> int | None:
        """One turn of the loop; returns when the session must end, None while that is not known."""
        server, stages = self._server, self.stages
        stages.ensure_running(self._state.options)
        if (
            duration_s is not None
            and end_ns is None
            and all(int(p.row["ready_ns"]) for p in stages.needed(self._state.options))
        ):
            end_ns = now_ns() + int(duration_s * SECOND_NS)  # --duration excludes the start
        poller = zmq.Poller()
        server.register(poller)
        for process in stages:
            if process.process is not None:
                poller.register(process.process.sentinel, zmq.POLLIN)
        tick_ms = server.wait_ms(TICK_MS)
        poller.poll(
            tick_ms if end_ns is None else max(0, min(tick_ms, (end_ns - now_ns()) // MS_NS + 1))
        )
        server.serve()
        for process, code in stages.judge(self.log):
            self._failed(process, code)
        self._follow_up()
        server.flush()
        self._show_level()
        if stages.finished(self._state.level.every):
            self._end(Outcome(SOURCE_ENDED))
        if not stages.needed(self._state.options, or_alive=True):
            why = "nothing is left to run"  # the recording was the only work, and it has ended
            self._end(Outcome(why, why, "see the messages above"))
        return end_ns

    def _write_about(self) -> None:
        options = self._state.options.to_dict()
        names = {
            "session": self._session.name,
            "segments": self._session.segment(""),
            "pid": os.getpid(),
        }
        times = {"started_ns": self._started_ns, "started": time.strftime("%Y-%m-%dT%H:%M:%S%z")}
        logger.info(
            "session %s begins: lfpipe %s, pid %d", self._session.name, __version__, os.getpid()
        )
        logger.info(
            "options: %s",
            {key: value for key, value in options.items() if value and key != "kiosk"},
        )
        (self._session.run_dir / "session.json").write_text(
            json.dumps({**names, **times, "options": options})
        )

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
        """Changes of state without a request: a change has proved good, a lease has expired, the load requires another level."""
        state, t_ns = self._state, now_ns()
        outputs = {
            process.stage.name: int(process.row["seq"])
            for process in self.stages.needed(state.options)
        }
        state = self._rollback.watch(state, self.applied(state.rev), outputs, t_ns)
        if state.options.pictures and t_ns > state.pictures_until_ns:
            state = state.without_pictures()
        step = self._quality.sample(state, self._store.table.rows, t_ns)
        if step is not None:
            state = state.with_level(step.level)
        if state is not self._state:
            self._store.apply(state)
        if step is not None:
            level, lowest, why = state.level, len(state.levels) - 1, step.reason
            self._server.publish(
                "level",
                level=level.number,
                lowest=lowest,
                words=level.words,
                stage=step.stage,
                why=why,
            )
            way = f"{'lowered' if step.stage else 'raised'} to {level.words} (level {level.number} of {lowest})"
            logger.info("quality %s: %s", way if level.number else "restored", why)
            if level.number and not self._busy_told:
                self._busy_told = True
                self.log(
                    "busy computer: simpler picture for now (`lfpipe monitor` shows how and why)"
                )

    def _end(self, outcome: Outcome) -> None:
        """Records the outcome; only the first one counts."""
        self._outcome = self._outcome or outcome

    def _failed(self, process: StageProcess, code: int) -> None:
        """Rolls back, ends the session, or leaves the stage to be restarted."""
        state = self._state
        name, row = process.stage.name, process.row
        mistake = process.mistake() if code == child.EXIT_USER else None
        if self._rollback.to_blame(state, code, int(row["config_rev"]) >= state.rev):
            self._roll_back(
                name,
                f"{mistake.message} ({mistake.remedy})" if mistake else f"{name} fails with it",
            )
            return
        first = not row["ready_ns"] and not row["restarts"]
        if mistake and (
            first or state.options.lossless
        ):  # later in a live session, the missing thing may return
            reason = f"{name} could not {'start' if first else 'continue'}"
            self._end(Outcome(reason, mistake.message, mistake.remedy, user_error=True))
            return
        phase = "RUNNING" if row["ready_ns"] else "STARTING"
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        why = f": {mistake.message}" if mistake else ""
        last = int(row["source_seq"])
        self._server.publish("failed", stage=name, code=code, phase=phase, source_seq=last)
        if not process.failed():
            self.log(f"{name} ended with {how} in {phase}{why}; restarting")
            return
        stack = process.last_stack()
        many = f"{name} failed {MAX_FAILURES} times in {MAX_RESTARTS_WINDOW_S:.0f} s"
        failure = f"{many}, last in {phase} with {how}{why}, after source_seq {last}; "
        failure += f"its last stack:\n{stack}" if stack else "it left no stack"
        self._end(
            Outcome(many, failure, "see the messages above; `lfpipe doctor` checks the machine")
        )

    def _roll_back(self, name: str, why: str) -> None:
        """Undoes the newest change. This does not count as a failure of the stage: `ctl set` must not end a session."""
        self._store.apply(self._state.rolled_back())
        self._server.refuse_waiting(why)
        self._server.publish("refused", stage=name, why=why)
        self.log(f"the last change is rolled back: {why}")

    def _checked(self, outcome: Outcome) -> Outcome:
        """An output that ended early is a failure; in a lossless session also one that a stage could not write at its end."""
        for process in self.stages if self._state.options.lossless else ():
            if (mistake := process.mistake()) and outcome.failure is None:
                reason = f"{process.stage.name} could not end"
                outcome = Outcome(
                    reason, mistake.message, mistake.remedy, user_error=True, final=outcome.final
                )
        lost = sum(int(row["lost_outputs"]) for row in self._store.table.rows.values())
        if lost and outcome.failure is None:
            files = "a file of the session is" if lost == 1 else f"{lost} files of the session are"
            outcome.failure = f"{outcome.reason}, but {files} incomplete"
            outcome.remedy = (
                "see the messages above; make room on the disk, or name files on another one"
            )
        return outcome

    # What the control server asks of the session.

    def snapshot(self) -> dict[str, Any]:
        """The figures of the stages."""
        return take_snapshot(
            self._session.name, self._store.table.rows, self._store.table.session, self._started_ns
        )

    def applied(self, rev: int) -> bool:
        """Whether every stage has applied revision rev, and those that are no longer needed have ended."""
        return all(
            int(process.row["config_rev"]) >= rev
            for process in self.stages.needed(self._state.options, or_alive=True)
        )

    def stop(self) -> None:
        """Ends the session."""
        self._end(Outcome("stopped by command"))

    def log(self, text: str) -> None:
        """For people, and for the log."""
        logger.info(text)
        self._tell(text)

    def report(self, message: dict[str, Any]) -> None:
        """Logs telemetry that is for people. Of parallax only the changed lines: a key that changes alpha changes one line of
        six."""
        if message.get("topic") not in ("source", "notice", "parallax"):
            return
        notes = message.get("notes")
        for text in notes if isinstance(notes, list) and notes else [message.get("text")]:
            if isinstance(text, str) and message["topic"] == "parallax":
                before, self._parallax = self._parallax, text.splitlines()
                text = "\n".join(line for line in self._parallax if line not in before)
            if isinstance(text, str) and text:
                self.log(text)

    def _ask_to_stop(self, name: str) -> None:
        self._server.send(name, control.encode({"cmd": "stop"}))

    def _show_level(self) -> None:
        """For monitors, which read the table."""
        level, row = self._state.level, self._store.table.session
        row["level"], row["lowest"], row["words"] = (
            level.number,
            len(self._state.levels) - 1,
            level.words.encode(),
        )
