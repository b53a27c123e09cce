"""The supervisor: creates the memory of a session, keeps its stages running, serves its commands, and cleans up.

One loop in the main thread; it never blocks on a child, and polls sockets and sentinels in one place.
"""

import contextlib
import json
import logging
import os
import time
from collections.abc import Callable
from types import FrameType
from typing import Any

import zmq

from lfpipe import __version__, log
from lfpipe.config import Config, SessionOptions
from lfpipe.host import limits, signals, streams
from lfpipe.host.processes import sentinels, usable_cores
from lfpipe.scene.open_scene import Packing
from lfpipe.supervisor import child, placement, rundir
from lfpipe.supervisor.config_rollback import ConfigRollback
from lfpipe.supervisor.control_server import ControlServer
from lfpipe.supervisor.outcome import SOURCE_ENDED, Outcome
from lfpipe.supervisor.process_table import NAMES, SOURCE, STAGES, Stage, consumers
from lfpipe.supervisor.quality_control import QualityControl, reason
from lfpipe.supervisor.session_memory import SessionMemory
from lfpipe.supervisor.session_state import SessionState
from lfpipe.supervisor.session_store import SessionStore
from lfpipe.supervisor.snapshot import snapshot
from lfpipe.supervisor.stage_process import MAX_FAILURES, MAX_RESTARTS_WINDOW_S
from lfpipe.supervisor.stage_processes import Ended, StageProcesses
from lfpipe.transport import control
from lfpipe.transport.clock import MS_NS, SECOND_NS, now_ns
from lfpipe.transport.session import Session
from lfpipe.transport.stage_spec import StageSpec

TICK_MS = 100
logger = logging.getLogger(__name__)


class Supervisor:
    """A session. log: receives lines for people. packing: the packer, while it works on the disparity of the first scene.

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
        self._outcome: Outcome | None = None
        self._signals: list[int] = []
        where = "none" if options.lossless and config.governor.affinity == "auto" else config.governor.affinity
        self._cpus = placement.cores(where, {stage.name: stage.own_core for stage in STAGES}, usable_cores())
        self._nice = placement.niceness(config.governor.nice, NAMES)
        self._store = SessionStore(session, SessionState.first(config, options))
        self._rollback = ConfigRollback()
        self._parallax: list[str] = []  # last reported
        self._quality = QualityControl(lambda name: self._cpus.get(name, ()))
        self._memory: SessionMemory | None = None
        self._server: ControlServer | None = None
        self._stages: StageProcesses | None = None

    def run(self, duration_s: float | None = None) -> Outcome:
        """Runs the session to its end: a command, a signal, duration_s (from when all stages are ready), the end of the
        source, or too many failures.

        Raises UserError before any process starts if the session is impossible (name in use, /dev/shm too small, ...).
        """
        limits.allow_files()
        with rundir.filled(self._session):
            if swept := rundir.sweep():
                logger.info("removed what dead sessions left: %s", ", ".join(swept))
            self._lock = rundir.acquire(self._session)
        streams.protect("stdout", "stderr")
        before = signals.handle(self._signalled)
        try:
            with log.kept_in(self._session.run_dir), control.context() as ctx, contextlib.ExitStack() as steps:
                # each step runs, even if another one raises
                steps.callback(self._remove_memory)
                with rundir.filled(self._session):
                    server, stages = self._build(ctx)
                steps.callback(server.close)
                steps.callback(stages.close)
                steps.callback(stages.stop, self._log)  # returns at once if they have ended
                self._loop(server, stages, duration_s)
                assert self._outcome is not None
                self._outcome.final = self._snapshot()
                stages.stop(self._log)
                self._check_results(stages)
                server.serve()  # final messages of the stages
                logger.info("session %s: %s; %s", self._session.name, self._outcome.reason, self._outcome.failure or "no failure")
        finally:
            signals.restore(before)
            log.keep_last(self._session.run_dir)
            rundir.release(self._session, self._lock)
        return self._outcome

    def _log(self, text: str) -> None:
        """For people, and for the log."""
        logger.info(text)
        self._tell(text)

    def _signalled(self, signum: int, _frame: FrameType | None) -> None:
        again = signum in self._signals and signum not in signals.SENT_TWICE
        self._signals.append(signum)
        if again and self._stages is not None:  # the second Ctrl-C ends at once
            self._stages.kill()

    def _build(self, ctx: zmq.Context[zmq.Socket[bytes]]) -> tuple[ControlServer, StageProcesses]:
        self._memory = SessionMemory(self._session, self._state.config)
        self._store.begin()
        self._show_level()
        self._started_ns = now_ns()
        options = self._state.options.to_dict()
        about = {
            "session": self._session.name,
            "segments": self._session.segment(""),
            "started_ns": self._started_ns,
            "started": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
            "pid": os.getpid(),
            "options": options,
        }
        logger.info("session %s begins: lfpipe %s, pid %d", self._session.name, __version__, os.getpid())
        logger.info("options: %s", {key: value for key, value in options.items() if value and key != "kiosk"})
        (self._session.run_dir / "session.json").write_text(json.dumps(about))
        stages = self._stages = StageProcesses(self._session, self._memory.table, self._spec, self._ask_to_stop)
        server = self._server = ControlServer(
            ctx, self._session, self._store, self._applied, self._snapshot, self._stop, self._hear, self._log
        )
        if self._packing is not None:
            server.follow(self._packing)
        return server, stages

    def _remove_memory(self) -> None:
        with contextlib.ExitStack() as steps:
            if self._memory is not None:
                steps.callback(self._memory.remove)
            steps.callback(self._store.close)

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
            consumers=consumers(),
            others=tuple(other.name for other in STAGES if other is not stage and other.needed(state.options)),
            source=SOURCE,
            cpus=self._cpus.get(stage.name, ()),
            nice=self._nice.get(stage.name),
        )

    def _loop(self, server: ControlServer, stages: StageProcesses, duration_s: float | None) -> None:
        end_ns: int | None = None
        while self._outcome is None:
            stages.ensure_running(self._state.options)
            if duration_s is not None and end_ns is None and stages.ready(self._state.options):
                end_ns = now_ns() + int(duration_s * SECOND_NS)  # --duration excludes the start
            poller = zmq.Poller()
            server.register(poller)
            for process in stages:
                if process.process is not None:
                    for sentinel in sentinels(process.process):
                        poller.register(sentinel, zmq.POLLIN)
            tick_ms = server.wait_ms(TICK_MS)
            poller.poll(tick_ms if end_ns is None else max(0, min(tick_ms, (end_ns - now_ns()) // MS_NS + 1)))
            server.serve()
            for ended in stages.judge(self._log):
                self._failed(ended)
            self._follow_up(stages)
            server.flush()
            self._show_level()
            self._outcome = self._outcome or rundir.lost(self._session, self._lock)
            if stages.finished(self._state.level.every):
                self._end(Outcome(SOURCE_ENDED))
            if stages.idle(self._state.options):
                why = "nothing is left to run"  # the recording was the only work, and it has ended
                self._end(Outcome(why, why, "see the messages above"))
            if self._signals:
                self._end(Outcome("interrupted"))
            elif end_ns is not None and now_ns() >= end_ns:
                self._end(Outcome("finished (--duration reached)"))

    def _follow_up(self, stages: StageProcesses) -> None:
        """Changes of state without a request: a change has proved good, a lease has expired, the load requires another level."""
        state, t_ns = self._state, now_ns()
        state = self._rollback.watch(state, self._applied(state.rev), stages.outputs(state.options), t_ns)
        if state.options.pictures and t_ns > state.pictures_until_ns:
            state = state.without_pictures()
        assert self._memory is not None
        step = self._quality.sample(state, self._memory.table.rows, t_ns)
        if step is not None:
            state = state.with_level(step.level)
        if state is not self._state:
            self._store.apply(state)
        if step is not None and self._server is not None:
            level, lowest, why = state.level, len(state.levels) - 1, reason(step)
            self._server.publish("level", level=level.number, lowest=lowest, words=level.words, stage=step.stage, why=why)
            way = f"{'lowered' if step.stage else 'raised'} to {level.words} (level {level.number} of {lowest})"
            self._log(f"quality {way if level.number else 'restored'}: {why}")

    def _end(self, outcome: Outcome) -> None:
        """Records the outcome; only the first one counts."""
        self._outcome = self._outcome or outcome

    def _stop(self) -> None:
        self._end(Outcome("stopped by command"))

    def _failed(self, ended: Ended) -> None:
        """Rolls back, ends the session, or leaves the stage to be restarted."""
        process, code, state = ended.process, ended.code, self._state
        name, row = process.stage.name, process.row
        died_of = process.died_of() if code == child.EXIT_USER else None
        if self._rollback.to_blame(state, code, int(row["config_rev"]) >= state.rev):
            self._roll_back(name, f"{died_of[0]} ({died_of[1]})" if died_of else f"{name} fails with it")
            return
        first = not row["ready_ns"] and not row["restarts"]
        if died_of and (first or state.options.lossless):  # later in a live session, the missing thing may return
            self._end(Outcome(f"{name} could not {'start' if first else 'continue'}", died_of[0], died_of[1], user_error=True))
            return
        phase = "RUNNING" if row["ready_ns"] else "STARTING"
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        said = f": {died_of[0]}" if died_of else ""
        last = int(row["source_seq"])
        assert self._server is not None
        self._server.publish("failed", stage=name, code=code, phase=phase, source_seq=last)
        if not process.failed():
            self._log(f"{name} ended with {how} in {phase}{said}; restarting")
            return
        stack = process.last_stack()
        many = f"{name} failed {MAX_FAILURES} times in {MAX_RESTARTS_WINDOW_S:.0f} s"
        self._end(
            Outcome(
                many,
                f"{many}, last in {phase} with {how}{said}, "
                f"after source_seq {last}" + (f"; its last stack:\n{stack}" if stack else "; it left no stack"),
                "see the messages above; `lfpipe doctor` checks the machine",
            )
        )

    def _roll_back(self, name: str, why: str) -> None:
        """Undoes the newest change. This does not count as a failure of the stage: `ctl set` must not end a session."""
        self._store.apply(self._state.rolled_back())
        assert self._server is not None
        self._server.refuse_waiting(why)
        self._server.publish("refused", stage=name, why=why)
        self._log(f"the last change is rolled back: {why}")

    def _check_results(self, stages: StageProcesses) -> None:
        """An output that ended early is a failure; in a lossless session also one that a stage could not write at its end."""
        assert self._outcome is not None
        for process in stages if self._state.options.lossless else ():
            died_of = process.died_of()
            if died_of and self._outcome.failure is None:
                final = self._outcome.final
                self._outcome = Outcome(f"{process.stage.name} could not end", *died_of, user_error=True, final=final)
        assert self._memory is not None
        lost = sum(int(row["lost_outputs"]) for row in self._memory.table.rows.values())
        if lost and self._outcome.failure is None:
            files = "a file of this session is" if lost == 1 else f"{lost} files of this session are"
            self._outcome.failure = f"{self._outcome.reason}, but {files} incomplete"
            self._outcome.remedy = "see the messages above; make room on the disk, or name files on another one"

    def _hear(self, message: dict[str, Any]) -> None:
        """Logs what a stage reports to people."""
        if message.get("topic") in ("source", "notice", "parallax"):
            notes = message.get("notes")
            for text in notes if isinstance(notes, list) and notes else [message.get("text")]:
                if isinstance(text, str) and (text := self._new_lines(text) if message["topic"] == "parallax" else text):
                    self._log(text)

    def _new_lines(self, parallax: str) -> str:
        """The changed lines only: a key that changes alpha changes one line of six."""
        lines, before = parallax.splitlines(), self._parallax
        self._parallax = lines
        return "\n".join(line for line in lines if line not in before)

    def _snapshot(self) -> dict[str, Any]:
        assert self._memory is not None
        return snapshot(self._session.name, self._memory.table, self._started_ns)

    def _applied(self, rev: int) -> bool:
        assert self._stages is not None
        return self._stages.applied(rev, self._state.options)

    def _ask_to_stop(self, name: str) -> None:
        if self._server is not None:
            self._server.send(name, control.encode({"cmd": "stop"}))

    def _show_level(self) -> None:
        """For monitors, which read the table."""
        assert self._memory is not None
        level, shown = self._state.level, self._memory.table.session
        shown["level"], shown["lowest"], shown["words"] = level.number, len(self._state.levels) - 1, level.words.encode()
