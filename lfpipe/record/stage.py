"""Stage record: writes every frame to a folder on disk, or the eyes that the mouse makes.

Reads: ring "frames", every slot in order; the ring of option "packets", the source's JPEGs if it
delivers them; of a session of the mouse, ring "eyes" in place of frames.
Writes: the sequence in the folder of option "record"; it ends when the option changes.
Commands: stop. Asks: record (to end the recording, if writing fails).
Emits: notice (end of a recording, lost frames).
"""

import contextlib
import math
import time
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple, Protocol

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.config.modes import MouseViewer, RecordedEyes
from lfpipe.errors import UserError, redacted
from lfpipe.eyes import EYES
from lfpipe.host.files import exists
from lfpipe.host.machine import versions
from lfpipe.host.processes import yield_to_others
from lfpipe.sequence.eyes import eyes_line
from lfpipe.sequence.folder import MANIFEST, SequenceWriter, make_out, remove_empty
from lfpipe.sequence.packets import encoded
from lfpipe.transport.clock import MS_NS, SECOND_NS, now_ns
from lfpipe.transport.context import Context
from lfpipe.transport.packet_ring import PacketInput
from lfpipe.transport.ring import Stamp

FULL_NS = 5 * MS_NS  # between checks of a full store
# buffer of frames to encode: some seconds, so that a slow disk loses no frame
BUFFER_BYTES = 128 << 20
MIN_FRAMES = 8  # in that buffer, however large they are
SLOW_NS = SECOND_NS // 2  # a longer time per frame is reported


class Frame(NamedTuple):
    """What is stored of a frame."""

    stamp: Stamp
    codec: str
    """"" for a picture that is not encoded yet."""
    data: NDArray[np.uint8] | bytes


class FramesInOrder(Protocol):
    """Reads what the session records."""

    size_px: tuple[int, int]
    """(width, height) of its frames."""

    def skip(self) -> None:
        """Skips what was published until now without counting it as lost."""

    def take(self) -> Frame | None:
        """The next frame; None if there is none."""

    def close(self) -> None:
        """Ends reading."""


class FrameReader:
    """Reads the viewer's frames in order, as the source's own JPEGs if it delivers them. size_px:
    of the stored frames.
    """

    def __init__(self, context: Context, jpeg_px: tuple[int, int] | None) -> None:
        self._row = context.row
        self._frames = context.input("frames")
        self._ring_px = self.size_px = context.config.camera.frame_px
        self._packets: PacketInput | None = None
        self._begun = True
        if packets := context.options.packets:
            with contextlib.suppress(FileNotFoundError):  # stopped before it began
                self._packets = PacketInput(context.spec.session, packets)
                self.size_px = jpeg_px or (0, 0)

    def skip(self) -> None:
        """Skips frames published until now without counting them as lost.

        Frames before the first JPEG are skipped as well.
        """
        self._frames.skip()
        self._begun = False

    def take(self) -> Frame | None:
        """The next frame, as a JPEG or a picture; None if there is none."""
        while (peeked := self._frames.peek(in_order=True)) is not None:
            stamp, slot = peeked
            packet = self._packets.of(stamp) if self._packets else None
            if packet is not None:
                self._begun = True
                return Frame(stamp, "jpeg", packet)
            if self._packets is not None and self._packets.ended:
                # the recording is being stopped; capture has already stopped sending JPEGs
                return None
            if self._ring_px != self.size_px:
                self._row["drops"] += self._begun  # it is scaled, so it does not fit this recording
                continue
            picture = slot.copy()
            if self._frames.still_valid(stamp):
                return Frame(stamp, "", picture)
        return None

    def close(self) -> None:
        """Unmaps the packets."""
        if self._packets is not None:
            self._packets.close()


class EyesReader:
    """Reads the eyes that the mouse makes, in place of frames."""

    def __init__(self, context: Context) -> None:
        self._eyes = context.input("eyes")
        self._record = np.empty((), EYES)
        self.size_px = context.config.camera.frame_px

    def skip(self) -> None:
        """Skips eyes published until now without counting them as lost."""
        self._eyes.skip()

    def take(self) -> Frame | None:
        """The next eyes as a line of JSON; None if there are none."""
        stamp = self._eyes.take(self._record, in_order=True)
        if stamp is None:
            return None
        return Frame(stamp, "eyes", eyes_line(self._record, source_seq=stamp.source_seq))

    def close(self) -> None:
        """Nothing to do."""


class Store:
    """Writes frames in a thread of its own, so that a slow disk does not block reading the ring.

    Packets are stored unchanged. Pictures are stored as JPEG or, lossless, as PNG, or raw if more
    than a quarter of the buffer is in use. failure: the reason why storing ended; "" if it has not.
    """

    def __init__(self, writer: SequenceWriter, frame_bytes: int, lossless: bool) -> None:
        self._writer = writer
        self._lossless = lossless
        self._max_frames = max(MIN_FRAMES, BUFFER_BYTES // frame_bytes)
        # Yields to threads that wake up for a live picture. A lower priority would be wrong:
        # preempted while it holds the GIL, this thread would block the other one.
        self._thread = ThreadPoolExecutor(1, "store", yield_to_others)
        self._pending: deque[tuple[Stamp, int, Future[int]]] = deque()
        self._begun_ns = 0
        self._hurry = False
        self.failure = ""

    @property
    def full(self) -> bool:
        """Whether the buffer is full. `results` frees space."""
        return len(self._pending) >= self._max_frames

    @property
    def slow(self) -> bool:
        """Whether the disk has blocked the thread for at least SLOW_NS."""
        begun_ns = self._begun_ns
        return bool(begun_ns) and now_ns() - begun_ns > SLOW_NS

    def put(self, frame: Frame) -> None:
        """Adds a frame. Its time stamp is after that of the frame before."""
        self._hurry = len(self._pending) > self._max_frames // 4
        self._pending.append((frame.stamp, now_ns(), self._thread.submit(self._write, frame)))

    def results(self) -> Iterator[tuple[Stamp, int, int]]:
        """(stamp, t_taken_ns, t_stored_ns) of the frames that were stored since the last call."""
        while self._pending and self._pending[0][2].done():
            stamp, t_taken_ns, stored = self._pending.popleft()
            if t_stored_ns := stored.result():
                yield stamp, t_taken_ns, t_stored_ns

    def _write(self, frame: Frame) -> int:
        """When the frame was stored; 0 if it was not."""
        stamp, codec, data = frame
        if self.failure:
            return 0
        self._begun_ns = now_ns()
        try:
            if isinstance(data, bytes):
                packet = data
            else:
                lossless = "raw" if self._hurry else "png"
                codec = lossless if self._lossless else "jpeg"
                packet = encoded(data, codec)
            self._writer.append(
                packet, codec, stamp.source_seq, stamp.epoch, stamp.t_sensor_ns, stamp.t_read_ns
            )
        except OSError as error:
            self.failure = str(error.strerror or error)
        except Exception as error:  # the session continues without the recording
            self.failure = f"{type(error).__name__}: {error}".rstrip(": ")
        self._begun_ns = 0
        return 0 if self.failure else now_ns()

    def close(self) -> None:
        """Waits until everything is on disk.

        A lossless rest is not compressed, so that a session ends quickly.
        """
        self._hurry = True
        self._thread.shutdown()


class Recorder:
    """The main thread's part: reads frames or eyes, updates the status row, reports errors."""

    def __init__(self, context: Context, folder: Path) -> None:
        """Raises OSError, UserError if nothing can be written."""
        self._context = context
        self._folder = folder
        self._reported = self._slow = False
        self._last_ns = 0
        viewer = context.options.viewer
        camera = context.config.camera
        camera = attrs.evolve(camera, source=redacted(camera.source))
        config = attrs.evolve(context.config, camera=camera)
        if isinstance(viewer, MouseViewer | RecordedEyes):
            reader: FramesInOrder = EyesReader(context)
            unused = ["frames"] if isinstance(viewer, RecordedEyes) else []
        else:
            reader = FrameReader(context, viewer.jpeg_px)
            unused = ["eyes"]
        self._reader = reader
        self._unused = [context.input(name) for name in unused]
        anew = not exists(folder / MANIFEST)
        if anew and not (exists(folder) and not any(folder.iterdir())):
            make_out(folder)  # unless a killed one made it
        self._writer = SequenceWriter(
            folder,
            redacted(viewer.source),
            reader.size_px,
            viewer.rate_hz or config.render.nominal_hz,
            versions=versions(),
            config=attrs.asdict(config),
        )
        lossless = config.record.format == "lossless"
        self._store = Store(self._writer, 3 * math.prod(reader.size_px), lossless)
        self._lost_before = int(context.row["drops"]) if anew else 0
        if anew:
            reader.skip()

    def wait(self) -> bool:
        """Waits for frames, or for space to store them. False when the recording must end."""
        context = self._context
        full = self._store.full
        context.wait(now_ns() + FULL_NS if full else None, inputs=not full)
        return not context.stopping and context.options.record == str(self._folder)

    def take(self) -> None:
        """Passes new frames to the store while it has space."""
        for ring_input in self._unused:
            ring_input.skip()
        while not self._store.full and (frame := self._reader.take()) is not None:
            t_sensor_ns = frame.stamp.t_sensor_ns
            if t_sensor_ns > self._last_ns:
                self._last_ns = t_sensor_ns
                self._store.put(frame)
            else:  # a repeated stamp means a repeated frame, which could not be replayed
                self._context.row["drops"] += 1

    def report(self) -> None:
        """Updates the status row.

        After an error, reports it once and requests the end of the recording.
        """
        context = self._context
        for stamp, t_taken_ns, t_stored_ns in self._store.results():
            context.row.count_output(stamp.source_seq)
            context.row.record_latency(
                t_taken_ns - stamp.t_publish_ns,
                t_stored_ns - t_taken_ns,
                t_stored_ns - stamp.t_sensor_ns,
            )
        context.row["cpu_ns"] = time.process_time_ns()
        if self._store.slow != self._slow:
            self._slow = not self._slow
            context.row.set_busy("waiting for the disk" if self._slow else "")
        if self._store.failure and not self._reported:
            self._reported = True
            stored = f"frames stored: {self._writer.count}"
            _give_up(context, f"recording {self._folder}: {self._store.failure}; {stored}")

    def end(self) -> None:
        """Stores the rest from rings and memory, and completes the sequence."""
        context = self._context
        with context.saving("writing the recording"):
            self.take()
            self._store.close()
            self.report()
            missed = int(context.row["drops"]) - self._lost_before
            text = f"recorded {self._writer.count} frames to {self._folder}" + (
                f"; {missed} more were not stored" if missed else ""
            )
            self._reader.close()
            try:
                self._writer.complete()
            except OSError as error:
                context.report_lost(f"recording {self._folder}: not completed: {error.strerror}")
            if not self._writer.count:
                remove_empty(self._folder)
            context.notify(text)


def main(context: Context) -> None:
    """Runs the stage until it is stopped."""
    folder = Path(context.options.record)
    try:
        recorder = Recorder(context, folder)
    except (OSError, UserError) as error:
        context.ready()
        if isinstance(error, OSError):
            error = UserError(f"{folder}: {error.strerror}", "use another folder")
        if context.spec.request:
            context.request("record", path="")  # first: the client may ask again
            context.refuse({"number": context.spec.request}, error)
        else:
            _give_up(context, f"recording {error.message}; nothing is recorded")
        context.ack_config()
        while context.wait():
            context.ack_config()
        return
    context.ready()
    context.ack_config()
    if context.spec.request:
        context.answer({"number": context.spec.request})
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
