"""Eyes, shown pictures and markers as streams of the Lab Streaming Layer, with the sensor's time on LSL's clock.

    NAME-eyes      16 x double64, one sample a frame; NaN without a face
    NAME-pictures   5 x double64, one sample per picture shown, at the time it was presented
    NAME-markers    1 x string, "face found" and "face lost"; "face" or "no face" every second, for a recorder that joins late

All have an irregular rate, so that no reader smooths their stamps; the description holds the camera's rate. Channels are
described as XDF recommends for streams of type Gaze (github.com/sccn/xdf/wiki/Gaze-Meta-Data).
"""

import math
import socket
import threading
from typing import Any

import attrs

from lfpipe.host.processes import yield_to_others
from lfpipe.host.terminal import quiet_stderr
from lfpipe.share.output import Sample, Shown
from lfpipe.share.target import Target
from lfpipe.transport.clock import SECOND_NS, now_ns


@attrs.frozen
class Channel:
    """One channel of a stream. eye: left, right or both, "" if it is not of the viewer. type: in XDF's words where it has one."""

    label: str
    eye: str
    type: str
    unit: str


EYES = [Channel(f"{eye}_{axis}", eye, f"Position{axis.upper()}", "mm") for eye in ("left", "right") for axis in "xyz"]
EYES += [Channel(f"head_{axis}", "both", f"Head{axis.upper()}", "mm") for axis in "xyz"]
EYES += [Channel(angle, "both", f"Head{angle.title()}", "degrees") for angle in ("yaw", "pitch", "roll")]
EYES += [Channel("face", "both", "Validity", "normalized"), Channel("source_seq", "both", "FrameNumber", "count")]
EYES += [Channel("t_sensor", "both", "Timestamp", "seconds"), Channel("confidence", "both", "Confidence", "normalized")]
PICTURES = [Channel("source_seq", "both", "FrameNumber", "count")]
PICTURES += [
    Channel(f"{eye}_{axis}", eye, f"View{axis.title()}", "views") for eye in ("left", "right") for axis in ("row", "col")
]
MARKERS = [Channel("marker", "both", "Marker", "text")]
STREAMS = {"eyes": ("Gaze", EYES), "pictures": ("Pictures", PICTURES), "markers": ("Markers", MARKERS)}
BUFFER_S = 30  # a receiver further behind loses the oldest samples
TRIES = 50  # pairs of readings of both clocks; the closest pair counts
REPEAT_NS = SECOND_NS  # of the state on the stream of markers


def clock_offset_s() -> tuple[float, float]:
    """(LSL's clock minus CLOCK_MONOTONIC, its uncertainty) in s: the tightest of TRIES readings."""
    from pylsl import local_clock

    best = (0.0, math.inf)
    for _ in range(TRIES):
        before_ns, lsl_s, after_ns = now_ns(), local_clock(), now_ns()
        if (after_ns - before_ns) / 2e9 < best[1]:
            best = lsl_s - (before_ns + (after_ns - before_ns) // 2) / 1e9, (after_ns - before_ns) / 2e9
    return best


def source_id(session: str, stream: str) -> str:
    """The stream's identity. It names the machine: a receiver that loses a stream goes on with another of the same identity."""
    return f"lfpipe-{socket.gethostname()}-{session}-{stream}"


class LslOutput:
    """The streams of one target. pictures: whether the session shows any. rate_hz: the camera's."""

    def __init__(self, target: Target, session: str, rate_hz: float, pictures: bool) -> None:
        self._offset_s, self._error_s = clock_offset_s()
        self._face, self._marked_ns = False, 0
        self._outlets: dict[str, Any] = {}
        names = [name for name in STREAMS if pictures or name != "pictures"]

        def open_streams() -> None:
            yield_to_others()  # liblsl's threads inherit it: many receivers do not delay a picture
            with quiet_stderr():  # liblsl prints a greeting
                for name in names:
                    self._outlets[name] = self._outlet(target, name, session, rate_hz)

        opener = threading.Thread(target=open_streams, name="lsl")
        opener.start()
        opener.join()
        if len(self._outlets) != len(names):
            raise OSError(0, "liblsl opened no stream")

    def _outlet(self, target: Target, stream: str, session: str, rate_hz: float) -> Any:
        import pylsl

        content, channels = STREAMS[stream]
        kind = pylsl.cf_string if stream == "markers" else pylsl.cf_double64
        name = f"{target.name}-{stream}"
        info = pylsl.StreamInfo(name, content, len(channels), pylsl.IRREGULAR_RATE, kind, source_id(session, name))
        description = info.desc()
        listed = description.append_child("channels")
        for channel in channels:
            entry = listed.append_child("channel")
            for key, value in attrs.asdict(channel).items():
                entry.append_child_value(key, value)
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
        """See `Output.send`. Markers have the time of the sample."""
        head, t_s = sample.head, self._lsl_s(sample.t_ns)
        values = [math.nan] * 12
        if head is not None:
            values = [*head.left_mm, *head.right_mm, *head.position_mm, head.yaw_deg, head.pitch_deg, head.roll_deg]
        face = head is not None
        frame = [float(face), float(sample.source_seq), self._lsl_s(sample.t_sensor_ns), sample.confidence]
        self._outlets["eyes"].push_sample(values + frame, t_s)
        if face != self._face:
            self._mark("face found" if face else "face lost", sample.t_ns)
        elif sample.t_ns - self._marked_ns >= REPEAT_NS:
            self._mark("face" if face else "no face", sample.t_ns)
        self._face = face
        return True

    def _mark(self, marker: str, t_ns: int) -> None:
        self._marked_ns = t_ns
        self._outlets["markers"].push_sample([marker], self._lsl_s(t_ns))

    def show(self, shown: Shown) -> None:
        """Sends one sample of NAME-pictures."""
        if (outlet := self._outlets.get("pictures")) is not None:
            values = [float(shown.source_seq), *shown.left, *shown.right]
            outlet.push_sample(values, self._lsl_s(shown.t_presented_ns))

    def close(self) -> None:
        self._outlets.clear()
