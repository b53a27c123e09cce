"""Record: every frame, and what was tracked in it, to a folder on disk.

Reads: ring "frames", every slot in order; the ring of option "packets", the JPEGs they came as, where the source gives them; ring
"eyes", in order too where option "record_eyes" is set.
Writes: the sequence in the folder of option "record".
Commands: stop. Asks: record (to end itself, where the disk is full).
Emits: notice (a recording ended, frames that were lost).
"""

from __future__ import annotations

import json
import queue
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import to_dict
from lfpipe.eyes import EYES as EYES_TYPE
from lfpipe.files.line_file import LineFile
from lfpipe.host.processes import yield_to_others
from lfpipe.host.versions import versions
from lfpipe.record.frame_reader import FrameReader
from lfpipe.sequence.folder import EYES, MANIFEST, begin_manifest, end_manifest
from lfpipe.sequence.packets import PacketWriter, encoded
from lfpipe.transport.clock import MS_NS, now_ns
from lfpipe.transport.context import Context
from lfpipe.transport.ring import Stamp
from lfpipe.transport.ring_ends import RingInput

ROOM_BYTES = 128 << 20  # frames that wait for their encoding: seconds, so that a slow disk costs no frame


class Store:
    """Encodes and appends in a thread of its own, so that the ring is emptied whatever the disk does.

    A packet as it is; a picture as PNG while there is time, and as it stands where it finds a quarter of the room taken.
    """

    def __init__(self, context: Context, folder: Path, shape: tuple[int, ...]) -> None:
        self._context, self._writer, self._shape = context, PacketWriter(folder), shape
        self._room = max(8, ROOM_BYTES // int(np.prod(shape)))
        self._waiting: queue.SimpleQueue[tuple[Stamp, NDArray[np.uint8] | bytes, int] | None] = queue.SimpleQueue()
        self._spare: list[NDArray[np.uint8]] = []
        self._last_ns, self._hurry = 0, False
        self.failure = ""
        self._thread = threading.Thread(target=self._run, name="store")
        self._thread.start()

    @property
    def count(self) -> int:
        """Frames stored."""
        return self._writer.count

    @property
    def checksums(self) -> dict[str, str]:
        """Of the files written."""
        return self._writer.checksums()

    @property
    def full(self) -> bool:
        """Whether another frame has no room now."""
        return self._waiting.qsize() >= self._room

    def spare(self) -> NDArray[np.uint8]:
        """An array for a picture, of which `put` takes possession."""
        return self._spare.pop() if self._spare else np.empty(self._shape, np.uint8)

    def put(self, stamp: Stamp, frame: NDArray[np.uint8] | bytes) -> None:
        """frame: a picture in an array of `spare`, or its JPEG."""
        self._waiting.put((stamp, frame, now_ns()))

    def _run(self) -> None:
        # Gives way to what wakes up for a live picture. A lower priority would be wrong: held back with the interpreter's lock
        # in its hand, this thread would keep the other one from the ring.
        yield_to_others()
        while (taken := self._waiting.get()) is not None:
            if not self.failure:
                self._store(*taken)
            if not isinstance(taken[1], bytes):
                self._spare.append(taken[1])

    def _store(self, stamp: Stamp, frame: NDArray[np.uint8] | bytes, t_taken_ns: int) -> None:
        row = self._context.row
        if stamp.t_sensor_ns <= self._last_ns:
            row["drops"] += 1  # a driver that repeats a stamp repeats a frame; a sequence with it could not be replayed
            return
        hurry = self._hurry or self._waiting.qsize() > self._room // 4
        codec, data = ("jpeg", frame) if isinstance(frame, bytes) else encoded(frame, fast=hurry)
        try:
            self._writer.append(data, codec, stamp.source_seq, stamp.epoch, stamp.t_sensor_ns, stamp.t_read_ns)
        except OSError as error:
            self.failure = str(error.strerror)
            return
        self._last_ns = stamp.t_sensor_ns
        t_ns = now_ns()
        row.tick(stamp.source_seq)
        row.measure(t_taken_ns - stamp.t_publish_ns, t_ns - t_taken_ns, t_ns - stamp.t_sensor_ns)

    def close(self) -> None:
        """Waits until all is on disk, without compression from here on: a session that ends does not wait for long."""
        self._hurry = True
        self._waiting.put(None)
        while self._thread.is_alive():
            self._thread.join(0.1)
            self._context.row.beat()
        self._writer.close()


class EyesLog:
    """One line of JSON per eyes record; without a path they are taken and not written, so that no writer waits for us."""

    def __init__(self, source: RingInput, path: Path | None) -> None:
        """Raises OSError where path cannot be written."""
        self._source, self._file = source, LineFile(path) if path else None
        self._record = np.empty((), EYES_TYPE)

    def skip(self) -> None:
        """Records published until now are not to be had."""
        self._source.skip()

    def serve(self, since: tuple[int, int] | None) -> None:
        """Takes what has come, and writes what is of frames since the one of that (epoch, source_seq); nothing where it is None.

        Raises OSError where the disk is full.
        """
        while (stamp := self._source.take(self._record, in_order=True)) is not None:
            if self._file is None or since is None or (stamp.epoch, stamp.source_seq) < since:
                continue
            line: dict[str, Any] = {"source_seq": stamp.source_seq, "epoch": stamp.epoch, "t_sensor_ns": stamp.t_sensor_ns}
            line |= {name: self._record[name].tolist() for name in EYES_TYPE.names or ()}
            self._file.append(json.dumps(line).encode() + b"\n")

    def close(self) -> None:
        if self._file is not None:
            self._file.close()


def main(context: Context) -> None:
    """Runs the stage until the stop."""
    folder = Path(context.options.record)
    anew = not (folder / MANIFEST).exists()
    frames, lost_before = FrameReader(context), int(context.row["drops"]) if anew else 0
    source, rate_hz = context.options.source, context.options.source_hz
    more = {"versions": versions(), "config": to_dict(context.config)}
    try:
        eyes = EyesLog(context.input("eyes"), folder / EYES if context.options.record_eyes else None)
        manifest = begin_manifest(folder, source, frames.width_px, frames.height_px, rate_hz, **more)
        store = Store(context, folder, frames.shape)
    except OSError as error:
        frames.close()
        _refused(context, folder, error)
        return
    told, first = False, None  # type: tuple[bool, tuple[int, int] | None]
    if anew:
        frames.skip()
        eyes.skip()
    context.ready()
    context.ack_config()
    try:
        while context.wait():
            while not store.full and (taken := frames.take(store.spare)) is not None:
                store.put(*taken)
                first = first or (taken[0].epoch, taken[0].source_seq)
            context.ack_config()
            context.row["cpu_ns"] = time.process_time_ns()
            try:
                eyes.serve(since=first)
            except OSError as error:
                store.failure = str(error.strerror)
            if store.full:
                time.sleep(MS_NS / 1e9)  # the ring wakes us again and again, and there is nowhere to put its frames
            if store.failure and not told:
                told = True
                ends = f"it ends with its frame {store.count - 1}" if store.count else "it ends before its first frame"
                context.emit("notice", text=f"recording {folder}: {store.failure}; {ends}")
                context.request("record", path="")
    finally:
        store.close()
        frames.close()
        eyes.close()
        missed = int(context.row["drops"]) - lost_before
        lost = f", {missed} lost" if missed else ""
        try:
            end_manifest(folder, manifest, store.count, store.checksums)
            text = f"recorded {store.count} frames to {folder}{lost}"
        except OSError as error:
            text = f"recorded {store.count} frames to {folder}{lost}; not completed: {error.strerror}"
        context.emit("notice", text=text)


def _refused(context: Context, folder: Path, error: OSError) -> None:
    """Nothing can be written from the start: tells, asks for its own end, and waits for it."""
    context.ready()
    context.emit("notice", text=f"recording {folder}: {error.strerror}; nothing is recorded")
    context.request("record", path="")
    context.ack_config()
    while context.wait():
        context.ack_config()
