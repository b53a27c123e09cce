"""What is sent for each frame and picture, and how; no output waits for a receiver.

By UDP, an absent receiver misses datagrams: opentrack's layout, and OSC bundles. Streams of the Lab
Streaming Layer, with the sensor's time on LSL's clock:

    NAME-eyes      16 x double64, one sample a frame; NaN without a face
    NAME-pictures   5 x double64, one sample per picture shown, at the time it was presented
    NAME-markers    1 x string, "face found" and "face lost"; "face" or "no face" every second,
                    for a recorder that joins late

All have an irregular rate, so that no reader smooths their stamps; the description holds the
camera's rate. Channels are described as XDF recommends for streams of type Gaze
(github.com/sccn/xdf/wiki/Gaze-Meta-Data).
"""

import math
import socket
import struct
import time
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.extras.share.target import Target
from lfpipe.host.terminal import quiet_stderr
from lfpipe.track.eye_tracker import Head
from lfpipe.transport.ring import SECOND_NS, now_ns

MAX_INT = 2**31 - 1  # of OSC's type i: frame numbers wrap to 0
POSE = struct.Struct("<6d")  # x, y, z in cm; yaw, pitch, roll in degrees


@attrs.frozen
class Sample:
    """Eyes at one moment."""

    source_seq: int
    t_sensor_ns: int
    t_ns: int
    """The sensor's stamp or, for predicted eyes, the time of sending."""
    head: Head | None
    """None without a face."""
    confidence: float = 0.0
    """Of the face, 0..1; 0 without one."""


def opentrack_datagram(sample: Sample) -> bytes:
    """opentrack's input "UDP over network", on opentrack's axes: x to the viewer's left, y up, z
    away from the screen in cm; yaw to the right, pitch up, roll to the left shoulder in degrees.
    Empty without a face: opentrack then holds the last pose.
    """
    head = sample.head
    if head is None:
        return b""
    x, y, z = (value / 10.0 for value in head.position_mm)
    return POSE.pack(-x, y, z, head.yaw_deg, head.pitch_deg, -head.roll_deg)


def _numbers(head: Head) -> tuple[float, ...]:
    """The positions of both eyes and of the point between them, and yaw, pitch and roll."""
    angles = head.yaw_deg, head.pitch_deg, head.roll_deg
    return *head.left_mm, *head.right_mm, *head.position_mm, *angles


def osc_datagram(sample: Sample) -> bytes:
    """One bundle a frame, its time tag that of the eyes: /lfpipe/frame always, /lfpipe/eyes and
    /lfpipe/head with a face. Integers are of 32 bits: common receivers drop a message with 64.
    """
    from pythonosc.osc_bundle_builder import OscBundleBuilder
    from pythonosc.osc_message_builder import OscMessageBuilder

    head = sample.head
    messages: dict[str, list[tuple[str, float]]] = {
        "frame": [
            ("i", value)
            for value in (
                int(head is not None),
                sample.source_seq & MAX_INT,
                *divmod(sample.t_ns, SECOND_NS),
            )
        ]
    }
    if head is not None:
        numbers = [("f", value) for value in _numbers(head)]
        messages["eyes"] = numbers[:6]
        messages["head"] = numbers[6:]
    # the wall clock may be set while a session runs
    unix_s = (sample.t_ns + time.time_ns() - now_ns()) / 1e9
    bundle = OscBundleBuilder(unix_s)  # type: ignore[arg-type]  # it takes fractions
    for name, values in messages.items():
        message = OscMessageBuilder(f"/lfpipe/{name}")
        for kind, value in values:
            message.add_arg(value, kind)
        bundle.add_content(message.build())
    return bytes(bundle.build().dgram)


class UdpOutput:
    """Datagrams to a target of kind opentrack or osc."""

    def __init__(self, target: Target) -> None:
        self._encode = opentrack_datagram if target.kind == "opentrack" else osc_datagram
        (family, kind, _, _, address), *_ = socket.getaddrinfo(
            target.host, target.port, type=socket.SOCK_DGRAM, flags=socket.AI_NUMERICHOST
        )
        self._address: tuple[Any, ...] = tuple(address)
        self._socket = socket.socket(family, kind)
        self._socket.setblocking(False)

    def send(self, sample: Sample) -> bool:
        """Sends a sample; False if the system did not accept it."""
        data = self._encode(sample)
        try:
            return not data or self._socket.sendto(data, self._address) == len(data)
        except OSError:  # no buffer or no route: the next one is newer anyway
            return False

    def close(self) -> None:
        self._socket.close()


# of each channel: label, eye, type and unit
FRAME = ("source_seq", "both", "FrameNumber", "count")
EYES = [
    *((f"left_{axis}", "left", f"Position{axis.upper()}", "mm") for axis in "xyz"),
    *((f"right_{axis}", "right", f"Position{axis.upper()}", "mm") for axis in "xyz"),
    *((f"head_{axis}", "both", f"Head{axis.upper()}", "mm") for axis in "xyz"),
    *((angle, "both", f"Head{angle.title()}", "degrees") for angle in ("yaw", "pitch", "roll")),
    ("face", "both", "Validity", "normalized"),
    FRAME,
    ("t_sensor", "both", "Timestamp", "seconds"),
    ("confidence", "both", "Confidence", "normalized"),
]
PICTURES = [
    FRAME,
    *((f"left_{axis}", "left", f"View{axis.title()}", "views") for axis in ("row", "col")),
    *((f"right_{axis}", "right", f"View{axis.title()}", "views") for axis in ("row", "col")),
]
MARKERS = [("marker", "both", "Marker", "text")]
STREAMS = {
    "eyes": ("Gaze", EYES),
    "pictures": ("Pictures", PICTURES),
    "markers": ("Markers", MARKERS),
}
TRIES = 50  # pairs of readings of both clocks; the closest pair counts
REPEAT_NS = SECOND_NS  # of the state on the stream of markers


def clock_offset_s() -> float:
    """LSL's clock minus CLOCK_MONOTONIC in s, from the tightest of TRIES readings."""
    from pylsl import local_clock

    readings: list[tuple[int, float]] = []
    for _ in range(TRIES):
        before_ns = now_ns()
        lsl_s = local_clock()
        after_ns = now_ns()
        readings.append((after_ns - before_ns, lsl_s - (before_ns + after_ns) / 2e9))
    return min(readings)[1]


def source_id(run: str, stream: str) -> str:
    """The stream's identity: a receiver that loses a stream goes on with another of the same one.

    It names the machine and the run of the session, which a restart of the stage does not change.
    """
    return f"lfpipe-{socket.gethostname()}-{run}-{stream}"


def _append(parent: Any, name: str, **texts: str) -> None:
    """Adds an element to an XML description, with a child for each text."""
    element = parent.append_child(name)
    for key, value in texts.items():
        element.append_child_value(key, value)


class LslOutput:
    """The streams of one target. run: see `Session.run`. pictures: whether the session shows any.
    rate_hz: the camera's.
    """

    def __init__(self, target: Target, run: str, rate_hz: float, pictures: bool) -> None:
        self._offset_s = clock_offset_s()
        self._face = False
        self._marked_ns = 0
        with quiet_stderr():  # liblsl prints a greeting
            self._outlets = {
                name: self._outlet(target, name, run, rate_hz)
                for name in STREAMS
                if pictures or name != "pictures"
            }

    def _outlet(self, target: Target, stream: str, run: str, rate_hz: float) -> Any:
        import pylsl

        content, channels = STREAMS[stream]
        kind = pylsl.cf_string if stream == "markers" else pylsl.cf_double64
        name = f"{target.name}-{stream}"
        info = pylsl.StreamInfo(
            name, content, len(channels), pylsl.IRREGULAR_RATE, kind, source_id(run, name)
        )
        description = info.desc()
        listed = description.append_child("channels")
        for label, eye, form, unit in channels:
            # type in XDF's words where it has one
            _append(listed, "channel", label=label, eye=eye, type=form, unit=unit)
        _append(description, "clock", source="CLOCK_MONOTONIC", offset_s=f"{self._offset_s:.9f}")
        _append(
            description,
            "acquisition",
            camera_rate_hz=f"{rate_hz:g}",
            predicted_rate_hz=f"{target.rate_hz:g}",
            axes="mm from the middle of the picture: x to the viewer's right, y up, z to the"
            " viewer",
        )
        # in s: a receiver further behind loses the oldest samples
        return pylsl.StreamOutlet(info, max_buffered=30)

    def _lsl_s(self, t_ns: int) -> float:
        return t_ns / 1e9 + self._offset_s

    def send(self, sample: Sample) -> bool:
        """See `UdpOutput.send`. Markers have the time of the sample."""
        head = sample.head
        face = head is not None
        values = [math.nan] * 12 if head is None else list(_numbers(head))
        values += [
            float(face),
            float(sample.source_seq),
            self._lsl_s(sample.t_sensor_ns),
            sample.confidence,
        ]
        self._outlets["eyes"].push_sample(values, self._lsl_s(sample.t_ns))
        if face != self._face:
            self._mark("face found" if face else "face lost", sample.t_ns)
        elif sample.t_ns - self._marked_ns >= REPEAT_NS:
            self._mark("face" if face else "no face", sample.t_ns)
        self._face = face
        return True

    def _mark(self, marker: str, t_ns: int) -> None:
        self._marked_ns = t_ns
        self._outlets["markers"].push_sample([marker], self._lsl_s(t_ns))

    def show(self, source_seq: int, record: NDArray[np.void]) -> None:
        """Sends one sample of NAME-pictures, of a record of dtype SHOWN."""
        if outlet := self._outlets.get("pictures"):
            outlet.push_sample(
                [float(source_seq), *record["view"].ravel()],
                self._lsl_s(int(record["t_presented_ns"])),
            )

    def close(self) -> None:
        self._outlets.clear()
