"""The monitors that SDL lists, and the conditions under which the loop's delay was measured with
one of them.
"""

from __future__ import annotations

import attrs

from lfpipe.config import Camera, Config
from lfpipe.errors import UserError
from lfpipe.render.display import window_system
from lfpipe.render.display.window_system import pygame

# of the monitor for a first window: of its width, and at most of its height, since panels and title
# bars take some
WIDTH_SHARE = 2 / 3
HEIGHT_SHARE = 0.85
INCH_MM = 25.4  # by definition
# widths in EDIDs that know only an aspect: 160 x 90 mm, 16 x 10 mm, 1600 x 900 mm, ...
ASPECTS_MM = (16.0, 160.0, 1600.0)
NOMINAL_HZ = 60.0  # if a monitor does not report its rate
SQUARE = 0.1  # pixels further from square than this: the reported size is invented
PITCHES_MM = 0.05, 1.5  # of a telephone, and of a wall of LEDs


@attrs.frozen(kw_only=True)
class Monitor:
    """A monitor as its driver describes it."""

    number: int
    name: str
    x: int
    y: int
    width: int
    height: int
    """(x, y, width, height) is its area on the desktop, in the units of window positions."""
    pixel_mm: float | None
    """The pitch of its physical pixels, None if it reports no size or an impossible one."""
    rate_hz: float = NOMINAL_HZ
    """The refresh rate that it claims."""

    def window_for(self, size_px: tuple[int, int]) -> tuple[int, int]:
        """(width, height) of the first window for pictures of that size."""
        scale = min(WIDTH_SHARE * self.width / size_px[0], HEIGHT_SHARE * self.height / size_px[1])
        return max(1, round(size_px[0] * scale)), max(1, round(size_px[1] * scale))

    def __str__(self) -> str:
        size = f", {self.pixel_mm:.3f} mm a pixel" if self.pixel_mm else ""
        return f"{self.number} {self.name} {self.width}x{self.height}+{self.x}+{self.y}{size}"


def pixel_mm(dots_per_inch: tuple[float, float], width_px: int) -> float | None:
    """The pitch from the size that SDL reports, (horizontal, vertical); None if that cannot be the
    size of a monitor.
    """
    across, down = dots_per_inch
    low_mm, high_mm = PITCHES_MM
    if min(across, down) <= 0 or abs(across / down - 1) > SQUARE:
        return None
    width_mm = width_px * INCH_MM / across
    if any(abs(width_mm - aspect_mm) < 1 for aspect_mm in ASPECTS_MM):
        return None
    return width_mm / width_px if low_mm <= width_mm / width_px <= high_mm else None


def monitors() -> list[Monitor]:
    """All monitors, by number. pygame.display must be initialised."""
    facts = zip(
        pygame.display.get_desktop_sizes(),
        pygame.display.get_desktop_refresh_rates(),
        strict=True,
    )
    return [
        Monitor(
            number=number,
            name=name,
            x=x,
            y=y,
            width=width,
            height=height,
            pixel_mm=pixel_mm(dots_per_inch, width_px),
            rate_hz=float(rate_hz or NOMINAL_HZ),
        )
        for number, ((width_px, _), rate_hz) in enumerate(facts)
        for name, (x, y, width, height), dots_per_inch in [window_system.monitor_facts(number)]
    ]


def find_monitor(asked: str, offered: list[Monitor]) -> Monitor:
    """The monitor with that number or name, or the only one whose name contains it.

    Raises UserError, which lists them.
    """
    exact = [monitor for monitor in offered if asked in (str(monitor.number), monitor.name)]
    similar = [monitor for monitor in offered if asked.lower() in monitor.name.lower()]
    for matches in (exact, similar):
        if len(matches) == 1:
            return matches[0]
    what = "several monitors are called that" if similar else "no such monitor"
    raise UserError(
        f"screen.monitor {asked!r}: {what}",
        "use the number or part of the name of one of: " + "; ".join(map(str, offered)),
    )


def detect_monitors() -> tuple[str, list[Monitor]]:
    """SDL's driver and the monitors, without a window. Raises pygame.error if SDL cannot start."""
    try:
        return window_system.start(), monitors()
    finally:
        pygame.display.quit()


def device_latency_conditions(camera: str, asked: Camera, monitor: Monitor) -> str:
    """What a device latency holds for. camera: the driver's name. asked: its settings."""
    rate = "auto rate" if isinstance(asked.rate_hz, str) else f"{asked.rate_hz:g} Hz"
    mode = f"{asked.width_px}x{asked.height_px} {asked.format} {rate}"
    texts = (camera, mode, monitor.name, f"{monitor.rate_hz:g} Hz")
    return "; ".join(text.replace(";", ",") for text in texts)


def device_latency_doubt(config: Config, camera: str, monitors: list[Monitor]) -> str:
    """The reason to distrust render.device_latency_ms now; "" if there is none. camera: name of
    the camera in use. monitors: all connected ones; without screen.monitor the window may be on
    any of them.
    """
    then = config.render.device_latency_measured.partition("; ")[2]  # after its date
    if not then:
        return "it was set by hand, not measured" if config.render.device_latency_ms else ""
    asked = str(config.screen.monitor).lower()
    here = [
        monitor
        for monitor in monitors
        if asked in ("", str(monitor.number)) or asked in monitor.name.lower()
    ]
    now = [device_latency_conditions(camera, config.camera, monitor) for monitor in here]
    if then in now:
        return ""
    return f"measured with {then}; now it is {' or '.join(now) or 'another monitor'}".replace(
        "; ", ", "
    )
