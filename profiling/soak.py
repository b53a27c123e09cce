"""Random faults in one session, one after another, while every frame and picture is checked from
outside: pictures return after each, none is torn, every drop is counted, and nothing accumulates.

    python -m profiling.soak 500         # half an hour; exit code 1 where something is wrong
"""

import argparse
import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
import zlib
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.capture.open_source import open_source
from lfpipe.supervisor.stage_process import HANG_S
from lfpipe.transport import control, ring, status
from lfpipe.transport.control import Session
from lfpipe.transport.ring import now_ns
from lfpipe.transport.status import State
from tests.support.world import World, connected, private_world, write_scene

STAGES = ("capture", "track", "render")
LETHAL = ("kill", "terminate", "stop")
HARMLESS = ("stop_supervisor", "stall", "hog", "send_garbage", "pause")
# of one stage: five in 60 s end a session, and after the fourth it waits before a restart
DEATHS, WINDOW_S = 3, 61.0
LEAK_MB = 4.0  # of one process; allocators differ by less from start to start
LEASE_S, PATIENCE_S = 20.0, 120.0
SIZE_PX = (320, 240)
# pictures of one colour: a torn one shows
SETS = (
    "render.clock=camera",
    "render.method=nearest",
    "render.anaglyph=colour",
    "render.alpha_px=12",
)
HOG = "import time\nend = time.time() + 2\nwhile time.time() < end: pass"


def write_checked_frames(folder: Path, count: int) -> Path:
    """A folder of BMP pictures of the demo's face whose first row holds the checksum of the rest
    and nothing else.
    """
    folder.mkdir()
    width_px, height_px = SIZE_PX
    source = open_source("demo", config.Camera(width_px=width_px, height_px=height_px))
    frame = np.empty((height_px, width_px, 3), np.uint8)
    for k in range(count):
        source.read(frame)
        frame[0] = 0
        frame[0].reshape(-1)[:4] = np.frombuffer(checksum(frame), np.uint8)
        cv2.imwrite(str(folder / f"f{k:04d}.bmp"), frame)
    source.close()
    return folder


def checksum(frame: NDArray[np.uint8]) -> bytes:
    """Of all rows but the first."""
    return zlib.crc32(frame[1:].data).to_bytes(4, "little")


def is_whole(frame: NDArray[np.uint8]) -> bool:
    """Whether a frame's checksum is right."""
    row: bytes = frame[0].tobytes()
    return row.startswith(checksum(frame))


class Watcher(threading.Thread):
    """Looks at every frame and picture of a session until `end`. newest: line of the trace."""

    def __init__(self, session: Session, trace: Path) -> None:
        super().__init__(daemon=True)
        self.table = status.Table(session.segment("status"))
        self._session, self._trace = session, trace
        self._frames = ring.Reader(session.segment("frames"))
        self._eyes = ring.Reader(session.segment("eyes"))
        self._last = (-1, -1)  # epoch and source_seq of the newest frame
        self._ended = threading.Event()
        self._offset = 0
        self._rest = b""
        self._lines = 0
        self.newest = {"t_read_ns": 0}
        self.frames = self.pictures = self.torn_frames = self.torn_pictures = self.out_of_order = 0

    def run(self) -> None:
        pictures: ring.Reader | None = None
        lease_ns = 0
        with connected(self._session.run_dir) as ctl:
            while not self._ended.wait(0.004):
                self._look_at_frames()
                self._read_trace()
                if now_ns() > lease_ns:
                    ctl.send(control.encode({"cmd": "pictures", "lease_s": LEASE_S}))
                    lease_ns = now_ns() + int(LEASE_S / 3 * 1e9)
                while ctl.poll(0):
                    answer = control.decode(ctl.recv())
                    if pictures is None and answer.get("ok"):
                        pictures = ring.Reader(self._session.segment(answer["ring"]))
                        picture = np.empty(pictures.shape, np.uint8)
                if pictures is not None and pictures.read(picture) is not None:
                    self.pictures += 1
                    self.torn_pictures += bool((picture != picture[0, 0]).any())
        if pictures is not None:
            pictures.close()

    def _look_at_frames(self) -> None:
        while (peeked := self._frames.peek(in_order=True)) is not None:
            stamp, frame = peeked
            whole = is_whole(frame)
            if self._frames.still_valid(stamp):  # not overwritten meanwhile
                self.frames += 1
                self.torn_frames += not whole
            self.out_of_order += (stamp.epoch, stamp.source_seq) <= self._last
            self._last = (stamp.epoch, stamp.source_seq)

    def _read_trace(self) -> None:
        with self._trace.open("rb") as file:
            file.seek(self._offset)
            data = file.read()
        self._offset += len(data)
        *lines, self._rest = (self._rest + data).split(b"\n")
        self._lines += len(lines)
        if lines:
            self.newest = json.loads(lines[-1])

    def miscounts(self) -> tuple[int, int]:
        """Drops counted by track and by render, less those there were; exact while no frame is in
        flight.
        """
        track, render = (
            int(self.table.rows[name]["drops"] + self.table.rows[name]["left_out"])
            for name in ("track", "render")
        )
        return track - (self._frames.published - self._eyes.published), render - (
            self._eyes.published - self._lines
        )

    def end(self) -> None:
        """Detaches from the session."""
        self._ended.set()
        self.join(60)
        self._frames.close()
        self._eyes.close()
        self.table.close()


class Soak:
    """A session under faults, from the constructor to `end`. restarts: of each stage."""

    def __init__(self, world: World, seed: int) -> None:
        self.world = world
        self._rng = random.Random(seed)
        frames = write_checked_frames(world.root / "checked-frames", 40)
        self._log = (world.root / "session.log").open("w")
        sets = (
            f"--set={key}"
            for key in (f"camera.width_px={SIZE_PX[0]}", f"camera.height_px={SIZE_PX[1]}", *SETS)
        )
        self._supervisor = world.shows(
            write_scene(world.root / "plain"),
            *sets,
            camera=f"file:{frames}?loop=1&pace=30",
            stdout=self._log,
            stderr=self._log,
            pictures=20,
        )
        self._session = Session(world.name)
        self.watcher = Watcher(self._session, world.trace)
        self.watcher.start()
        self.restarts = dict.fromkeys(STAGES, 0)
        self._deaths: dict[str, list[float]] = {name: [] for name in STAGES}

    def run(self, count: int) -> list[str]:
        """Injects faults, one of each kind before random ones.

        Returns what went wrong, in words.
        """
        time.sleep(3.0)  # after warm-up of allocators and lazy imports
        before = self._resources()
        wrong = []
        for number in range(count):
            kind, stage = self._choose([*LETHAL, *HARMLESS][number : number + 1])
            getattr(self, f"_{kind}")(stage)
            self._wait_for_pictures(f"{kind} {stage}")
            if (number % 4 == 3 or number == count - 1) and any(
                miscounts := self._miscounts_at_rest()
            ):
                wrong.append(
                    f"after {kind} {stage}: drops counted less those there were: {miscounts}"
                )
            time.sleep(self._rng.uniform(0.05, 0.4))
        time.sleep(3.0)
        self._count_deaths()
        watcher = self.watcher
        after = self._resources()
        wrong += [
            f"{n} {name}"
            for name in ("torn_frames", "torn_pictures", "out_of_order")
            if (n := getattr(watcher, name))
        ]
        for name in before.keys() | after.keys():
            was, now = before.get(name, ()), after.get(name, ())
            grown = len(was) != len(now) or any(
                b > a + more for a, b, more in zip(was, now, (LEAK_MB, 1), strict=False)
            )
            wrong += [f"{name}: {was} to {now} (MB, descriptors)"] if grown else []
        return wrong

    def _resources(self) -> dict[str, tuple[float, ...]]:
        """Memory of its own (MB) and descriptors of each process; segments and files by name."""
        table = self.watcher.table
        pid = self._supervisor.pid
        names = {int(row["pid"]): name for name, row in table.rows.items()} | {pid: "supervisor"}
        metrics: dict[str, tuple[float, ...]] = {}
        for process in (
            pid,
            *map(int, Path(f"/proc/{pid}/task/{pid}/children").read_text().split()),
        ):
            with contextlib.suppress(FileNotFoundError):
                lines = Path(f"/proc/{process}/status").read_text().splitlines()
                anonymous_mb = (
                    next(int(line.split()[1]) for line in lines if line.startswith("RssAnon:"))
                    / 1024
                )
                # a helper of multiprocessing
                name = names.get(process) or Path(f"/proc/{process}/comm").read_text().strip()
                metrics[name] = anonymous_mb, len(list(Path(f"/proc/{process}/fd").iterdir()))
        files = [
            path.name
            for path in self._session.run_dir.iterdir()
            if not path.name.startswith(("error.", "stack.")) and path.suffix != ".1"  # older log
        ]
        return metrics | dict.fromkeys(files, (0.0,))

    def _wait_for_pictures(self, after: str) -> None:
        """Waits for every stage to run and for a picture of a new frame."""
        begin_ns = now_ns()

        def shown() -> bool:
            assert self._supervisor.poll() is None, (
                f"the session ended after {after}: {self._output()}"
            )
            rows = [self.watcher.table.rows[name] for name in STAGES]
            alive = all(
                row["state"] == State.RUNNING and Path(f"/proc/{row['pid']}").exists()
                for row in rows
            )
            return alive and self.watcher.newest["t_read_ns"] > begin_ns

        self.world.wait_for(shown, f"picture after {after}", PATIENCE_S)

    def _output(self) -> str:
        return (self.world.root / "session.log").read_text()[-3000:]

    def _miscounts_at_rest(self) -> tuple[int, int]:
        """While capture is stopped, for less than the limit of a hang, so that no frame is in
        flight. Counts that differ are read again, because a stage may still be working: a wrong one
        stays wrong.
        """
        for _ in range(5):
            pid = self._pid("capture")
            end = time.monotonic() + 1.2
            self._signal(pid, signal.SIGSTOP)
            time.sleep(0.2)
            while any(miscounts := self.watcher.miscounts()) and time.monotonic() < end:
                time.sleep(0.02)
            self._signal(pid, signal.SIGCONT)
            self._wait_for_pictures("a look at the counts")
            if not any(miscounts):
                break
        return miscounts

    def _choose(self, wanted: list[str]) -> tuple[str, str]:
        """One of those wanted, or any fault, but none that would be the fourth death of a stage
        within a minute.
        """
        self._count_deaths()
        mortal = [
            name
            for name in STAGES
            if len([t for t in self._deaths[name] if time.monotonic() - t < WINDOW_S]) < DEATHS
        ]
        kind = self._rng.choice(wanted or [*(LETHAL if mortal else ()), *HARMLESS])
        return kind, self._rng.choice(mortal) if kind in LETHAL else ""

    def _count_deaths(self) -> None:
        for name in STAGES:
            restarts = int(self.watcher.table.rows[name]["restarts"])
            self._deaths[name] += [time.monotonic()] * (restarts - self.restarts[name])
            self.restarts[name] = restarts

    def _pid(self, stage: str) -> int:
        return int(self.watcher.table.rows[stage]["pid"])

    def _signal(self, pid: int, signum: int) -> None:
        with contextlib.suppress(ProcessLookupError):  # the supervisor was faster
            os.kill(pid, signum)

    def _kill(self, stage: str) -> None:
        self._signal(self._pid(stage), signal.SIGKILL)

    def _terminate(self, stage: str) -> None:
        self._signal(self._pid(stage), signal.SIGTERM)

    def _stop(self, stage: str, seconds: float = HANG_S + 1.0) -> None:
        pid = self._pid(stage)
        self._signal(pid, signal.SIGSTOP)
        time.sleep(seconds)
        if self._pid(stage) == pid:
            self._signal(pid, signal.SIGCONT)

    def _stall(self, _: str) -> None:
        self._stop("capture", 1.0)

    def _stop_supervisor(self, _: str) -> None:
        self._supervisor.send_signal(signal.SIGSTOP)
        time.sleep(3.0)
        self._supervisor.send_signal(signal.SIGCONT)

    def _hog(self, _: str) -> None:
        for hog in [subprocess.Popen([sys.executable, "-c", HOG]) for _ in range(2)]:
            hog.wait(60)

    def _pause(self, _: str) -> None:
        """No frame is lost without being counted."""
        before = self._unaccounted()
        for seconds in (0.4, 0.05, 0.01):
            assert self.world.ask(cmd="pause")["ok"]
            time.sleep(seconds)
            assert self.world.ask(cmd="resume")["ok"]
        self._wait_for_pictures("a pause")
        after = self._unaccounted()
        assert after == before, (before, after)

    def _unaccounted(self) -> int:
        """The camera's frames up to the newest published one, less those published, dropped or left
        out. The largest of several: a drop since that frame makes it smaller.
        """
        pid = self._pid("capture")
        row = self.watcher.table.rows["capture"]
        counts = []
        for _ in range(10):
            self._signal(pid, signal.SIGSTOP)
            source_seq, seq, drops, left_out = (
                int(row[name]) for name in ("source_seq", "seq", "drops", "left_out")
            )
            self._signal(pid, signal.SIGCONT)
            counts.append(source_seq - seq - drops - left_out)
            time.sleep(0.05)
        return max(counts)

    def _send_garbage(self, _stage: str) -> None:
        with connected(self._session.run_dir) as socket:
            for _ in range(200):
                socket.send(self._rng.randbytes(self._rng.randrange(1, 200)))
            for _ in range(200):
                assert socket.poll(60_000) and control.decode(socket.recv())["ok"] is False

    def end(self) -> None:
        """Ends watcher and session."""
        self.watcher.end()
        self._supervisor.send_signal(signal.SIGINT)
        self._supervisor.wait(120)
        self._log.close()


def main() -> int:
    """Prints what went wrong."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("count", type=int, help="faults")
    parser.add_argument("--seed", type=int, default=3)
    words = parser.parse_args()
    with private_world() as world:
        soak = Soak(world, words.seed)
        wrong = soak.run(words.count)
        seen = f"{soak.watcher.frames} frames, {soak.watcher.pictures} pictures"
        print("\n".join([seen, f"restarts: {soak.restarts}", *wrong]))
        soak.end()
        return int(bool(wrong or world.left()))


if __name__ == "__main__":
    raise SystemExit(main())
