"""An exhibition alone: random stages killed, the session ended by five deaths, the supervisor killed, the camera unplugged, the
disk full, keys pressed, visitors who come and go. How soon does all go on, and what is left at the end?

    unshare -m uv run python -m profiling.kiosk_soak [--minutes 30] [--seed 1]

Needs Xvfb, xdotool and, for the small disk, a mount namespace of its own as root. The script stands in for systemd: it starts
the exhibition again 2 s after it ends with another code than 0. Prints progress, then a table; exit code 1 if pictures ever
stayed away for LIMIT_S or the code did not end it.
"""

import contextlib
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import psutil

from lfpipe.errors import UserError
from lfpipe.transport.session import Session
from lfpipe.transport.status import State, Table
from profiling.arguments import parser_of, start
from tests.world import World, private_world, write_scene
from tests.xvfb_screen import Screen, x_server

LIMIT_S, AGAIN_S = 20.0, 2.0
CODE, DISK_MB = "leave2026", 64
STAGES = ("capture", "track", "render")
KEYS = ("q", "Escape", "F11", "m", "Tab", "space", "g", "Return", "alt+F4")


class Exhibition:
    """The session as systemd would run it, its camera's node and its disk."""

    def __init__(self, world: World, screen: Screen, log: Path) -> None:
        self.world, self.screen, self._log = world, screen, log
        self.node, self.disk = world.root / "video0", world.root / "disk"
        self.starts = self.by_systemd = 0
        self._process: subprocess.Popen[str] | None = None
        self.disk.mkdir()
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK_MB}m", "tmpfs", self.disk], check=True)
        for name in ("cache", "config", "state"):
            world.env[f"XDG_{name.upper()}_HOME"] = str(self.disk / name)
        world.env["DISPLAY"], world.module = screen.name, "tests.faults.scripted_camera"
        self.node.write_text("frames")
        self._scenes = [write_scene(world.root / "scenes" / f"scene{k}", 3, 3 + k, (96, 128)) for k in range(3)]

    def run(self) -> None:
        """Starts it where it does not run."""
        if self._process is not None:
            if self._process.poll() is None:
                return
            self.by_systemd += 1
            time.sleep(AGAIN_S)
        with self._log.open("a") as log:
            fixed = ("--camera", f"camera:{self.node}", "--session", self.world.name, "--visits", self.disk / "visits.csv")
            self._process = self.world.start("up", *self._scenes, *fixed, "--kiosk", CODE, stdout=log, stderr=log)

    @property
    def pid(self) -> int:
        """Of the supervisor."""
        assert self._process is not None
        return self._process.pid

    def stages(self) -> dict[str, tuple[int, int]]:
        """(pid, count of what it did) of each stage that runs."""
        try:
            table = Table(Session(self.world.name).segment("status"))
        except (OSError, UserError, ValueError):
            return {}
        try:
            return {
                n: (int(r["pid"]), int(r["seq"])) for n, r in table.rows.items() if n in STAGES and r["state"] == State.RUNNING
            }
        finally:
            table.close()

    def kill(self, stage: str) -> bool:
        """Kills one; whether it was there."""
        pid = self.stages().get(stage, (0, 0))[0]
        with contextlib.suppress(ProcessLookupError):
            if pid:
                os.kill(pid, signal.SIGKILL)
        return bool(pid)

    def all_again(self, limit_s: float = 60.0) -> float:
        """Seconds until frames come, eyes are tracked and pictures are shown anew, in a window that is not black."""
        self.run()
        began, before = time.monotonic(), self.stages()
        while time.monotonic() - began < limit_s:
            self.run()
            now = self.stages()
            anew = len(now) == len(STAGES) and all(each != before.get(name) and each[1] for name, each in now.items())
            if anew and self.screen.picture().any():
                return time.monotonic() - began
            time.sleep(0.02)
        return limit_s

    def leave(self) -> int:
        """Types the code; returns the exit code."""
        assert self._process is not None
        subprocess.run(["xdotool", "type", "--delay", "40", CODE], env=self.world.env, check=False)
        return self._process.wait(30)

    def close(self) -> None:
        """Ends what runs, and takes the disk away."""
        self.world.end()
        subprocess.run(["umount", self.disk], check=False)


def faults(show: Exhibition, dice: random.Random) -> dict[str, Callable[[], None]]:
    """What happens to it. Each returns once the cause has gone, where it has an end."""

    def storm() -> None:
        end = time.monotonic() + 30
        while time.monotonic() < end and show.kill("render"):
            time.sleep(0.1)
            while time.monotonic() < end and show.stages() and "render" not in show.stages():
                time.sleep(0.05)

    def away(word: str | None, least_s: float, most_s: float) -> None:
        show.node.unlink() if word is None else show.node.write_text(word)
        time.sleep(dice.uniform(least_s, most_s))
        show.node.write_text("frames")

    def full() -> None:
        filler = show.disk / "filler"
        with contextlib.suppress(OSError), filler.open("wb", buffering=0) as file:
            while file.write(bytes(1 << 16)):
                pass
        show.kill(dice.choice(STAGES))
        away("empty", 12, 15)
        time.sleep(3)  # a visitor is counted, and cannot be written
        filler.unlink()

    def supervisor() -> None:
        os.kill(show.pid, signal.SIGKILL)
        time.sleep(0.3)

    def keys() -> None:
        subprocess.run(["xdotool", "key", *(dice.choice(KEYS) for _ in range(6))], env=show.world.env, check=False)

    return {
        **{f"{name} killed": lambda name=name: show.kill(name) for name in STAGES},  # type: ignore[dict-item,misc]
        "five deaths: the session ends": storm,
        "supervisor killed": supervisor,
        "camera unplugged 5 to 20 s": lambda: away(None, 5, 20),
        "nobody there for 11 to 15 s": lambda: away("empty", 11, 15),
        "disk full, a stage killed": full,
        "keys pressed": keys,
    }


def main() -> int:
    args = parser_of(__doc__, minutes=30.0, seed=1).parse_args()
    dice, found = random.Random(args.seed), {}
    log = Path(tempfile.gettempdir()) / "kiosk_soak.log"
    log.unlink(missing_ok=True)
    with private_world() as world, tempfile.TemporaryDirectory() as folder:
        command = ["Xvfb", "-screen", "0", "1280x800x24", "-fbdir", folder]
        with x_server(command, Path(folder)) as name, contextlib.ExitStack() as steps:
            show = Exhibition(world, Screen(name, Path(folder) / "Xvfb_screen0"), log)
            steps.callback(show.close)
            first_s = show.all_again()
            before_mb = psutil.Process(show.pid).memory_info().rss / 1e6
            kinds, end = faults(show, dice), time.monotonic() + 60 * args.minutes
            names = list(kinds)
            while time.monotonic() < end:
                dice.shuffle(names)
                for kind in names:
                    kinds[kind]()
                    found.setdefault(kind, []).append(show.all_again())
                    print(f"{kind}: {found[kind][-1]:.2f} s", file=sys.stderr, flush=True)
                    time.sleep(dice.uniform(3, 8))
                    if time.monotonic() > end:
                        break
            after_mb, code = psutil.Process(show.pid).memory_info().rss / 1e6, show.leave()
            visits = (show.disk / "visits.csv").read_text().splitlines()[1:]
            left = world.left()
    print("| what happened | times | all goes on, median s | longest s |\n|---|---|---|---|")
    for kind, times in sorted(found.items()):
        print(f"| {kind} | {len(times)} | {statistics.median(times):.2f} | {max(times):.2f} |")
    text = log.read_text()
    counted = sum(int(line.split(",")[1]) for line in visits)
    again = text.count("starts again")
    print(
        f"\nfirst picture {first_s:.1f} s after the start; started again {again} times by itself and {show.by_systemd} times by"
    )
    print(f"the script, as systemd would; {counted} visits counted; supervisor {before_mb:.0f} MB, {after_mb:.0f} MB at the end;")
    print(f"the code ended it with {code}; {len(left)} files left; {text.count('Traceback')} tracebacks in its log,")
    print(f"of {len(text.splitlines())} lines ({log})")
    worst = max(max(times) for times in found.values())
    return 0 if worst < LIMIT_S and code == 0 and not left else 1


if __name__ == "__main__":
    start(main)
