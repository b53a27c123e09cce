"""What is sent for each frame and picture, and outputs by UDP: opentrack's layout, and OSC bundles.

UDP waits for no receiver: an absent one misses datagrams.
"""

import socket
import struct
import time
from collections.abc import Callable
from typing import Protocol

import attrs

from lfpipe.share.head import Head
from lfpipe.share.target import Target
from lfpipe.transport.clock import now_ns

POSE = struct.Struct("<6d")  # x, y, z in cm; yaw, pitch, roll in degrees
MM_PER_CM = 10.0
NTP_EPOCH_S = 2_208_988_800  # from 1900 to 1970 (RFC 5905)


@attrs.frozen
class Sample:
    """Eyes at one moment. t_ns: the sensor's stamp or, for predicted eyes, the time of sending. head: None without a face.
    confidence: of the face, 0..1; 0 without one."""

    source_seq: int
    t_sensor_ns: int
    t_ns: int
    head: Head | None
    confidence: float = 0.0


@attrs.frozen
class Shown:
    """A shown picture: its time of presentation, and the viewpoint (row, col) of each eye."""

    source_seq: int
    t_presented_ns: int
    left: tuple[float, float]
    right: tuple[float, float]


class Output(Protocol):
    """The output to one target. Never waits for a receiver."""

    def send(self, sample: Sample) -> bool:
        """Sends a sample; False if the system did not accept it."""
        ...

    def show(self, shown: Shown) -> None:
        """Sends the stamp of a picture if the protocol has a field for it."""
        ...

    def close(self) -> None: ...


def opentrack_datagram(sample: Sample) -> bytes:
    """opentrack's input "UDP over network", on opentrack's axes: x to the viewer's left, y up, z away from the screen in cm; yaw
    to the right, pitch up, roll to the left shoulder in degrees. Empty without a face: opentrack then holds the last pose."""
    head = sample.head
    if head is None:
        return b""
    x, y, z = (value / MM_PER_CM for value in head.position_mm)
    return POSE.pack(-x, y, z, head.yaw_deg, head.pitch_deg, -head.roll_deg)


def time_tag(t_ns: int) -> int:
    """The OSC time tag of a time of CLOCK_MONOTONIC: NTP seconds in the upper 32 bits, their fraction in the lower."""
    unix_ns = t_ns + time.time_ns() - now_ns()  # the wall clock may be set while a session runs
    return (unix_ns + NTP_EPOCH_S * 1_000_000_000 << 32) // 1_000_000_000


def osc_datagram(sample: Sample) -> bytes:
    """One bundle a frame, its time tag that of the eyes: /lfpipe/frame always, /lfpipe/eyes and /lfpipe/head with a face."""
    from pythonosc.osc_message_builder import OscMessageBuilder

    head = sample.head
    frame = OscMessageBuilder("/lfpipe/frame")
    frame.add_arg(int(head is not None), "i")
    frame.add_arg(sample.source_seq, "h")
    frame.add_arg(sample.t_ns, "h")
    messages = [frame]
    if head is not None:
        eyes, pose = OscMessageBuilder("/lfpipe/eyes"), OscMessageBuilder("/lfpipe/head")
        for value in (*head.left_mm, *head.right_mm):
            eyes.add_arg(value, "f")
        for value in (*head.position_mm, head.yaw_deg, head.pitch_deg, head.roll_deg):
            pose.add_arg(value, "f")
        messages += [eyes, pose]
    # python-osc's own bundle builder rounds the tag to 0.2 us through a float
    datagrams = [message.build().dgram for message in messages]
    return b"#bundle\0" + struct.pack(">Q", time_tag(sample.t_ns)) + b"".join(struct.pack(">i", len(d)) + d for d in datagrams)


ENCODERS: dict[str, Callable[[Sample], bytes]] = {"opentrack": opentrack_datagram, "osc": osc_datagram}


class UdpOutput:
    """Datagrams to a target of kind opentrack or osc."""

    def __init__(self, target: Target) -> None:
        self._encode = ENCODERS[target.kind]
        addresses = socket.getaddrinfo(target.host, target.port, type=socket.SOCK_DGRAM, flags=socket.AI_NUMERICHOST)
        family, kind, _, _, address = addresses[0]
        self._address = tuple(address)
        self._socket = socket.socket(family, kind)
        self._socket.setblocking(False)

    def send(self, sample: Sample) -> bool:
        """See `Output.send`."""
        data = self._encode(sample)
        try:
            return not data or self._socket.sendto(data, self._address) == len(data)
        except OSError:  # no buffer or no route: the next one is newer anyway
            return False

    def show(self, shown: Shown) -> None:
        """Does nothing: neither protocol has pictures."""

    def close(self) -> None:
        self._socket.close()
