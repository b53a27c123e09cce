"""The supervisor: makes what a session stands on, keeps its stages running, answers commands, ends it clean.

One loop in the main thread; it never blocks on a child, and polls sockets and sentinels in one place.
"""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable
from types import FrameType
from typing import Any

import zmq

from lfpipe import config as config_module
from lfpipe.config import Config
from lfpipe.supervisor import child, ending, limits, placement, rundir, signals, streams
from lfpipe.supervisor.agreement import Agreement
from lfpipe.supervisor.desk import Desk
from lfpipe.supervisor.levels import Levels, why
from lfpipe.supervisor.memory import Memory
from lfpipe.supervisor.outcome import Outcome
from lfpipe.supervisor.process import MAX_FAILURES, WINDOW_S, StageProcess
from lfpipe.supervisor.snapshot import snapshot
from lfpipe.supervisor.table import STAGES, consumers
from lfpipe.supervisor.trial import Trial
from lfpipe.transport import control
from lfpipe.transport.clock import MS_NS, now_ns
from lfpipe.transport.context import StageSpec
from lfpipe.transport.session import Session
from lfpipe.transport.status import ENDED

TICK_MS = 100
DRAIN_S = 2.0  # how long the stages may take for what is under way when the source has ended


class Supervisor:
    """A session. options: what stages need to know besides the configuration, plain values (`up.options`).

    Raises UserError where a stage is to run on a core that is not there, or with a niceness that is none.
    """

    def __init__(
        self,
        session: Session,
        config: Config,
        options: dict[str, Any],
        lossless: bool = False,
        lock_step: bool = False,
        tell: Callable[[str], None] = print,
    ) -> None:
        self.session, self._lossless, self._lock_step, self._tell = session, lossless, lock_step, tell
        self.outcome: Outcome | None = None
        self._signals: list[int] = []
        self._memory: Memory | None = None
        self.processes: dict[str, StageProcess] = {}
        self._draining_ns = 0
        self._trial = Trial(config, options)
        names = [stage.name for stage in STAGES]
        where = "none" if lossless and config.governor.affinity == "auto" else config.governor.affinity
        self._cpus = placement.cores(where, names, os.sched_getaffinity(0))
        self._nice = placement.niceness(config.governor.nice, names)
        self._levels = Levels(config, options, lossless, lambda name: self._cpus.get(name, ()))
        self.agreement = Agreement(session, config, options, self._levels, self._changed)

    def run(self, duration_s: float | None = None) -> Outcome:
        """Runs the session to its end: a command, a signal, duration_s (from when all stages are ready), the end of the
        source, or too many failures.

        Raises UserError before any process starts when the session cannot be (name taken, /dev/shm too small, ...).
        """
        limits.allow_files()
        with rundir.filled(self.session):
            rundir.sweep()
            self._lock = rundir.acquire(self.session)
        streams.protect("stdout", "stderr")
        before = signals.handle(self._signalled)
        try:
            with rundir.filled(self.session):
                self._build()
            with control.context() as ctx:
                with rundir.filled(self.session):
                    self._desk = Desk(ctx, self.session, self.agreement.config.control, self, self._hear)
                self._loop(duration_s)
                assert self.outcome is not None
                self.outcome.final = self.state()
                self._stop_all()
                self._end_of_results()
                self._desk.serve()  # last words of the stages
                self._desk.close()
        finally:
            signals.restore(before)
            self._remove()
            rundir.release(self.session, self._lock)
        return self.outcome

    def _signalled(self, signum: int, _frame: FrameType | None) -> None:
        again = signum in self._signals and signum != signal.SIGHUP  # which the shell and the kernel both send
        self._signals.append(signum)
        if again:  # the second Ctrl-C means now
            for process in self.processes.values():
                process.signal(signal.SIGKILL)

    def _build(self) -> None:
        self._memory = Memory(self.session, self.agreement.config)
        self.table = self._memory.table
        self.agreement.begin()
        self._write_level()
        self.processes = {s.name: StageProcess(s, self.session, self.table.rows[s.name]) for s in STAGES}
        self.started_ns = now_ns()
        about = {
            "session": self.session.name,
            "segments": self.session.segment(""),
            "started_ns": self.started_ns,
            "started": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        }
        text = json.dumps({**about, "pid": os.getpid(), "options": self.agreement.options})
        (self.session.run_dir / "session.json").write_text(text)

    def _remove(self) -> None:
        self.agreement.end()
        if self._memory is not None:
            self.processes.clear()  # they hold rows of the table
            self._memory.remove()

    def _spec(self, process: StageProcess) -> StageSpec:
        return StageSpec(
            name=process.stage.name,
            module=process.stage.module,
            session=self.session,
            config=config_module.to_dict(self.agreement.config),
            rev=self.agreement.rev,
            options=self.agreement.options,
            consumers=consumers(),
            others=tuple(s.name for s in STAGES if s is not process.stage and s.needed(self.agreement.options)),
            lossless=self._lossless,
            lock_step=self._lock_step,
            cpus=self._cpus.get(process.stage.name, ()),
            nice=self._nice.get(process.stage.name),
        )

    def _loop(self, duration_s: float | None) -> None:
        end_ns: int | None = None
        while self.outcome is None:
            self._ensure_running()
            if duration_s is not None and end_ns is None and self._all_ready():
                end_ns = now_ns() + int(duration_s * 1e9)  # the time asked for is of pictures, not of imports
            poller = zmq.Poller()
            for socket in self._desk.sockets:
                poller.register(socket, zmq.POLLIN)
            for process in self.processes.values():
                if process.process is not None:
                    poller.register(process.process.sentinel, zmq.POLLIN)
            tick_ms = self._desk.wait_ms(TICK_MS)
            poller.poll(tick_ms if end_ns is None else max(0, min(tick_ms, (end_ns - now_ns()) // MS_NS + 1)))
            self._desk.serve()
            self._judge()
            made = {name: int(p.row["seq"]) for name, p in self.processes.items() if p.stage.needed(self.agreement.options)}
            self._trial.watch(self.agreement.config, self.agreement.options, self.applied(self.agreement.rev), made, now_ns())
            self._govern()
            self.agreement.end_overdue()
            if not any(p.alive or p.stage.needed(self.agreement.options) for p in self.processes.values()):
                why = "nothing is left to run"  # the recording has ended, and it was all
                self.outcome = self.outcome or Outcome(why, why, "the lines above say why")
            self.outcome = self.outcome or rundir.lost(self.session, self._lock)
            if self._signals:
                self.outcome = self.outcome or Outcome("interrupted")
            elif end_ns is not None and now_ns() >= end_ns:
                self.outcome = self.outcome or Outcome("the time asked for is over")

    def _govern(self) -> None:
        """One level of quality down or up, where the load asks for it."""
        step = self._levels.sample(self.table.rows, now_ns())
        if step is None:
            return
        level, lowest, reason = self._levels.now, self._levels.lowest, why(step)
        self.agreement.change()
        self._desk.publish("level", level=level.number, lowest=lowest, words=level.words, stage=step.stage, why=reason)
        way = "lowered" if step.stage else "back"
        self._tell(f"quality {way} to {level.words} (level {level.number} of {lowest}): {reason}")

    def _write_level(self) -> None:
        """For monitors, which read the table."""
        shown = self.table.session
        shown["level"], shown["lowest"] = self._levels.now.number, self._levels.lowest
        shown["words"] = self._levels.now.words.encode()

    def _all_ready(self) -> bool:
        return all(int(p.row["ready_ns"]) > 0 for p in self.processes.values() if p.stage.needed(self.agreement.options))

    def _ensure_running(self) -> None:
        for process in self.processes.values():
            process.wanted = process.stage.needed(self.agreement.options) and not self._draining_ns
            if process.wanted and not process.alive and now_ns() >= process.next_start_ns:
                process.start(self._spec(process))
            elif process.alive and not process.stage.needed(self.agreement.options):
                self._desk.send(process.stage.name, {"cmd": "stop"})

    def _judge(self) -> None:
        for process in self.processes.values():
            name = process.stage.name
            if why := process.overdue():
                self._tell(f"{name}: {why}, killed\n{process.condemn()}".rstrip())
            code = process.reap()
            if code is None:
                continue
            if code == 0 and not process.wanted:
                continue
            if code == 0 and name == "capture":
                self._draining_ns = now_ns()
                continue
            self._failed(process, code)
        if self._draining_ns and (self._drained() or now_ns() - self._draining_ns > DRAIN_S * 1e9):
            self.outcome = Outcome("the source has ended")

    def _failed(self, process: StageProcess, code: int) -> None:
        name, row = process.stage.name, process.row
        died_of = process.died_of() if code == child.EXIT_USER else None
        agreed = self.agreement
        back = self._trial.verdict(agreed.config, agreed.options, code, int(row["config_rev"]) >= agreed.rev)
        if back is not None:
            self._take_back(name, f"{died_of[0]} ({died_of[1]})" if died_of else f"{name} does not work by it", *back)
            return
        first = not row["ready_ns"] and not row["restarts"]
        if died_of and (first or self._lossless):  # of a live session, later: what it misses may come back
            self.outcome = Outcome(f"{name} could not {'start' if first else 'go on'}", died_of[0], died_of[1], user_error=True)
            return
        phase = "RUNNING" if row["ready_ns"] else "STARTING"
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        said = f": {died_of[0]}" if died_of else ""
        last = int(row["source_seq"])
        self._desk.publish("failed", stage=name, code=code, phase=phase, source_seq=last)
        if process.failed():
            stack = process.last_stack()
            self.outcome = Outcome(
                f"{name} failed {MAX_FAILURES} times in {WINDOW_S:.0f} s",
                f"{name} failed {MAX_FAILURES} times in {WINDOW_S:.0f} s, last in {phase} with {how}{said}, "
                f"after source_seq {last}" + (f"; its last stack:\n{stack}" if stack else "; it left no stack"),
                "the lines above say what it died of; `lfpipe doctor` checks the machine",
            )
        else:
            self._tell(f"{name} ended with {how} in {phase}{said}; restarting")

    def _take_back(self, name: str, why: str, config: Config, options: dict[str, Any]) -> None:
        """Ends the trial of a change. What it cost a stage is no failure: nobody may end a session by `ctl set`."""
        self.agreement.change(config=config, options=options)
        self._desk.commands.refuse(why)
        self._desk.publish("refused", stage=name, why=why)
        self._tell(f"the last change is taken back: {why}")

    def _drained(self) -> bool:
        last = int(self.table.rows["capture"]["source_seq"]) - self._levels.now.every + 1  # the rest is left out
        rows = [self.table.rows[p.stage.name] for p in self.processes.values() if p.alive]
        return all(int(row["source_seq"]) >= last or row["state"] in ENDED for row in rows)

    def _stop_all(self) -> None:
        """Asks all to stop, then waits for all."""
        for process in self.processes.values():
            process.wanted = False
            self._desk.send(process.stage.name, {"cmd": "stop"})
        ending.end(self.processes.values(), self._tell)

    def _end_of_results(self) -> None:
        """Where nothing may be lost, what a stage could not write at its very end is a failure of the whole."""
        for name, process in self.processes.items() if self._lossless else ():
            died_of = process.died_of()
            if died_of and self.outcome is not None and self.outcome.failure is None:
                self.outcome = Outcome(f"{name} could not end", *died_of, user_error=True, final=self.outcome.final)

    def _hear(self, message: dict[str, Any]) -> None:
        """Passes on to the person what a stage has to say to one."""
        texts = message.get("notes") or [message.get("text")]
        for text in texts if message.get("topic") in ("source", "notice", "parallax") else ():
            if isinstance(text, str):
                self._tell(text)

    def state(self) -> dict[str, Any]:
        """Of every stage, as `lfpipe monitor --once --json` prints it."""
        return snapshot(self.session.name, self.table, self.started_ns)

    def tell_stages(self, message: dict[str, Any]) -> None:
        """Sends to every stage."""
        for name in self.processes:
            self._desk.send(name, message)

    def _changed(self, message: dict[str, Any]) -> None:
        self._write_level()
        self.tell_stages(message)

    def applied(self, rev: int) -> bool:
        """Whether every stage that is to run works by revision rev, and none runs that is not to."""
        options = self.agreement.options
        return all(int(p.row["config_rev"]) >= rev for p in self.processes.values() if p.alive or p.stage.needed(options))
