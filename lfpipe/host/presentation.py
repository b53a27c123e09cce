"""Reports of a window system about a picture on its screen."""

from typing import Protocol

import attrs


@attrs.frozen
class Presented:
    """serial: number of the picture. t_ns: the vertical blank that shows it (CLOCK_MONOTONIC), 0 if it was never shown.
    period_ns: of the screen, 0 if unknown."""

    serial: int
    t_ns: int
    period_ns: int


class Presentation(Protocol):
    """Reports the blanks that show pictures."""

    @property
    def name(self) -> str:
        """The protocol: wp_presentation, wl_surface.frame or x_present."""
        ...

    def expect(self, serial: int) -> None:
        """Call before picture number serial is handed over."""
        ...

    def handed_over(self, serial: int) -> None:
        """Call after picture number serial was handed over."""
        ...

    def take(self) -> list[Presented]:
        """The reports since the last call."""
        ...

    def close(self) -> None:
        """Call before the window closes."""
        ...
