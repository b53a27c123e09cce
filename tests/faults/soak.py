"""Random faults in one session, one after another: time until pictures return, lost frames, leftovers. `pytest -m soak` runs
hundreds of them, `-m live` one of each kind.
"""

import contextlib
import os
import random
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import attrs
import zmq

from lfpipe.transport import control, ring
from tests.faults.hostile import hostile
from tests.faults.session import STAGES, WatchedSession
from tests.faults.watcher import Account, Figures, Watcher, is_whole

LETHAL = ("kill", "terminate", "stop 3 s")
HARMLESS = ("stop the supervisor 3 s", "source stalls 1 s", "monitor killed", "slow reader", "hogs 2 s", "garbage")
DEATHS, WINDOW_S = 3, 61.0  # of one stage: five in 60 s end a session, and after the fourth it waits before a restart
LEAK_MB = 4.0  # of one process; allocators differ by less from start to start
HOG = "import time\nend = time.time() + 2\nwhile time.time() < end: pass"


@attrs.frozen
class Fault:
    """A fault, its target, and the time from its end to a picture of a newer frame."""

    kind: str
    stage: str
    recovery_s: float


@attrs.define
class Outcome:
    """The outcome of a whole run."""

    faults: list[Fault]
    accounts: list[Account]
    watcher: Watcher
    before: Figures
    after: Figures
    restarts: dict[str, int]
    seconds: float

    def broken(self, recovery_s: float) -> list[str]:
        """The broken promises, in words; empty if all were kept."""
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
        """Kinds of faults with the times until pictures returned, restarts, and the account of frames."""
        lines = [f"{self.seconds / 60:.1f} min, restarts {self.restarts}, {self.watcher.lapped} frames lapped while looked at"]
        for kind in (*LETHAL, *HARMLESS):
            if times_s := [fault.recovery_s for fault in self.faults if fault.kind == kind]:
                lines.append(f"{kind}: {len(times_s)}, median {statistics.median(times_s):.2f} s, longest {max(times_s):.2f} s")
        return "\n".join([*lines, str(self.accounts[-1]), str(self.before), str(self.after)])


class Soak:
    """A session under faults. Raises AssertionError if pictures do not return."""

    def __init__(self, session: WatchedSession, seed: int) -> None:
        self._session, self._rng = session, random.Random(seed)
        self._restarts = dict.fromkeys(STAGES, 0)
        self._deaths: dict[str, list[float]] = {name: [] for name in STAGES}

    def run(self, count: int, tell: Callable[[str], None] = print, books_every: int = 25) -> Outcome:
        """Injects faults, one of each kind before random ones; checks the account of frames after every books_every faults."""
        session, watcher = self._session, self._session.watcher
        time.sleep(3.0)  # after warm-up of allocators and lazy imports
        before, start = session.figures(), time.monotonic()
        faults: list[Fault] = []
        accounts: list[Account] = []
        for number in range(1, count + 1):
            kind, stage = self._choose([*LETHAL, *HARMLESS][number - 1 : number])
            getattr(self, "_" + "_".join(kind.split()))(stage)
            faults.append(Fault(kind, stage, session.pictures_again()))
            if number % books_every == 0 or number == count:
                accounts.append(session.books())
                longest = max(fault.recovery_s for fault in faults)
                tell(
                    f"{number:4d} {time.monotonic() - start:6.0f} s  pictures again within {longest:.2f} s, "
                    f"torn {watcher.torn + watcher.torn_pictures} of {watcher.seen + watcher.pictures}, "
                    f"drops counted less missing {list(accounts[-1].errors().values())}, load {os.getloadavg()[0]:.1f}"
                )
            time.sleep(self._rng.uniform(0.05, 0.4))
        time.sleep(3.0)
        after = session.figures()
        self._count_deaths()
        return Outcome(faults, accounts, watcher, before, after, dict(self._restarts), time.monotonic() - start)

    def _choose(self, wanted: list[str]) -> tuple[str, str]:
        """One of those wanted, or any fault, but none that would be the fourth death of a stage within a minute."""
        self._count_deaths()
        mortal = [name for name in STAGES if len([t for t in self._deaths[name] if time.monotonic() - t < WINDOW_S]) < DEATHS]
        kind = self._rng.choice(wanted or [*(LETHAL if mortal else ()), *HARMLESS])
        return kind, self._rng.choice(mortal) if kind in LETHAL else ""

    def _count_deaths(self) -> None:
        for name in STAGES:
            restarts = self._session.restarts(name)
            self._deaths[name] += [time.monotonic()] * (restarts - self._restarts[name])
            self._restarts[name] = restarts

    def _signal(self, pid: int, signum: int) -> None:
        with contextlib.suppress(ProcessLookupError):  # the supervisor was faster
            os.kill(pid, signum)

    def _kill(self, stage: str) -> None:
        self._signal(self._session.pid(stage), signal.SIGKILL)

    def _terminate(self, stage: str) -> None:
        self._signal(self._session.pid(stage), signal.SIGTERM)

    def _stop_3_s(self, stage: str) -> None:
        self._stop(stage, 3.0)  # longer than the limit of a hang

    def _source_stalls_1_s(self, _: str) -> None:
        self._stop("capture", 1.0)

    def _stop(self, stage: str, seconds: float) -> None:
        pid = self._session.pid(stage)
        self._signal(pid, signal.SIGSTOP)
        time.sleep(seconds)
        if self._session.pid(stage) == pid:
            self._signal(pid, signal.SIGCONT)

    def _stop_the_supervisor_3_s(self, _: str) -> None:
        self._session.supervisor.send_signal(signal.SIGSTOP)
        time.sleep(3.0)
        self._session.supervisor.send_signal(signal.SIGCONT)

    def _monitor_killed(self, _: str) -> None:
        monitor = self._session.world.start("monitor", "--session", self._session.world.name, "--json")
        assert monitor.stdout is not None
        monitor.stdout.readline()
        monitor.kill()
        monitor.communicate()

    def _slow_reader(self, _: str) -> None:
        """It holds a slot for a second: the frame is intact, or detected as overwritten."""
        reader = ring.Reader(self._session.session.segment("frames"))
        try:
            reader.last_seq = max(0, reader.published - 1)
            peeked = reader.peek()
            assert peeked is not None
            time.sleep(1.0)
            good = is_whole(peeked[1])
            assert good or not reader.still_valid(peeked[0]), "torn, and said to be whole"
        finally:
            peeked = None
            reader.close()

    def _hogs_2_s(self, _: str) -> None:
        hogs = [subprocess.Popen([sys.executable, "-c", HOG]) for _ in range(2)]
        for hog in hogs:
            hog.wait()

    def _garbage(self, _: str) -> None:
        with control.context() as ctx, ctx.socket(zmq.DEALER) as socket:
            control.connect(socket, self._session.run_dir, "ctl")
            for _ in range(200):
                socket.send(hostile(self._rng))
            for _ in range(200):
                assert socket.poll(60_000), "no answer to garbage"
                answer: dict[str, Any] = control.decode(socket.recv())
                assert answer["ok"] is False, answer
