"""Eyes as datagrams: opentrack's layout, and OSC bundles. UDP waits for no receiver: an absent one misses them."""

import socket
import struct
from collections.abc import Callable

from lfpipe.share.output import Sample, Shown
from lfpipe.share.target import Target

POSE = struct.Struct("<6d")  # x, y, z in cm; yaw, pitch, roll in degrees
MM_PER_CM = 10.0

Encoder = Callable[[Sample], bytes]


def opentrack_datagram(sample: Sample) -> bytes:
    """opentrack's input "UDP over network": x right, y up, z away from the screen in cm; yaw right, pitch up, roll right in
    degrees. Empty without a face: opentrack then holds the last pose."""
    head = sample.head
    if head is None:
        return b""
    x, y, z = (value / MM_PER_CM for value in head.position_mm)
    return POSE.pack(x, y, z, head.yaw_deg, head.pitch_deg, head.roll_deg)


def osc_datagram(sample: Sample) -> bytes:
    """One bundle a frame: /lfpipe/frame always, /lfpipe/eyes and /lfpipe/head with a face."""
    from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
    from pythonosc.osc_message_builder import OscMessageBuilder

    bundle = OscBundleBuilder(IMMEDIATELY)
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
    for message in messages:
        bundle.add_content(message.build())
    return bytes(bundle.build().dgram)


ENCODERS: dict[str, Encoder] = {"opentrack": opentrack_datagram, "osc": osc_datagram}


class UdpOutput:
    """Datagrams to a target of kind opentrack or osc."""

    def __init__(self, target: Target) -> None:
        self._encode = ENCODERS[target.kind]
        found = socket.getaddrinfo(target.host, target.port, type=socket.SOCK_DGRAM, flags=socket.AI_NUMERICHOST)
        family, kind, _, _, address = found[0]
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
