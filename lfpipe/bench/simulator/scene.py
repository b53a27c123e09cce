"""Scenes drawn exactly from any viewpoint, as light fields with exact disparity."""

from collections.abc import Sequence
from functools import cached_property, lru_cache

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.render.synthesis.viewpoint import Position
from lfpipe.scene import demo_drawing as drawing
from lfpipe.scene.demo_drawing import TEXELS, Ball, Picture, Quad, Solid, draw_view
from lfpipe.scene.disparity import halved, quantised, scale_for
from lfpipe.scene.layouts.demo import solids_of
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.pack import DEMO, DEMO_SIZE_PX
from lfpipe.scene.source import Geometry

SIDE_PX = 224  # of a view
Colour = tuple[int, int, int]


@attrs.frozen(eq=False, kw_only=True)
class SimulatedScene:
    """A scene with an exact picture from any viewpoint."""

    name: str
    solids: tuple[Solid, ...]
    """Back to front, in px of a view of SIDE_PX."""
    rows: int
    cols: int
    zero_px: float
    """The disparity in the plane of the screen."""
    alpha_px: float | None = None
    """`render.alpha_px`; None for the automatic one."""

    @cached_property
    def _before_screen(self) -> list[Solid]:
        return [moved(solid, -self.zero_px) for solid in self.solids]

    def picture(self, position: Position) -> Picture:
        """The exact picture from (row, col), uint8 (SIDE_PX, SIDE_PX, 3) BGR, with the zero plane
        at the screen.
        """
        u = position[1] - (self.cols - 1) / 2
        v = position[0] - (self.rows - 1) / 2
        return np.ascontiguousarray(draw_view(self._before_screen, u, v, SIDE_PX)[0][..., ::-1])

    @cached_property
    def field(self) -> LightField:
        """The light field of its views, with exact disparities."""
        rows = self.rows
        cols = self.cols
        views = np.empty((1, rows, cols, 3, SIDE_PX, SIDE_PX), np.uint8)
        half = SIDE_PX // 2
        maps = np.empty((1, rows, cols, half, half), np.float32)
        for row, col in np.ndindex(rows, cols):
            u = col - (cols - 1) / 2
            v = row - (rows - 1) / 2
            colour, disparity = draw_view(list(self.solids), u, v, SIDE_PX)
            views[0, row, col] = colour.transpose(2, 0, 1)
            maps[0, row, col] = halved(disparity)
        low = float(maps.min())
        high = float(maps.max())
        scale = scale_for(low, high)
        return LightField(
            views=views,
            disparity=quantised(maps, scale),
            disparity_scale_px=scale,
            disparity_min_px=low,
            disparity_max_px=high,
            disparity_source="truth",
            offsets=np.zeros((rows, cols, 2), np.float32),
            present=np.ones((rows, cols), bool),
            geometry=Geometry(),
            frame_rate_hz=0.0,
            name=self.name,
            method="warp2",
            border_px=(low, self.zero_px),
        )


def moved(solid: Solid, d: float) -> Solid:
    """The solid with disparity d added."""
    if isinstance(solid, Ball):
        return attrs.evolve(solid, d=solid.d + d)
    return attrs.evolve(solid, corners=solid.corners + np.array((0.0, 0.0, d)))


def scaled(solid: Solid, share: float) -> Solid:
    """The solid for views of another size, with the same number of texels per px."""
    size = [max(round(length * share), 1) for length in solid.texture.shape[1::-1]]
    texture = np.asarray(cv2.resize(solid.texture, size, interpolation=cv2.INTER_AREA), np.uint8)
    return attrs.evolve(solid.scaled(share), texture=texture)


def _upright(texture: NDArray[np.generic], box: Sequence[float], d: float) -> Quad:
    """A picture that faces the viewer. box: left, top, right, bottom."""
    left, top, right, bottom = box
    corners = [(left, top, d), (right, top, d), (right, bottom, d), (left, bottom, d)]
    return Quad(drawing.opaque(texture), np.array(corners))


def _wall(rng: np.random.Generator, margin: float, d: float, grain: float, contrast: float) -> Quad:
    """A wall behind everything. grain: px of its largest features."""
    side = round((SIDE_PX + 2 * margin) * TEXELS)
    pattern = drawing.noise(rng, side, side, (grain * TEXELS, grain * TEXELS))
    colour = drawing.mixed(0.5 + contrast * pattern, (40, 62, 92), (206, 190, 160))
    return _upright(colour, (-margin, -margin, SIDE_PX + margin, SIDE_PX + margin), d)


def _wide() -> tuple[Solid, ...]:
    """Thin posts and leaves in front of a wall, with up to 40 px between views."""
    rng = np.random.default_rng(4)
    solids: list[Solid] = [_wall(rng, 40.0, -12.0, 24.0, 0.25)]
    card = drawing.marble(rng, 180, 160)
    solids.append(_upright(card, (96, 70, 176, 160), 2.0))
    for k, d in enumerate(np.linspace(4.0, 28.0, 7).tolist()):
        x = 20.0 + 31.0 * (k * 3 % 7)
        bands = drawing.noise(rng, 400, 10, (9, 40))
        post = drawing.mixed(0.5 + 0.4 * bands, (70 + 20 * k, 40, 30), (230, 200 - 15 * k, 150))
        solids.append(_upright(post, (x, -40, x + 4.0, SIDE_PX + 40), d))
    return tuple(solids)


def _plain() -> tuple[Solid, ...]:
    """Smooth surfaces with hardly any texture."""
    rng = np.random.default_rng(6)
    solids: list[Solid] = [_wall(rng, 12.0, -1.6, 300.0, 0.12)]
    for x, y, d, radius, shade in ((70, 90, -0.4, 40.0, 150), (150, 140, 1.1, 34.0, 90)):
        skin = np.full((64, 128, 3), (shade, 120, 240 - shade), np.uint8)
        solids.append(
            Ball(texture=skin, x=x, y=y, d=d, radius=radius, depth=0.0075 * radius, gloss=0.0)
        )
    return tuple(solids)


@lru_cache(maxsize=3)
def scene_of(name: str) -> SimulatedScene:
    """One of SCENES."""
    if name == "wide baseline":
        return SimulatedScene(name=name, solids=_wide(), rows=3, cols=5, zero_px=6.0, alpha_px=60.0)
    if name == "little texture":
        return SimulatedScene(name=name, solids=_plain(), rows=5, cols=5, zero_px=0.0)
    share = SIDE_PX / DEMO_SIZE_PX
    solids = tuple(scaled(solid, share) for solid in solids_of(DEMO))
    return SimulatedScene(name=name, solids=solids, rows=9, cols=9, zero_px=0.7)


SCENES = ("demo", "wide baseline", "little texture")
