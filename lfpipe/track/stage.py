"""Track: the viewer's eyes in every frame.

Reads: ring "frames", the newest.
Writes: ring "eyes", one record per frame taken, with or without a face.
Commands: recentre (chooses the face anew), stop; filter settings by configuration; frames to leave out by option "level".
Emits: engine (name and model), face (found or lost), notice (faces that do not stand upright).
"""

from __future__ import annotations

import time

import numpy as np

from lfpipe.config.quality import tracked_every
from lfpipe.track.engines import make_engine
from lfpipe.track.eye_distance import EyeDistance
from lfpipe.track.filters import make_filter
from lfpipe.track.selector import same_place
from lfpipe.track.smoothing import MAX_STEP_NS
from lfpipe.transport.clock import now_ns
from lfpipe.transport.context import Context


def main(context: Context) -> None:
    """Runs the stage until the stop."""
    settings = context.config.track
    engine, smooth = make_engine(settings, portable=context.options.replay is not None), make_filter(settings)
    frames, eyes = context.input("frames"), context.output("eyes")
    raw = position = np.zeros((2, 2))
    velocity = np.zeros((2, 2))
    apart = EyeDistance()
    epoch, generation, seen = -1, 0, False
    box, t_seen_ns, hinted = (0.0, 0.0, 0.0, 0.0), 0, 0
    context.emit("engine", name=engine.name, model=engine.model)
    context.ready()
    try:
        while context.wait():
            if context.config.track != settings:
                settings = context.config.track
                smooth = make_filter(settings)
            context.ack_config()
            if any(word == "recentre" for word, _ in context.commands()):
                engine.reset()
                seen = False
            peeked = frames.peek()
            if peeked is None:
                continue
            t_taken_ns = now_ns()
            stamp, image = peeked
            if stamp.source_seq % tracked_every(context.options):
                context.row["left_out"] += 1  # at a lowered quality; nothing is measured, so nothing is published
                context.row["source_seq"] = stamp.source_seq
                continue
            face = engine.detect(image)
            if not frames.still_valid(stamp):
                continue  # the writer has lapped us: what was seen may be half of another frame
            if face is not None:
                away_ns = stamp.t_sensor_ns - t_seen_ns
                if stamp.epoch != epoch or away_ns >= MAX_STEP_NS or not same_place(box, face.box_px):
                    epoch, generation = stamp.epoch, generation + 1  # another run: nothing before it says anything about it
                    smooth.reset()
                    apart.reset()
                apart.update(stamp.t_sensor_ns, face)
                raw, box, t_seen_ns = face.eyes_px, face.box_px, stamp.t_sensor_ns
                position, velocity = smooth.update(stamp.t_sensor_ns, raw)
            else:
                velocity = np.zeros((2, 2))  # hold: nothing says where the eyes went
                if settings.filter == "mean":
                    smooth.reset()  # the average may not mix what is before a loss with what is after it
            if (face is not None) != seen:
                seen = not seen
                context.emit("face", found=seen, source_seq=stamp.source_seq)
            record = eyes.begin()
            record["raw_px"], record["filtered_px"], record["velocity_px_s"] = raw, position, velocity
            record["apart_px"] = face.apart_px if face is not None else 0.0
            record["turn_deg"] = face.turn_deg if face is not None else (0.0, 0.0, 0.0)
            record["confidence"] = face.confidence if face is not None else 0.0
            record["width_px"], record["height_px"] = image.shape[1], image.shape[0]
            record["face"], record["generation"], record["eyes_mm"] = seen, generation, apart.mm
            t_tracked_ns = now_ns()
            record["t_tracked_ns"] = t_tracked_ns
            eyes.publish(stamp.source_seq, stamp.t_sensor_ns, stamp.t_read_ns, stamp.epoch, stamp.kind)
            context.row.tick(stamp.source_seq)
            context.row.measure(t_taken_ns - stamp.t_publish_ns, t_tracked_ns - t_taken_ns, t_tracked_ns - stamp.t_sensor_ns)
            engine.examine(image)  # after the eyes are on their way
            if engine.rotated_deg != hinted and not seen:
                hinted = engine.rotated_deg
                upright = (context.config.camera.rotate + hinted) % 360
                context.emit("notice", text=f"a face stands in the picture, but not upright: camera.rotate={upright} turns it")
            context.row["face"], context.row["cpu_ns"] = seen, time.process_time_ns()
    finally:
        engine.close()
