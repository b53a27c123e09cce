"""Random faults into one session, one after the other: how soon pictures come again, what was lost, what is left behind.

`profiling/faults_soak.py` runs hundreds of them, the tests twenty.
"""

from __future__ import annotations

import os
import random
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import attrs
import zmq

from lfpipe.transport import control, ring
from lfpipe.transport.clock import now_ns
from lfpipe.transport.session import Session
from lfpipe.transport.status import State
from tests.faults.hostile import hostile
from tests.faults.watcher import Account, Figures, Watcher, figures, is_whole, write_checked_frames
from tests.world import World, write_scene

STAGES = ("capture", "track", "render")
LETHAL = ("kill", "terminate", "stop 3 s")
HARMLESS = ("stop the supervisor 3 s", "source stalls 1 s", "monitor killed", "slow reader", "hogs 2 s", "garbage")
DEATHS, WINDOW_S = 3, 61.0  # of one stage: five in 60 s end a session, and from the fourth on it waits before it starts again
PATIENCE_S = 20.0
LEAK_MB = 4.0  # of one process; allocators differ by less from start to start
HOG = "import time\nend = time.time() + 2\nwhile time.time() < end: pass"


@attrs.frozen
class Fault:
    """What was done to whom, and the time from its end to a picture of a frame that was taken after it."""

    kind: str
    stage: str
    recovery_s: float


@attrs.define
class Outcome:
    """Of a whole run."""

    faults: list[Fault]
    accounts: list[Account]
    watcher: Watcher
    before: Figures
    after: Figures
    restarts: dict[str, int]
    seconds: float

    def broken(self, recovery_s: float) -> list[str]:
        """What was promised and not kept, in words; nothing where all was."""
        late = [f"pictures only {f.recovery_s:.2f} s after {f.kind} {f.stage}" for f in self.faults if f.recovery_s > recovery_s]
        watcher = self.watcher
        counts = {
            "torn frames": watcher.torn,
            "torn pictures": watcher.torn_pictures,
            "frames out of order": watcher.out_of_order,
        }
        wrong = [f"{count} {what}" for what, count in counts.items() if count]
        books = [f"drops counted less those there were: {a.errors()}" for a in self.accounts[-1:] if any(a.errors().values())]
        leaks = []
        for name, (before_mb, before_fds) in self.before.processes.items():
            after_mb, after_fds = self.after.processes.get(name, (0.0, 0))
            if after_mb > before_mb + LEAK_MB or after_fds > before_fds + 1:
                leaks.append(f"{name}: {before_mb:.1f} to {after_mb:.1f} MB, {before_fds} to {after_fds} descriptors")
        for what in ("segments", "files"):
            if getattr(self.before, what) != getattr(self.after, what):
                leaks.append(f"{what}: {getattr(self.before, what)} to {getattr(self.after, what)}")
        if self.before.processes.keys() != self.after.processes.keys():
            leaks.append(f"processes: {sorted(self.before.processes)} to {sorted(self.after.processes)}")
        return late + wrong + books + leaks

    def table(self) -> str:
        """Markdown: kinds of faults, the books, what was held before and after."""
        lines = ["| fault | times | pictures again, median s | longest s |", "|---|---|---|---|"]
        for kind in (*LETHAL, *HARMLESS):
            found = [fault.recovery_s for fault in self.faults if fault.kind == kind]
            if found:
                lines.append(f"| {kind} | {len(found)} | {statistics.median(found):.2f} | {max(found):.2f} |")
        every = [fault.recovery_s for fault in self.faults]
        spread = f"{statistics.median(every):.2f} | {max(every):.2f}"
        lines.append(f"| all, in {self.seconds / 60:.1f} min | {len(every)} | {spread} |")
        watcher, last = self.watcher, self.accounts[-1]
        lines += ["", "| what | figure |", "|---|---|"]
        lines.append(f"| restarts | {', '.join(f'{name} {count}' for name, count in self.restarts.items())} |")
        lines.append(f"| frames checked, torn | {watcher.seen}, {watcher.torn} |")
        lines.append(f"| frames lapped while looked at, and known to be | {watcher.lapped} |")
        lines.append(f"| pictures checked, torn | {watcher.pictures}, {watcher.torn_pictures} |")
        lines.append(f"| frames out of order | {watcher.out_of_order} |")
        lines.append(f"| frames published, eyes, pictures | {last.frames}, {last.eyes}, {last.lines} |")
        lines.append(f"| drops of capture, track, render | {last.capture_drops}, {last.track_drops}, {last.render_drops} |")
        lines.append(f"| the same less what is missing | {', '.join(map(str, last.errors().values()))} |")
        lines += ["", "| held | before | after |", "|---|---|---|"]
        for name in sorted({*self.before.processes, *self.after.processes}):
            then, now = self.before.processes.get(name, (0.0, 0)), self.after.processes.get(name, (0.0, 0))
            lines.append(f"| {name}: own memory MB, descriptors | {then[0]:.1f}, {then[1]} | {now[0]:.1f}, {now[1]} |")
        for what in ("segments", "files"):
            lines.append(f"| {what} | {len(getattr(self.before, what))} | {len(getattr(self.after, what))} |")
        return "\n".join(lines)


class Soak:
    """A session under fault. Raises AssertionError where pictures do not come again."""

    def __init__(self, world: World, seed: int, rate_hz: float = 30.0, size_px: tuple[int, int] = (640, 480)) -> None:
        self.world, self._rng = world, random.Random(seed)
        width_px, height_px = size_px
        scene = write_scene(world.root / "soak-scene")
        frames = write_checked_frames(world.root / "soak-frames", width_px, height_px, 40)
        sets = [f"camera.width_px={width_px}", f"camera.height_px={height_px}", "render.clock=camera", "render.method=nearest"]
        sets += ["render.anaglyph=colour", "render.alpha_px=12"]
        self._log = (world.root / "soak.log").open("w")
        camera = f"file:{frames}?loop=1&pace={rate_hz:g}"
        options = [word for text in sets for word in ("--set", text)]
        self.supervisor = world.up(scene, *options, camera=camera, stdout=self._log, stderr=self._log)
        world.pictures(20)
        self.session = Session(world.name)
        self._run_dir = next(world.run_dir.glob(f"lfpipe-*-{world.name}"))
        self.watcher = Watcher(self.session, self._run_dir, world.trace)
        self.watcher.start()
        self._restarts = dict.fromkeys(STAGES, 0)
        self._deaths: dict[str, list[float]] = {name: [] for name in STAGES}

    def run(self, count: int, tell: Callable[[str], None] = print, books_every: int = 25) -> Outcome:
        """So many faults; the books are looked at after every books_every of them."""
        time.sleep(3.0)  # allocators and lazy imports have had their turn
        before, start = figures(self.supervisor.pid, self.session, self._run_dir), time.monotonic()
        faults, accounts = [], []
        for number in range(1, count + 1):
            kind, stage = self._choose()
            getattr(self, "_" + "_".join(kind.split()))(stage)
            fault = Fault(kind, stage, self._pictures_again())
            faults.append(fault)
            if number % books_every == 0 or number == count:
                accounts.append(self._books())
                errors = accounts[-1].errors()
                tell(
                    f"{number:4d} {time.monotonic() - start:6.0f} s  {kind} {stage}: {fault.recovery_s:.2f} s, "
                    f"torn {self.watcher.torn + self.watcher.torn_pictures}, drops counted less missing {errors}"
                )
            time.sleep(self._rng.uniform(0.05, 0.4))
        time.sleep(3.0)
        after = figures(self.supervisor.pid, self.session, self._run_dir)
        self._count_deaths()
        restarts, seconds = dict(self._restarts), time.monotonic() - start
        self.watcher.end()
        return Outcome(faults, accounts, self.watcher, before, after, restarts, seconds)

    def _choose(self) -> tuple[str, str]:
        """Any fault, but none that would be the fourth death of a stage within a minute."""
        self._count_deaths()
        mortal = [name for name in STAGES if len([t for t in self._deaths[name] if time.monotonic() - t < WINDOW_S]) < DEATHS]
        kind = self._rng.choice([*(LETHAL if mortal else ()), *HARMLESS])
        return kind, self._rng.choice(mortal) if kind in LETHAL else ""

    def _count_deaths(self) -> None:
        for name in STAGES:
            restarts = int(self.watcher.table.rows[name]["restarts"])
            self._deaths[name] += [time.monotonic()] * (restarts - self._restarts[name])
            self._restarts[name] = restarts

    def _pictures_again(self) -> float:
        end_ns = now_ns()
        while True:
            line = self.watcher.newest
            rows = [self.watcher.table.rows[name] for name in STAGES]
            alive = all(row["state"] == State.RUNNING and Path(f"/proc/{row['pid']}").exists() for row in rows)
            if line and line["t_read_ns"] > end_ns and alive:
                return max(0.0, (line["t_presented_ns"] - end_ns) / 1e9)
            assert self.supervisor.poll() is None, f"the session ended: {self._said()}"
            assert now_ns() - end_ns < PATIENCE_S * 1e9, f"no picture for {PATIENCE_S:g} s: {self._said()}"
            time.sleep(0.005)

    def _said(self) -> str:
        return (self.world.root / "soak.log").read_text()[-2000:]

    def _books(self) -> Account:
        """Capture stands still for a moment, so that nothing is under way."""
        pid = self._pid("capture")
        os.kill(pid, signal.SIGSTOP)
        try:
            return self.watcher.settled(1.2)  # less than what is taken for a hang
        finally:
            os.kill(pid, signal.SIGCONT)
            self._pictures_again()

    def _pid(self, stage: str) -> int:
        return int(self.watcher.table.rows[stage]["pid"])

    def _kill(self, stage: str) -> None:
        os.kill(self._pid(stage), signal.SIGKILL)

    def _terminate(self, stage: str) -> None:
        os.kill(self._pid(stage), signal.SIGTERM)

    def _stop_3_s(self, stage: str) -> None:
        pid = self._pid(stage)
        os.kill(pid, signal.SIGSTOP)
        time.sleep(3.0)
        if self._pid(stage) == pid:  # else it was taken for hung and is gone
            os.kill(pid, signal.SIGCONT)

    def _stop_the_supervisor_3_s(self, _: str) -> None:
        self.supervisor.send_signal(signal.SIGSTOP)
        time.sleep(3.0)
        self.supervisor.send_signal(signal.SIGCONT)

    def _source_stalls_1_s(self, _: str) -> None:
        pid = self._pid("capture")
        os.kill(pid, signal.SIGSTOP)
        time.sleep(1.0)
        os.kill(pid, signal.SIGCONT)

    def _monitor_killed(self, _: str) -> None:
        monitor = self.world.start("monitor", "--session", self.world.name, "--json")
        assert monitor.stdout is not None
        monitor.stdout.readline()
        monitor.kill()
        monitor.communicate()

    def _slow_reader(self, _: str) -> None:
        """It holds a slot for a second: what it sees is whole, or known not to be."""
        reader = ring.Reader(self.session.segment("frames"))
        try:
            reader.last_seq = max(0, reader.published - 1)
            lent = reader.lend()
            assert lent is not None
            time.sleep(1.0)
            good = is_whole(lent[1])
            assert good or not reader.whole(lent[0]), "torn, and said to be whole"
        finally:
            lent = None
            reader.close()

    def _hogs_2_s(self, _: str) -> None:
        hogs = [subprocess.Popen([sys.executable, "-c", HOG]) for _ in range(2)]
        for hog in hogs:
            hog.wait()

    def _garbage(self, _: str) -> None:
        with control.context() as ctx, ctx.socket(zmq.DEALER) as socket:
            socket.connect(control.address(self._run_dir, "ctl"))
            for _ in range(200):
                socket.send(hostile(self._rng))
            for _ in range(200):
                assert socket.poll(5000), "no answer to garbage"
                answer: dict[str, Any] = control.decode(socket.recv())
                assert answer["ok"] is False, answer
