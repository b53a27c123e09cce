"""The viewer before the screen: from where their eyes are to the two viewpoints and the picture."""

from __future__ import annotations

from collections.abc import Hashable

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Config
from lfpipe.eyes import extrapolated
from lfpipe.glide import Glide
from lfpipe.render.compositor import Compositor
from lfpipe.render.geometry import Parallax, parallax
from lfpipe.render.viewpoint import Mapper, Position
from lfpipe.scene.lightfield import LightField

FAR_PX = 1e6  # off the picture's corner; no eye is further out
DISTANCE_S = 1.0  # time constant by which alpha follows the viewer's distance, seen as the distance between the eyes


@attrs.frozen(eq=False)
class Look:
    """What a picture is made for. eyes_px: (2, 2), after filter and prediction. left, right: (row, col). frame: of a video."""

    eyes_px: NDArray[np.float64]
    left: Position
    right: Position
    frame: int


class Viewer:
    """Holds the neutral pose, alpha and the compositor; a changed configuration or scene keeps the pose."""

    def __init__(self, field: LightField, config: Config) -> None:
        self.parallax: Parallax | None = None
        self._centre_px: tuple[float, float] | None = None
        self._eyes_px = np.zeros((2, 2))
        self._seen = False
        self._apart_px = 0.0
        self._eyes_mm = 0.0
        self._t_ns = 0
        self._start_ns = 0
        self._glide = Glide()
        self._shown_mm: float | None = None
        self.shown: Look | None = None  # what the last look was
        self.set(field, config)

    def set(self, field: LightField, config: Config) -> None:
        """Takes another scene or configuration, from the next look on."""
        self.field, self.config = field, config
        self.compositor = Compositor(field, config.render)
        self.parallax = None
        self._mapper: Mapper | None = None

    def redraw_by(self, config: Config) -> None:
        """Takes a configuration that differs in render.method and render.rate_hz alone: what lies where stays as it is."""
        self.config, self.compositor = config, Compositor(self.field, config.render)
        if self._mapper is not None:
            self._mapper.snap = self.method == "nearest"

    def shown_as_wide(self, width_mm: float | None) -> bool:
        """Takes the width of the picture on the screen, as the display tells it; whether alpha has to be found anew."""
        new = width_mm != self._shown_mm and self.config.screen.width_mm == "auto"
        self._shown_mm = width_mm
        if new:
            self.parallax = self._mapper = None
        return new

    @property
    def method(self) -> str:
        return self.compositor.method

    @property
    def mapper(self) -> Mapper | None:
        """How eyes become views; None until a face was seen."""
        return self._mapper

    def recentre(self) -> None:
        """Where the eyes were last becomes the neutral pose."""
        if self._seen:
            middle = self._eyes_px.mean(axis=0)
            self._centre_px = (float(middle[0]), float(middle[1]))
            self._mapper = None

    def look(self, record: NDArray[np.void] | None, t_sensor_ns: int, t_shown_ns: int) -> Look:
        """The look at t_shown_ns, from the newest eyes record and its frame's stamp; None: nobody was seen yet."""
        frame = self._frame(t_shown_ns)
        eyes_px = None if record is None else self._eyes(record, t_shown_ns - t_sensor_ns)
        if record is None or (eyes_px is None and not self._seen):
            row, col = (self.field.rows - 1) / 2, (self.field.cols - 1) / 2
            self.shown = Look(self._eyes_px, (row, col), (row, col), frame)
            return self.shown
        if eyes_px is not None:
            self._follow_distance(eyes_px, t_shown_ns)
        if float(record["eyes_mm"]) != self._eyes_mm:  # learnt, or learnt anew
            self._eyes_mm, self._mapper = float(record["eyes_mm"]), None
        mapper = self._mapper or self._make_mapper(record)
        if isinstance(self.config.render.alpha_px, str) and self.parallax is not None:
            mapper.alpha_px = self._apart_px / self.parallax.views_between_eyes
        half = self._apart_px / 2
        neutral_px = np.add(mapper.centre_px, [[half, 0.0], [-half, 0.0]])
        start_px = neutral_px if self._seen or eyes_px is None else eyes_px  # the first face is there at once
        self._seen = True
        self._eyes_px = self._glide.at(t_shown_ns, eyes_px, start_px, int(record["generation"]))
        left, right = mapper.views(self._eyes_px)
        self.shown = Look(self._eyes_px, left, right, frame)
        return self.shown

    def key(self, look: Look) -> Hashable:
        """Equal keys mean the same picture."""
        return self.compositor.key(look.left, look.right, look.frame)

    def compose(self, look: Look) -> NDArray[np.uint8]:
        """The picture, uint8 (height, width, 3) BGR, valid until the next call."""
        return self.compositor.compose(look.left, look.right, look.frame)

    def _frame(self, t_ns: int) -> int:
        if self.field.frames == 1:
            return 0
        self._start_ns = self._start_ns or t_ns
        return int((t_ns - self._start_ns) * self.field.frame_rate_hz / 1e9)

    @staticmethod
    def _eyes(record: NDArray[np.void], horizon_ns: int) -> NDArray[np.float64] | None:
        """Where the eyes will be, or None where no face is seen, or one that no camera shows: one number that is none would stay
        in what is averaged for ever."""
        if not record["face"]:
            return None
        eyes_px = extrapolated(record["filtered_px"], record["velocity_px_s"], horizon_ns)
        return eyes_px if (np.abs(eyes_px) < FAR_PX).all() else None

    def _follow_distance(self, eyes_px: NDArray[np.float64], t_ns: int) -> None:
        apart_px = float(np.hypot(*(eyes_px[0] - eyes_px[1])))
        if not self._seen:
            self._apart_px = apart_px
        else:  # backward Euler: stable for any step
            ratio = max(t_ns - self._t_ns, 0) / 1e9 / DISTANCE_S
            self._apart_px += (apart_px - self._apart_px) * ratio / (1 + ratio)
        self._t_ns = t_ns

    def _make_mapper(self, record: NDArray[np.void]) -> Mapper:
        """With alpha by hand the grid lies on the middle of the camera picture, as in the paper; with alpha from geometry on
        where the viewer was seen first, for a webcam above the screen never has them in its middle."""
        render = self.config.render
        width_px, height_px = int(record["width_px"]), int(record["height_px"])
        self.parallax = parallax(self.config, self.field, width_px, self._apart_px, self._eyes_mm or None, self._shown_mm)
        if self._centre_px is None and isinstance(render.alpha_px, str):
            middle = record["filtered_px"].mean(axis=0)
            if (np.abs(middle) < FAR_PX).all():
                self._centre_px = (float(middle[0]), float(middle[1]))
        centre_px = self._centre_px or (width_px / 2, height_px / 2)
        snap = self.method == "nearest"
        self._mapper = Mapper(self.field.rows, self.field.cols, render, self.parallax.alpha_px, centre_px, snap)
        return self._mapper
