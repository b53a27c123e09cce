"""Eyes, shown pictures and markers as streams of the Lab Streaming Layer, with the sensor's time on LSL's clock.

    NAME-eyes      15 x double64, one sample a frame; NaN without a face
    NAME-pictures   5 x double64, one sample per picture shown, at the time it was presented
    NAME-markers    1 x string, "face found" and "face lost"

All have an irregular rate, so that no reader smooths their stamps; the description holds the camera's rate.
"""

import math
import threading
from typing import Any

from lfpipe.host.native_stderr import quiet_stderr
from lfpipe.host.processes import yield_to_others
from lfpipe.share.output import Sample, Shown
from lfpipe.share.target import Target
from lfpipe.transport.clock import now_ns

EYES = [(f"{eye}_{axis}", "mm") for eye in ("left", "right", "head") for axis in "xyz"]
EYES += [("yaw", "degrees"), ("pitch", "degrees"), ("roll", "degrees"), ("face", "bool"), ("source_seq", "count")]
EYES += [("t_sensor", "s")]
PICTURES = [("source_seq", "count"), *((f"{eye}_{axis}", "views") for eye in ("left", "right") for axis in ("row", "col"))]
BUFFER_S = 30  # a receiver further behind loses the oldest samples
TRIES = 50  # pairs of readings of both clocks; the closest pair counts


def clock_offset_s() -> tuple[float, float]:
    """(LSL's clock minus CLOCK_MONOTONIC, its uncertainty) in s: the tightest of TRIES readings."""
    from pylsl import local_clock

    best = (0.0, math.inf)
    for _ in range(TRIES):
        before_ns, lsl_s, after_ns = now_ns(), local_clock(), now_ns()
        if (after_ns - before_ns) / 2e9 < best[1]:
            best = lsl_s - (before_ns + (after_ns - before_ns) // 2) / 1e9, (after_ns - before_ns) / 2e9
    return best


class LslOutput:
    """The streams of one target. pictures: whether the session shows any. rate_hz: the camera's."""

    def __init__(self, target: Target, session: str, rate_hz: float, pictures: bool) -> None:
        self._offset_s, self._error_s = clock_offset_s()
        self._face: bool | None = None
        self._outlets: dict[str, Any] = {}
        parts = ("eyes", "pictures", "markers") if pictures else ("eyes", "markers")

        def make() -> None:
            yield_to_others()  # liblsl's threads inherit it: many receivers do not delay a picture
            with quiet_stderr():  # liblsl prints a greeting
                for part in parts:
                    self._outlets[part] = self._outlet(target, part, session, rate_hz)

        maker = threading.Thread(target=make, name="lsl")
        maker.start()
        maker.join()
        if len(self._outlets) != len(parts):
            raise OSError(0, "liblsl opened no stream")

    def _outlet(self, target: Target, part: str, session: str, rate_hz: float) -> Any:
        import pylsl

        channels = {"eyes": EYES, "pictures": PICTURES, "markers": [("marker", "")]}[part]
        content = {"eyes": "Gaze", "pictures": "Pictures", "markers": "Markers"}[part]
        kind = pylsl.cf_string if part == "markers" else pylsl.cf_double64
        name = f"{target.name}-{part}"
        info = pylsl.StreamInfo(name, content, len(channels), pylsl.IRREGULAR_RATE, kind, f"lfpipe-{session}-{name}")
        description = info.desc()
        listed = description.append_child("channels")
        for label, unit in channels:
            listed.append_child("channel").append_child_value("label", label).append_child_value("unit", unit)
        clock = description.append_child("clock")
        clock.append_child_value("source", "CLOCK_MONOTONIC").append_child_value("offset_s", f"{self._offset_s:.9f}")
        clock.append_child_value("uncertainty_s", f"{self._error_s:.9f}")
        about = description.append_child("acquisition")
        about.append_child_value("camera_rate_hz", f"{rate_hz:g}").append_child_value("predicted_rate_hz", f"{target.rate_hz:g}")
        about.append_child_value("axes", "mm from the middle of the picture: x to the viewer's right, y up, z to the viewer")
        return pylsl.StreamOutlet(info, max_buffered=BUFFER_S)

    def _lsl_s(self, t_ns: int) -> float:
        return t_ns / 1e9 + self._offset_s

    def send(self, sample: Sample) -> bool:
        """See `Output.send`. Markers have the time of the first or last frame with the face."""
        head, t_s = sample.head, self._lsl_s(sample.t_ns)
        values = [math.nan] * 12
        if head is not None:
            values = [*head.left_mm, *head.right_mm, *head.position_mm, head.yaw_deg, head.pitch_deg, head.roll_deg]
        self._outlets["eyes"].push_sample(
            [*values, float(head is not None), float(sample.source_seq), self._lsl_s(sample.t_sensor_ns)], t_s
        )
        if (head is not None) != self._face:
            if self._face is not None or head is not None:
                self._outlets["markers"].push_sample(["face found" if head is not None else "face lost"], t_s)
            self._face = head is not None
        return True

    def show(self, shown: Shown) -> None:
        """Sends one sample of NAME-pictures."""
        if (outlet := self._outlets.get("pictures")) is not None:
            values = [float(shown.source_seq), *shown.left, *shown.right]
            outlet.push_sample(values, self._lsl_s(shown.t_presented_ns))

    def close(self) -> None:
        self._outlets.clear()
