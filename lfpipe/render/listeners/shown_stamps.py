"""Stamps of presented pictures, for stages that request them."""

from collections.abc import Callable

from lfpipe.config import SessionOptions
from lfpipe.render.presenter import REPLACED, Listener, Presentation
from lfpipe.transport.ring_io import RingOutput


class ShownStamps(Listener):
    """Writes a record of dtype SHOWN for each presentation while a stage requests the ring."""

    def __init__(self, open_ring: Callable[[], RingOutput]) -> None:
        """open_ring: opens the ring "shown"; called when it is first needed."""
        self._open_ring = open_ring
        self._ring: RingOutput | None = None
        self._wanted = False

    def set_options(self, options: SessionOptions) -> None:
        self._wanted = "shown" in options.asked_for

    def presented(self, presentation: Presentation) -> None:
        if not self._wanted or presentation.by == REPLACED or presentation.eyes is None:
            return
        self._ring = self._ring or self._open_ring()
        record = self._ring.begin()
        record["t_presented_ns"] = presentation.t_presented_ns
        record["view"] = (presentation.viewpoints.left, presentation.viewpoints.right)
        record["composed"] = presentation.composed
        record["face"] = presentation.face
        stamp = presentation.eyes.stamp
        self._ring.publish(
            stamp.source_seq, stamp.t_sensor_ns, stamp.t_read_ns, stamp.epoch, stamp.kind
        )
