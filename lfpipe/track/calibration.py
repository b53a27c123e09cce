"""The camera's focal length from one thing of known size at a known distance: the viewer's eyes, or a bank card."""

from __future__ import annotations

import re
import tomllib
from collections import deque
from pathlib import Path

import numpy as np

from lfpipe.track.engine import Face

FRAMES = 45  # measured for one answer
SPREAD = 0.05  # quartiles further apart than that share of the median mean that the viewer moved


class EyeGauge:
    """Distance between the eyes in px over the last FRAMES frames with a face: median and how sure it is."""

    def __init__(self) -> None:
        self._apart_px: deque[float] = deque(maxlen=FRAMES)

    def add(self, face: Face | None) -> None:
        """One frame's face; a frame without one says nothing."""
        if face is not None:
            self._apart_px.append(float(np.hypot(*(face.eyes_px[0] - face.eyes_px[1]))))

    @property
    def full(self) -> bool:
        """Whether there are FRAMES of them."""
        return len(self._apart_px) == FRAMES

    @property
    def median_px(self) -> float:
        """0 before the first face."""
        return float(np.median(self._apart_px)) if self._apart_px else 0.0

    @property
    def steady(self) -> bool:
        """Whether the viewer kept still enough for the median to mean something."""
        low, middle, high = np.percentile(self._apart_px, [25, 50, 75]) if self._apart_px else (0.0, 0.0, 1.0)
        return bool(high - low <= SPREAD * middle)


def with_key(text: str, section: str, name: str, value: float) -> str:
    """TOML text with [section] name = value put in; comments and all else stay as they are."""
    line = f"{name} = {value}"
    head = re.search(rf"^\[{re.escape(section)}\][^\n]*$", text, re.M)
    if head is None:
        return text.rstrip() + ("\n\n" if text.strip() else "") + f"[{section}]\n{line}\n"
    following = re.search(r"^\[", text[head.end() :], re.M)
    end = head.end() + following.start() if following else len(text)
    body, count = re.subn(rf"^{re.escape(name)}[ \t]*=.*$", line, text[head.end() : end], count=1, flags=re.M)
    return text[: head.end()] + (body if count else f"\n{line}{body}") + text[end:]


def write_key(path: Path, section: str, name: str, value: float) -> None:
    """Puts [section] name = value into the TOML file at path, whole or not at all.

    Raises OSError where it cannot be written, ValueError where the file is of a form that has no place for a line.
    """
    text = with_key(path.read_text() if path.exists() else "", section, name, value)
    if tomllib.loads(text)[section][name] != value:
        raise ValueError(f"{section}.{name} is set in another way")
    path.parent.mkdir(parents=True, exist_ok=True)
    path = path.resolve()  # where it is a link it stays one
    new = path.with_name(path.name + ".new")
    new.write_text(text)
    new.replace(path)
