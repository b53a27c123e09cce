"""Stage record: writes every frame, and optionally its tracked eyes, to a folder on disk.

Reads: ring "frames", every slot in order; the ring of option "packets", the source's JPEGs if it delivers them; ring
"eyes", in order if option "record_eyes" is set.
Writes: the sequence in the folder of option "record"; it ends when the option changes.
Commands: stop. Asks: record (to end the recording, if writing fails).
Emits: notice (end of a recording, lost frames).
"""

import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from lfpipe.config import to_dict
from lfpipe.eyes import EYES as EYES_TYPE
from lfpipe.host.files import exists
from lfpipe.host.machine import versions
from lfpipe.record.frame_reader import FrameReader
from lfpipe.record.store import Store
from lfpipe.sequence.folder import MANIFEST, begin_manifest, end_manifest
from lfpipe.transport.context import Context
from lfpipe.transport.ring_ends import RingInput


class Recorder:
    """The main thread's part: reads frames and eyes, updates the status row, reports errors."""

    def __init__(self, context: Context, folder: Path) -> None:
        """Raises OSError if nothing can be written."""
        self._context, self._folder = context, folder
        anew = not exists(folder / MANIFEST)
        self._lost_before = int(context.row["drops"]) if anew else 0
        self._frames, self._eyes = FrameReader(context), context.input("eyes")
        self._record = np.empty((), EYES_TYPE)
        self._first: tuple[int, int] | None = None  # (epoch, source_seq) of the first recorded frame
        self._told = self._slow = False
        options, frames = context.options, self._frames
        more = {"versions": versions(), "config": to_dict(context.config)}
        self._manifest = begin_manifest(folder, options.source, frames.width_px, frames.height_px, options.source_hz, **more)
        self._store = Store(folder, self._frames.shape, options.record_eyes)
        if anew:
            self._frames.skip()
            self._eyes.skip()

    def wait(self) -> bool:
        """Waits for frames, or for room to store them. False once the recording must end."""
        store, context = self._store, self._context
        if store.full:
            with store.room_fd() as fd:
                context.wait(instead_fd=fd)
        else:
            context.wait()
        return not context.stopping and context.options.record == str(self._folder)

    def take(self) -> None:
        """Passes new frames and eyes to the store, as far as it has room."""
        store = self._store
        while not store.full and (taken := self._frames.take(store.spare)) is not None:
            store.put(*taken)
            self._first = self._first or (taken[0].epoch, taken[0].source_seq)
        if not store.full:
            self._take_eyes(self._eyes)

    def _take_eyes(self, source: RingInput) -> None:
        """Reads eyes even if they are not recorded, so that no writer waits. Eyes of frames before the first one are left out."""
        while (stamp := source.take(self._record, in_order=True)) is not None:
            if self._first is not None and (stamp.epoch, stamp.source_seq) >= self._first:
                line: dict[str, Any] = {"source_seq": stamp.source_seq, "epoch": stamp.epoch, "t_sensor_ns": stamp.t_sensor_ns}
                line |= {name: self._record[name].tolist() for name in EYES_TYPE.names or ()}
                self._store.put_eyes(json.dumps(line).encode() + b"\n")

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
        if store.failure and not self._told:
            self._told = True
            ends = f"its last frame is {store.count - 1}" if store.count else "no frame was recorded"
            context.report_lost(f"recording {self._folder}: {store.failure}; {ends}")
            context.request("record", path="")

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
        _refused(context, folder, error)
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


def _refused(context: Context, folder: Path, error: OSError) -> None:
    """Handles a failure at the start: reports it, requests the end of the recording, and waits for it."""
    context.ready()
    context.report_lost(f"recording {folder}: {error.strerror}; nothing is recorded")
    context.request("record", path="")
    context.ack_config()
    while context.wait():
        context.ack_config()
