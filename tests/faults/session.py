"""A live session fed with checksummed frames and watched from outside, for tests and for `profiling/`."""

import contextlib
import os
import signal
import time
from collections.abc import Sequence
from pathlib import Path

from lfpipe.transport.clock import now_ns
from lfpipe.transport.session import Session
from lfpipe.transport.status import State
from tests.faults.watcher import Account, Figures, Watcher, figures, write_checked_frames
from tests.world import World, write_scene

STAGES = ("capture", "track", "render")
PLAIN = ("render.method=nearest", "render.anaglyph=colour", "render.alpha_px=12")  # pictures of one colour: a torn one shows
PATIENCE_S = 120.0


def runs(pid: int) -> bool:
    """Whether a process exists and has not ended: one whose parent was killed may wait long for init to read its exit code."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


class WatchedSession:
    """Runs from the constructor to `end`. scene None: one whose pictures have a single colour and are checked too."""

    def __init__(
        self,
        world: World,
        rate_hz: float = 30.0,
        size_px: tuple[int, int] = (640, 480),
        scene: Path | None = None,
        sets: Sequence[str] = (),
    ) -> None:
        self.world = world
        width_px, height_px = size_px
        frames = write_checked_frames(world.root / "checked-frames", width_px, height_px, 40)
        keys = [f"camera.width_px={width_px}", f"camera.height_px={height_px}", "render.clock=camera", *sets]
        keys += PLAIN if scene is None else ()
        options = [word for text in keys for word in ("--set", text)]
        self._log = (world.root / "session.log").open("w")
        shown = scene or write_scene(world.root / "plain-scene")
        camera = f"file:{frames}?loop=1&pace={rate_hz:g}"
        self.supervisor = world.up(shown, *options, camera=camera, stdout=self._log, stderr=self._log)
        world.wait_for(lambda: len(world.lines()) > 20 or self.supervisor.poll() is not None, "pictures", 60)
        assert self.supervisor.poll() is None, self.output()
        self.session = Session(world.name)
        self.run_dir = next(world.run_dir.glob(f"lfpipe-*-{world.name}"))
        self.watcher = Watcher(self.session, self.run_dir, world.trace, plain=scene is None)
        self.watcher.start()

    def output(self) -> str:
        """The session's last output."""
        return (self.world.root / "session.log").read_text()[-3000:]

    def pid(self, stage: str) -> int:
        """The pid of the stage's current process."""
        return int(self.watcher.table.rows[stage]["pid"])

    def restarts(self, stage: str) -> int:
        """Since the session began."""
        return int(self.watcher.table.rows[stage]["restarts"])

    def pictures_again(self) -> float:
        """Waits for every stage to run and for a picture of a new frame; returns the time to its presentation in s.

        Raises AssertionError if there is none.
        """
        begin_ns = now_ns()
        while True:
            line = self.watcher.newest
            rows = [self.watcher.table.rows[name] for name in STAGES]
            alive = all(row["state"] == State.RUNNING and Path(f"/proc/{row['pid']}").exists() for row in rows)
            if line and line["t_read_ns"] > begin_ns and alive:
                return max(0.0, (line["t_presented_ns"] - begin_ns) / 1e9)
            assert self.supervisor.poll() is None, f"the session ended: {self.output()}"
            assert now_ns() - begin_ns < PATIENCE_S * 1e9, f"no picture for {PATIENCE_S:g} s: {self.output()}"
            time.sleep(0.005)

    def books(self) -> Account:
        """The account of every frame: capture pauses for a moment, so that no frame is in flight.

        A drop by capture shows only at the next frame, and a stage may still be working, so an account that does not balance is
        read again. A wrong count stays wrong.
        """
        for _ in range(5):
            pid = self.pid("capture")
            os.kill(pid, signal.SIGSTOP)
            try:
                found = self.watcher.settled(1.2)  # shorter than the limit of a hang
            finally:
                with contextlib.suppress(ProcessLookupError):  # it counted as hung nevertheless
                    os.kill(pid, signal.SIGCONT)
                self.pictures_again()
            if not any(found.errors().values()):
                break
        return found

    def figures(self) -> Figures:
        """The session's current resources."""
        return figures(self.supervisor.pid, self.session, self.run_dir)

    def end(self) -> None:
        """Detaches from the session and ends it; checks that nothing remains."""
        self.watcher.end()
        self.supervisor.send_signal(signal.SIGINT)
        self.supervisor.wait(120)
        self._log.close()
