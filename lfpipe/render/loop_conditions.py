"""The conditions under which the loop's delay was measured: `render.loop_measured`, one readable line of text."""

from __future__ import annotations

import attrs

from lfpipe.config import Camera, Config
from lfpipe.render.monitors import Monitor

NAMES = {"camera": "the camera", "mode": "its mode", "monitor": "the monitor", "rate": "the screen's rate"}


@attrs.frozen
class LoopConditions:
    """Texts. date: YYYY-MM-DD. camera: the driver's name. mode: requested size, format and rate. rate: of the monitor."""

    date: str
    camera: str
    mode: str
    monitor: str
    rate: str

    @classmethod
    def of(cls, date: str, camera: str, asked: Camera, monitor: Monitor) -> LoopConditions:
        """camera: its name. asked: its settings."""
        mode = f"{asked.width_px}x{asked.height_px} {asked.format} {asked.rate_hz:g} Hz"
        texts = (date, camera, mode, monitor.name, f"{monitor.rate_hz:g} Hz")
        return cls(*(text.replace(";", ",") for text in texts))

    @classmethod
    def parse(cls, text: str) -> LoopConditions | None:
        """Parses the result of `str`; None for any other text."""
        parts = text.split("; ")
        return cls(*parts) if len(parts) == 5 else None

    def __str__(self) -> str:
        return "; ".join(attrs.astuple(self))

    def changes(self, now: LoopConditions) -> list[str]:
        """The changed conditions, in words."""
        return [
            f"{words} is {getattr(now, name) or 'unknown'}, not {getattr(self, name)}"
            for name, words in NAMES.items()
            if getattr(now, name) != getattr(self, name)
        ]


def loop_doubt(config: Config, camera: str, monitors: list[Monitor]) -> str:
    """The reason to distrust render.loop_ms now; "" if there is none. camera: name of the camera in use. monitors: all connected
    ones; without screen.monitor the window may be on any of them.
    """
    then = LoopConditions.parse(config.render.loop_measured)
    if then is None:
        return "it was set by hand, not measured" if config.render.loop_ms else ""
    wanted = str(config.screen.monitor)
    chosen = [each for each in monitors if wanted in ("", str(each.number)) or wanted.lower() in each.name.lower()]
    nowhere = Monitor(0, "", 0, 0, 0, 0, None)
    changes: list[list[str]] = []
    for each in chosen or [nowhere]:
        changes.append(then.changes(LoopConditions.of("", camera, config.camera, each)))
    fewest = min(changes, key=len)
    return "; ".join(fewest)
