"""Stage track: the viewer's eyes in every frame, or those of a mouse recording.

Reads: ring "frames", the newest.
Writes: ring "eyes", one record per processed frame, with or without a face.
Commands: recentre (chooses the face again), stop; filter settings by configuration; frame skipping
by option "level".
Emits: engine (name and model), face (found or lost), notice (faces that are not upright).
"""

import logging
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfpipe.config.quality import tracked_every
from lfpipe.config.session_options import RecordedEyes, device_latency_ms
from lfpipe.sequence.folder import open_sequence
from lfpipe.track.eye_tracker import EyeTracker
from lfpipe.transport.context import Context, RingOutput
from lfpipe.transport.ring import Stamp, now_ns


def main(context: Context) -> None:
    """Runs the stage until it is stopped."""
    match context.options.viewer:
        case RecordedEyes(folder=folder):
            _play(context, folder)
        case _:
            _track(context)


def _track(context: Context) -> None:
    is_replay = context.options.clock.output is not None
    tracker = EyeTracker(
        context.config.track,
        is_replay,
        _device_latency_s(context),
    )
    engine = tracker.engine
    hinted = 0
    frames = context.input("frames")
    eyes = context.output("eyes")
    every = 1
    context.emit("engine", name=engine.name, model=engine.model)
    context.ready()
    try:
        while context.wait():
            if context.news:
                tracker.set(context.config.track, _device_latency_s(context))
                every = tracked_every(context.options)
                context.ack_config()
                for word, message in context.commands():
                    if word == "recentre":
                        tracker.reset()
                        context.answer(message)
            peeked = frames.peek()
            if peeked is None:
                continue
            t_taken_ns = now_ns()
            stamp, image = peeked
            if stamp.source_seq % every:
                # at a lowered quality, nothing is measured or published
                context.row["left_out"] += 1
                context.row["source_seq"] = stamp.source_seq
                continue
            face = engine.detect(image)
            if not frames.still_valid(stamp):
                continue  # the writer overtook this reader: the picture may mix two frames
            if tracker.update(face, stamp.t_sensor_ns, stamp.epoch):
                logging.getLogger(__name__).info(
                    "face %s at frame %d", "found" if tracker.has_face else "lost", stamp.source_seq
                )
                context.row["face"] = tracker.has_face  # before the event, which wakes its readers
                context.emit("face", found=tracker.has_face, source_seq=stamp.source_seq)
            record = eyes.begin()
            tracker.write(record, image)
            _publish(context, eyes, stamp, record, t_taken_ns)
            engine.examine(image)  # after the eyes are published
            if engine.rotated_deg != hinted and not tracker.has_face:
                hinted = engine.rotated_deg
                upright = (context.config.camera.rotate + hinted) % 360
                context.notify(f"a face is visible, but not upright: set camera.rotate={upright}")
            context.row["face"] = tracker.has_face
            context.row.report_health(tracker.fault, tracker.has_face)
            context.row["cpu_ns"] = time.process_time_ns()
    finally:
        engine.close()


def _play(context: Context, folder: str) -> None:
    """Publishes the eyes of a mouse recording, in place of frames."""
    sequence = open_sequence(Path(folder), verify=False)
    frames = context.input("frames")
    eyes = context.output("eyes")
    context.emit("engine", name="recording", model=folder)
    context.ready()
    while context.wait():
        context.ack_config()
        for word, message in context.commands():
            if word == "recentre":
                context.answer(message)  # a recording cannot choose another face
        if (peeked := frames.peek()) is not None:
            t_taken_ns = now_ns()
            record = eyes.begin()
            record[...] = sequence.eyes(peeked[0].source_seq % len(sequence.packets))
            _publish(context, eyes, peeked[0], record, t_taken_ns)
            context.row["face"] = int(record["face"])
            context.row["cpu_ns"] = time.process_time_ns()


def _publish(
    context: Context, eyes: RingOutput, stamp: Stamp, record: NDArray[np.void], t_taken_ns: int
) -> None:
    t_tracked_ns = now_ns()
    record["t_tracked_ns"] = t_tracked_ns
    eyes.publish(stamp.source_seq, stamp.t_sensor_ns, stamp.t_read_ns, stamp.epoch, stamp.kind)
    context.row.count_output(stamp.source_seq)
    context.row.record_latency(
        t_taken_ns - stamp.t_publish_ns, t_tracked_ns - t_taken_ns, t_tracked_ns - stamp.t_sensor_ns
    )


def _device_latency_s(context: Context) -> float:
    """The delay of camera and display; 0 if pictures depend on the frames alone."""
    return device_latency_ms(context.options.clock, context.config.render.device_latency_ms) / 1e3
