"""Checks every frame, eyes record and picture of a session from outside: intact or torn, published or lost, to the last one."""

import contextlib
import json
import threading
import time
import zlib
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np
import zmq
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.capture.open_source import open_source
from lfpipe.transport import control, ring, status
from lfpipe.transport.clock import now_ns
from lfpipe.transport.session import Session

LEASE_S = 20.0
STAGES = ("capture", "track", "render")


def write_checked_frames(folder: Path, width_px: int, height_px: int, count: int) -> Path:
    """A folder of BMP pictures of the demo's face whose first row holds the checksum of the rest and nothing else."""
    folder.mkdir(parents=True)
    source = open_source("demo", config.Camera(width_px=width_px, height_px=height_px))
    frame = np.empty((height_px, width_px, 3), np.uint8)
    for k in range(count):
        source.read(frame)
        frame[0] = 0
        frame[0].reshape(-1)[:4] = np.frombuffer(zlib.crc32(frame[1:]).to_bytes(4, "little"), np.uint8)
        cv2.imwrite(str(folder / f"f{k:04d}.bmp"), frame)
    source.close()
    return folder


def is_whole(frame: NDArray[np.uint8]) -> bool:
    """Whether a frame's checksum is right."""
    return frame[0].reshape(-1)[:4].tobytes() == zlib.crc32(frame[1:]).to_bytes(4, "little")


@attrs.frozen
class Account:
    """The account of every frame of a session while none is in flight.

    capture_lost: frames that are missing between others; capture_deaths: after each of them it counts from 0 again. `*_drops` is
    what a stage says that it lost or left out.
    """

    frames: int
    eyes: int
    lines: int
    capture_lost: int
    capture_deaths: int
    capture_drops: int
    track_drops: int
    render_drops: int

    @property
    def unseen(self) -> int:
        """Drops of a capture stage that died before its next frame: counted, but not visible as a gap between frames."""
        return max(0, self.capture_drops - self.capture_lost) if self.capture_deaths else 0

    def errors(self) -> dict[str, int]:
        """stage -> drops counted less drops there were; zeros in a session that counts exactly."""
        return {
            "capture": self.capture_drops - self.capture_lost - self.unseen,
            "track": self.track_drops - (self.frames - self.eyes),
            "render": self.render_drops - (self.eyes - self.lines),
        }


class Watcher(threading.Thread):
    """Attached to a session until `end`. lapped: overwritten during the check and detected; torn: not detected."""

    def __init__(self, session: Session, run_dir: Path, trace: Path, plain: bool) -> None:
        super().__init__(daemon=True)
        self.table = status.Table(session.segment("status"))
        self._session, self._run_dir, self._trace = session, run_dir, trace
        self._frames, self._eyes = ring.Reader(session.segment("frames")), ring.Reader(session.segment("eyes"))
        self._plain = plain  # every picture of one colour; others are not looked at
        self._pictures: ring.Reader | None = None
        self._runs: list[int] = []  # of capture: last source_seq of each
        self._last = (-1, -1)  # epoch and source_seq of the newest frame
        self._ended = threading.Event()
        self._offset, self._rest = 0, b""
        self.lines = 0
        self.newest: dict[str, Any] = {}
        self.seen = self.missed = self.lapped = self.torn = self.pictures = self.torn_pictures = self.out_of_order = 0

    def run(self) -> None:
        with control.context() as ctx, ctx.socket(zmq.DEALER) as ctl:
            control.connect(ctl, self._run_dir, "ctl")
            picture = np.empty(0, np.uint8)
            lease_ns = 0
            while not self._ended.wait(0.004):
                self._look_at_frames()
                self.read_trace()
                if self._plain and now_ns() > lease_ns:
                    ctl.send(control.encode({"cmd": "pictures", "lease_s": LEASE_S}))
                    lease_ns = now_ns() + int(LEASE_S / 3 * 1e9)
                while ctl.poll(0):
                    answer = control.decode(ctl.recv())
                    if self._pictures is None and answer.get("ok"):
                        self._pictures = ring.Reader(self._session.segment(answer["ring"]))
                        picture = np.empty(self._pictures.shape, np.uint8)
                if self._pictures is not None and self._pictures.read(picture) is not None:
                    self.pictures += 1
                    self.torn_pictures += bool((picture != picture[0, 0]).any())  # each is of one colour

    def _look_at_frames(self) -> None:
        while (peeked := self._frames.peek(in_order=True)) is not None:
            stamp, frame = peeked
            good = is_whole(frame)
            self.missed += stamp.skipped
            if not self._frames.still_valid(stamp):
                self.lapped += 1
            else:
                self.seen += 1
                self.torn += not good
            epoch, source_seq = self._last
            self.out_of_order += (stamp.epoch, stamp.source_seq) <= self._last
            if stamp.epoch > epoch and stamp.source_seq <= source_seq:  # it counts from 0 again
                self._runs.append(source_seq)
            self._last = (stamp.epoch, stamp.source_seq)

    def read_trace(self) -> None:
        """Reads the new lines."""
        with self._trace.open("rb") as file:
            file.seek(self._offset)
            data = file.read()
        self._offset += len(data)
        lines = (self._rest + data).split(b"\n")
        self._rest = lines.pop()
        self.lines += len(lines)
        if lines:
            self.newest = json.loads(lines[-1])

    def account(self) -> Account:
        """The current account; exact only while capture is paused."""
        row = {name: int(self.table.rows[name]["drops"] + self.table.rows[name]["left_out"]) for name in STAGES}
        frames = self._frames.published
        return Account(
            frames=frames,
            eyes=self._eyes.published,
            lines=self.lines,
            capture_lost=sum(last + 1 for last in (*self._runs, self._last[1])) - frames,
            capture_deaths=len(self._runs),
            capture_drops=row["capture"],
            track_drops=row["track"],
            render_drops=row["render"],
        )

    def settled(self, patience_s: float) -> Account:
        """The account once nothing has changed for 0.2 s and it balances, or its state at the timeout."""
        last, since, end = self.account(), time.monotonic(), time.monotonic() + patience_s
        while time.monotonic() < end and (time.monotonic() - since < 0.2 or any(last.errors().values())):
            time.sleep(0.02)
            now = self.account()
            if now != last:
                last, since = now, time.monotonic()
        return last

    def end(self) -> None:
        """Detaches from the session."""
        self._ended.set()
        self.join()
        if self._pictures is not None:
            self._pictures.close()
        self._frames.close()
        self._eyes.close()
        self.table.close()


@attrs.frozen
class Figures:
    """Resources of a session: processes by name with anonymous memory in MB and descriptors; names of segments and run files."""

    processes: dict[str, tuple[float, int]]
    segments: tuple[str, ...]
    files: tuple[str, ...]

    @property
    def descriptors(self) -> int:
        return sum(count for _, count in self.processes.values())


def rss_mb(pid: int, field: str = "RssAnon") -> float:
    """Resident memory of a process that is its own, in MB: shared pages belong to the rings."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith(field + ":"):
            return int(line.split()[1]) / 1024
    raise ValueError(field)


def figures(supervisor_pid: int, session: Session, run_dir: Path) -> Figures:
    """The figures of an idle session."""
    pids = [supervisor_pid, *map(int, Path(f"/proc/{supervisor_pid}/task/{supervisor_pid}/children").read_text().split())]
    table = status.Table(session.segment("status"))
    names = {int(row["pid"]): name for name, row in table.rows.items()} | {supervisor_pid: "supervisor"}
    table.close()
    processes = {}
    for pid in pids:
        with contextlib.suppress(FileNotFoundError):
            name = names.get(pid) or Path(f"/proc/{pid}/comm").read_text().strip()  # of a helper of multiprocessing
            processes[name] = (rss_mb(pid), len(list(Path(f"/proc/{pid}/fd").iterdir())))
    segments = sorted(path.name for path in Path("/dev/shm").glob(f"{session.segment('')}*"))
    files = sorted(path.name for path in run_dir.iterdir() if not path.name.startswith(("error.", "stack.")))
    return Figures(processes, tuple(segments), tuple(files))
