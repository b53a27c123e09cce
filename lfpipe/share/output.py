"""The protocol of outputs, and the data of each frame and each picture."""

from typing import Protocol

import attrs

from lfpipe.share.head import Head


@attrs.frozen
class Sample:
    """Eyes at one moment. t_ns: the sensor's stamp or, for predicted eyes, the time of sending. head: None without a face."""

    source_seq: int
    t_sensor_ns: int
    t_ns: int
    head: Head | None


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
