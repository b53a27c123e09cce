"""Stage record: writes every frame to a folder on disk, or the eyes that the mouse makes.

Reads: ring "frames", every slot in order; the ring of option "packets", the source's JPEGs if it delivers them; of
a session of the mouse, ring "eyes" in place of frames.
Writes: the sequence in the folder of option "record"; it ends when the option changes.
Commands: stop. Asks: record (to end the recording, if writing fails).
Emits: notice (end of a recording, lost frames).
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import to_dict
from lfpipe.eyes import EYES
from lfpipe.host.files import exists
from lfpipe.host.machine import versions
from lfpipe.record.store import Store
from lfpipe.sequence.eyes import eyes_line
from lfpipe.sequence.folder import MANIFEST, begin_manifest, end_manifest
from lfpipe.transport.clock import MS_NS, now_ns
from lfpipe.transport.context import Context
from lfpipe.transport.packet_ring import PacketInput
from lfpipe.transport.ring import Stamp

FULL_NS = 5 * MS_NS  # between looks whether a full store has room again


class FrameReader:
    """Reads the frames in order, as the source's own JPEGs if it delivers them. size_px: of the stored frames."""

    def __init__(self, context: Context) -> None:
        self._row, self._frames, self._eyes = context.row, context.input("frames"), context.input("eyes")
        self.shape: tuple[int, ...] = self._frames.reader.shape
        self.size_px = self.shape[1], self.shape[0]
        self._packets: PacketInput | None = None
        self._begun = True
        if context.options.packets:
            try:
                self._packets = PacketInput(context.spec.session, context.options.packets)
            except FileNotFoundError:
                return  # stopped before it began
            self.size_px = context.options.jpeg_px or (0, 0)

    def skip(self) -> None:
        """Frames published until now are neither recorded nor counted as lost. Nor are frames before the first JPEG."""
        self._frames.skip()
        self._begun = False

    def take(self, spare: Callable[[], NDArray[np.uint8]]) -> tuple[Stamp, str, NDArray[np.uint8] | bytes] | None:
        """The next frame: (stamp, "jpeg", its JPEG) or (stamp, "", its picture in an array from spare); None if there is none."""
        self._eyes.skip()
        while (peeked := self._frames.peek(in_order=True)) is not None:
            stamp, slot = peeked
            packet = self._packets.of(stamp) if self._packets else None
            if packet is not None:
                self._begun = True
                return stamp, "jpeg", packet
            if self._packets is not None and self._packets.ended:
                return None  # the recording is being stopped; capture has already stopped sending JPEGs
            if self.shape[1::-1] != self.size_px:
                self._row["drops"] += self._begun  # it is scaled, so it does not fit this recording
                continue
            picture = spare()
            np.copyto(picture, slot)
            if self._frames.still_valid(stamp):
                return stamp, "", picture
        return None

    def close(self) -> None:
        """Unmaps the packets."""
        if self._packets is not None:
            self._packets.close()


class EyesReader:
    """Reads the eyes in order, in place of frames."""

    def __init__(self, context: Context) -> None:
        self._frames, self._eyes, self._record = context.input("frames"), context.input("eyes"), np.empty((), EYES)
        self.size_px = context.config.camera.frame_px
        self.shape = (*self.size_px, 3)
        self.skip, self.close = self._eyes.skip, lambda: None

    def take(self, _spare: object = None) -> tuple[Stamp, str, bytes] | None:
        """The next eyes: (stamp, "eyes", a line of JSON); None without new ones. Frames, if any, are empty."""
        self._frames.skip()
        stamp = self._eyes.take(self._record, in_order=True)
        return None if stamp is None else (stamp, "eyes", eyes_line(self._record, source_seq=stamp.source_seq))


class Recorder:
    """The main thread's part: reads frames or eyes, updates the status row, reports errors."""

    def __init__(self, context: Context, folder: Path) -> None:
        """Raises OSError if nothing can be written."""
        self._context, self._folder = context, folder
        anew = not exists(folder / MANIFEST)
        self._lost_before = int(context.row["drops"]) if anew else 0
        options = context.options
        eyes_only = options.mouse or bool(options.eyes)
        self._frames: FrameReader | EyesReader = EyesReader(context) if eyes_only else FrameReader(context)
        self._reported = self._slow = False
        more: dict[str, Any] = {"versions": versions(), "config": to_dict(context.config)}
        rate_hz = options.source_hz or context.config.render.nominal_hz
        self._manifest = begin_manifest(folder, options.source, *self._frames.size_px, rate_hz, **more)
        self._store = Store(folder, self._frames.shape)
        if anew:
            self._frames.skip()

    def wait(self) -> bool:
        """Waits for frames, or for room to store them. False once the recording must end."""
        context, full = self._context, self._store.full
        context.wait(now_ns() + FULL_NS if full else None, inputs=not full)
        return not context.stopping and context.options.record == str(self._folder)

    def take(self) -> None:
        """Passes new frames to the store, as far as it has room."""
        store = self._store
        while not store.full and (taken := self._frames.take(store.spare)) is not None:
            store.put(*taken)

    def report(self) -> None:
        """Updates the status row. After an error, reports it once and requests the end of the recording."""
        context, store = self._context, self._store
        for done in store.results():
            if not done.kept:
                context.row["drops"] += 1
                continue
            stamp = done.stamp
            context.row.tick(stamp.source_seq)
            waited_ns, took_ns = done.t_taken_ns - stamp.t_publish_ns, done.t_stored_ns - done.t_taken_ns
            context.row.measure(waited_ns, took_ns, done.t_stored_ns - stamp.t_sensor_ns)
        context.row["cpu_ns"] = time.process_time_ns()
        if store.slow != self._slow:
            self._slow = not self._slow
            context.row.set_busy("waiting for the disk" if self._slow else "")
        if store.failure and not self._reported:
            self._reported = True
            ends = f"its last frame is {store.count - 1}" if store.count else "no frame was recorded"
            _give_up(context, f"recording {self._folder}: {store.failure}; {ends}")

    def end(self) -> None:
        """Stores the rest from rings and memory, and completes the sequence."""
        context, store = self._context, self._store
        with context.saving("writing the recording"):
            self.take()
            checksums = store.close()
            self.report()
            self._frames.close()
            missed = int(context.row["drops"]) - self._lost_before
            text = f"recorded {store.count} frames to {self._folder}" + (f", {missed} lost" if missed else "")
            try:
                end_manifest(self._folder, self._manifest, store.count, checksums)
            except OSError as error:
                context.report_lost(f"recording {self._folder}: not completed: {error.strerror}")
            context.emit("notice", text=text)


def main(context: Context) -> None:
    """Runs the stage until it is stopped."""
    folder = Path(context.options.record)
    try:
        recorder = Recorder(context, folder)
    except OSError as error:
        context.ready()
        _give_up(context, f"recording {folder}: {error.strerror}; nothing is recorded")
        context.ack_config()
        while context.wait():
            context.ack_config()
        return
    context.ready()
    context.ack_config()
    try:
        while recorder.wait():
            recorder.take()
            context.ack_config()
            recorder.report()
    finally:
        recorder.end()


def _give_up(context: Context, why: str) -> None:
    context.report_lost(why)
    context.request("record", path="")
