"""Whose face it is, where there are several: the largest near the centre at first, then continuity."""

from __future__ import annotations

import math
from collections.abc import Sequence

from lfpipe.track.detector import Detection

SAME = 0.2  # overlap of one face's boxes in neighbouring pictures: 2 m/s at arm's length and 30 Hz still share 0.3

Box = tuple[float, float, float, float]


def same_place(a: Box, b: Box) -> bool:
    """Whether boxes of two pictures can be one face's: where it was, and of its size."""
    width, height = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
    common = max(width, 0.0) * max(height, 0.0)
    return common > SAME * ((a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - common)


def largest_near_centre(found: Sequence[Detection], width_px: int, height_px: int) -> Detection:
    """The face that looks most like the viewer's: its area, less the further it is from the centre (half at a half diagonal)."""

    def weight(face: Detection) -> float:
        x0, y0, x1, y1 = face.box_px
        away = math.hypot((x0 + x1 - width_px) / width_px, (y0 + y1 - height_px) / height_px) / math.sqrt(2)
        return (x1 - x0) * (y1 - y0) / (1 + away * away)

    return max(found, key=weight)


class Viewer:
    """Remembers where the viewer was, so that whoever is followed in their absence gives way when they are back.

    Counts pictures, not time: an engine has no clock.
    """

    MEMORY = 90  # pictures after which the face followed instead is the viewer
    PERIOD = 10  # pictures between two looks for the one remembered: the detector costs as much as the landmarks

    def __init__(self) -> None:
        self.box_px: Box | None = None
        self._away = 0  # pictures since somebody else is followed

    def followed(self, box_px: Box) -> None:
        """The face followed in this picture is in box_px."""
        self._away = 0 if self.box_px is None or same_place(self.box_px, box_px) else self._away + 1
        if self._away == 0 or self._away > self.MEMORY:
            self.box_px, self._away = box_px, 0

    @property
    def due(self) -> bool:
        """Whether it is time to look for the viewer elsewhere, while another face is followed."""
        return self._away > 0 and self._away % self.PERIOD == 0

    def back(self, found: Sequence[Detection], followed_px: Box) -> Detection | None:
        """The viewer among found, where they are remembered and apart from the face followed."""
        here = [face for face in found if self._known(face) and not same_place(followed_px, face.box_px)]
        return max(here, key=lambda face: face.score) if here else None

    def choose(self, found: Sequence[Detection], width_px: int, height_px: int) -> Detection:
        """Whom to follow among found (not empty): the one remembered, else the largest near the centre."""
        return largest_near_centre([face for face in found if self._known(face)] or found, width_px, height_px)

    def _known(self, face: Detection) -> bool:
        return self.box_px is not None and same_place(self.box_px, face.box_px)
