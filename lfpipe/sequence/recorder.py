"""Records what a stage publishes, frames or the eyes of the mouse, in a thread of its own, so that
a slow disk delays no picture: what does not fit the queue is counted as missed.
"""

import math
import queue
import threading
from pathlib import Path

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError, redacted
from lfpipe.host.files import exists
from lfpipe.host.worker import versions, yield_to_others
from lfpipe.sequence.folder import MANIFEST, SequenceWriter, make_out, remove_empty
from lfpipe.sequence.packets import encoded
from lfpipe.transport.context import Context
from lfpipe.transport.control import Message
from lfpipe.transport.ring import MS_NS, now_ns

# of frames to encode: some seconds, so that a slow disk loses no frame
BUFFER_BYTES = 128 << 20
MIN_FRAMES = 8  # in that buffer, however large they are
FULL_NS = 5 * MS_NS  # between checks of a full buffer


@attrs.frozen(kw_only=True)
class Recordable:
    """A frame, or eyes in its place."""

    source_seq: int
    epoch: int
    t_sensor_ns: int
    t_read_ns: int
    data: NDArray[np.uint8] | bytes
    """A picture, or a packet."""
    codec: str = ""
    """Of a packet."""


class Recording:
    """A recording under way. Packets are stored unchanged, pictures as JPEG. Raises OSError,
    UserError if nothing can be written.
    """

    def __init__(self, context: Context, folder: Path, size_px: tuple[int, int]) -> None:
        viewer, config = context.options.viewer, context.config
        camera = attrs.evolve(config.camera, source=redacted(config.camera.source))
        if not exists(folder / MANIFEST) and not (exists(folder) and not any(folder.iterdir())):
            make_out(folder)  # unless a killed stage made it
        self.folder = folder
        self.writer = SequenceWriter(
            folder,
            redacted(viewer.source),
            size_px,
            viewer.rate_hz or config.render.nominal_hz,
            versions=versions(),
            config=attrs.asdict(attrs.evolve(config, camera=camera)),
        )
        self.missed = 0
        self.failure = ""
        """Why storing ended; "" if it has not."""
        self.reported = False
        self.counted = self.writer.count  # frames that the status row has; not 0 if it goes on
        self._last_ns = 0
        self._max_frames = max(MIN_FRAMES, BUFFER_BYTES // (3 * math.prod(size_px)))
        self._queue = queue.SimpleQueue[Recordable | None]()
        self.thread = threading.Thread(target=self._run, name="recorder")
        self.thread.start()

    @property
    def full(self) -> bool:
        return self._queue.qsize() >= self._max_frames

    def add(self, frame: Recordable) -> bool:
        """Whether a frame is stored: not if it repeats the stamp of the one before, which could not
        be replayed, and not without space.
        """
        if self.full or self.failure or frame.t_sensor_ns <= self._last_ns:
            self.missed += 1
            return False
        self._last_ns = frame.t_sensor_ns
        self._queue.put(frame)
        return True

    def end(self) -> None:
        """Lets the thread store the rest and complete the sequence."""
        self._queue.put(None)

    def _run(self) -> None:
        # Yields to threads that wake up for a live picture. A lower priority would be wrong:
        # preempted while it holds the GIL, this thread would block the other one.
        yield_to_others()
        while (frame := self._queue.get()) is not None:
            if not self.failure:
                self.failure = self._tried(frame)
        try:
            self.writer.complete()
        except OSError as error:
            self.failure = self.failure or f"not completed: {error.strerror}"
        if not self.writer.count:
            remove_empty(self.folder)

    def _tried(self, frame: Recordable) -> str:
        """Stores a frame; returns why it failed, or ""."""
        codec, data = frame.codec, frame.data
        try:
            if not isinstance(data, bytes):
                codec, data = "jpeg", encoded(data, "jpeg")
            self.writer.append(
                data, codec, frame.source_seq, frame.epoch, frame.t_sensor_ns, frame.t_read_ns
            )
        except Exception as error:  # the session continues without the recording
            text = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
            return str(text).rstrip(": ")
        return ""


class Recorder:
    """The recordings of a stage: one that option "record" names at its start, and those of the
    command "record". size_px: (width, height) of the frames. The row of the stage has
    `lfpipe.sequence.metrics.RECORDING`.
    """

    def __init__(self, context: Context, size_px: tuple[int, int]) -> None:
        self._context = context
        self._size_px = size_px
        self._recording: Recording | None = None
        self._is_ending = False
        if context.options.record:
            try:
                self._begin(Path(context.options.record))
            except UserError as error:
                self._give_up(f"recording {error.message}; nothing is recorded")

    @property
    def active(self) -> bool:
        """Whether it takes frames."""
        return self._recording is not None and not self._is_ending

    def handle(self, message: Message) -> None:
        """Executes a command: `path` begins a recording, "" ends it."""
        try:
            if message["path"]:
                self._begin(Path(message["path"]))
            else:
                self._end()
            self._context.answer(message)
        except UserError as error:
            self._context.answer(message, error)

    def _begin(self, folder: Path) -> None:
        if self._recording is not None:
            raise UserError(
                f"{self._recording.folder}: the recording is still being written",
                "try again in a few seconds",
            )
        try:
            self._recording = Recording(self._context, folder, self._size_px)
        except OSError as error:
            raise UserError(f"{folder}: {error.strerror}", "use another folder") from None

    def _end(self) -> None:
        if self._recording is not None and not self._is_ending:
            self._is_ending = True
            self._recording.end()

    def add(self, frame: Recordable, wait: bool = False) -> None:
        """Stores a frame; call it while `active`. wait: for space, in a session in which no time
        passes.
        """
        recording = self._recording
        assert recording is not None
        while wait and recording.full and not recording.failure:
            with self._context.busy_with("waiting for the disk"):
                if not self._context.wait(now_ns() + FULL_NS):
                    break
        self._context.row["unrecorded"] += not recording.add(frame)
        self.report()

    def report(self) -> None:
        """Counts what was stored; reports the end of a recording, or why it failed."""
        context, recording = self._context, self._recording
        if recording is None:
            return
        ended = not recording.thread.is_alive()  # before the count is read
        count = recording.writer.count
        context.row["recorded"] += count - recording.counted
        recording.counted = count
        if recording.failure and not recording.reported:
            recording.reported = True
            self._give_up(
                f"recording {recording.folder}: {recording.failure}; frames stored: {count}"
            )
            self._end()
        if ended:
            self._recording, self._is_ending = None, False
            missed = f"; {recording.missed} more were not stored" if recording.missed else ""
            what = f"recorded {count} frames to {recording.folder}{missed}"
            context.notify(what if count else "nothing recorded: stopped before the first frame")

    def _give_up(self, why: str) -> None:
        self._context.report_lost(why)
        self._context.request("record", path="")

    def close(self) -> None:
        """Stores the rest, and completes the sequence."""
        if self._recording is None:
            return
        with self._context.saving("writing the recording"):
            self._end()
            self._recording.thread.join()
            self.report()
