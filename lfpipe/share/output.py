"""What a target gets: the protocol of the outputs, and what is known of each frame and each picture."""

from __future__ import annotations

from typing import Protocol

import attrs

from lfpipe.share.head import Head


@attrs.frozen
class Sample:
    """Eyes at one moment. t_ns: the time they are of, the sensor's stamp or, predicted, the time of sending. head: None without a
    face."""

    source_seq: int
    t_sensor_ns: int
    t_ns: int
    head: Head | None


@attrs.frozen
class Shown:
    """A picture shown: when it was presented, and the viewpoint (row, col) of each eye."""

    source_seq: int
    t_presented_ns: int
    left: tuple[float, float]
    right: tuple[float, float]


class Output(Protocol):
    """One target's. Nothing here waits for a receiver."""

    def send(self, sample: Sample) -> bool:
        """Sends a sample; False where the system did not take it."""
        ...

    def show(self, shown: Shown) -> None:
        """Sends the stamp of a picture, where the target has a place for it."""
        ...

    def close(self) -> None: ...
