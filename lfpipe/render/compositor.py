"""From two viewpoints to one picture: the only interface that the render stage needs."""

import math
from collections.abc import Hashable
from functools import partial

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Render
from lfpipe.config.quality import NO_SCORES, drawn_with
from lfpipe.render.anaglyph import MATRICES, Channel, Mixer, Plane, Recipe, recipe
from lfpipe.render.blocks import near_array
from lfpipe.render.pair_layout import Pair
from lfpipe.render.planes import PlaneStore
from lfpipe.render.screen_plane import zero_plane_px
from lfpipe.render.synthesis import Synthesiser
from lfpipe.render.view_weights import Position
from lfpipe.render.viewpoint import extrapolation_views
from lfpipe.scene.lightfield import LightField

_RGB = tuple(Plane(0, weights, False) for weights in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
_WHOLE = Recipe(_RGB, (Channel(0), Channel(1), Channel(2)), False)  # one eye's view in its own colours
TWO_VIEWS = ("side-by-side", "row-interleaved")  # outputs of each eye's view in its own colours


def method_for(field: LightField, wanted: str) -> str:
    """The method that makes views of field for render.method = wanted; never "auto"."""
    return drawn_with(wanted, field.method, field.disparity is not None, field.manifest.get("scores", NO_SCORES))


def mixed_as(field: LightField, method: str, render: Render) -> Render:
    """render as it applies to a scene: where both eyes see the same view, it is drawn in its own colours."""
    same = field.cols == 1 and not extrapolation_views(method, render)
    return attrs.evolve(render, anaglyph="mono") if same and render.anaglyph in MATRICES else render


def recipe_for(render: Render) -> Recipe:
    """The recipe for mixing pictures; outputs without glasses show a view in its own colours."""
    return recipe(render.anaglyph, render.light, render.ghost_compensation) if render.anaglyph in MATRICES else _WHOLE


def planes_of_eyes(render: Render) -> tuple[tuple[Plane, ...], tuple[Plane, ...]]:
    """Planes made from the left eye's viewpoint, and from the right eye's. The one viewpoint of `mono`, midway between the eyes,
    counts as the left eye's.
    """
    planes = recipe_for(render).planes
    left, right = (tuple(plane for plane in planes if plane.eye == eye) for eye in (0, 1))
    return (left, left) if render.anaglyph in TWO_VIEWS else (left, right)


def _quantum(method: str, disparity_px: float) -> float:
    """Grid step to which coordinates are rounded, a power of two, at least 1/1024. Up to 16 px per view it moves nothing by more
    than 1/128 px, and it changes the weights of a cross-fade by at most 1/512.
    """
    finest = 1 / 1024
    if method == "nearest":
        return 1.0
    wanted = 1 / 256 if method in ("blend", "warp2", "best") else 1 / 16
    if method != "blend" and disparity_px > 0:
        wanted = min(wanted, 1 / (64 * disparity_px))
    return max(finest, 2.0 ** math.floor(math.log2(wanted)))


class Compositor:
    """Draws pictures of one light field with one set of render settings; a changed setting is a new Compositor.

    method: the method in use: `auto` resolved, and `nearest` for a light field that cannot be warped for want of disparity.
    Starts with a few small tables; views are built when first shown.
    """

    def __init__(self, field: LightField, render: Render) -> None:
        self.method = method_for(field, render.method)
        render = mixed_as(field, self.method, render)
        self._field, self._render = field, render
        height, width = field.height_px, field.width_px
        self._recipe = recipe_for(render)
        self._mixer = Mixer(self._recipe, height, width)
        self._store = PlaneStore(field)
        self._synthesiser = Synthesiser(field, self.method)
        wanted_planes = self._recipe.planes
        self._places = [[k for k, plane in enumerate(wanted_planes) if plane.eye == eye] for eye in (0, 1)]
        self._sources = [[partial(self._source, wanted_planes[k]) for k in places] for places in self._places]
        self._frame = 0
        self._outs = [[np.empty((height, width), np.uint8) for _ in places] for places in self._places]
        self._made: list[NDArray[np.uint8]] = [plane for outs in self._outs for plane in outs]
        self._picture = near_array((height, width, 3))
        self.pair: Pair | None = None  # the views of the last picture, if it consists of two
        if render.anaglyph in TWO_VIEWS:
            self.pair = np.empty((height, width, 3), np.uint8), np.empty((height, width, 3), np.uint8)
        self._zero_px = zero_plane_px(field, render)
        extent = max(abs(edge - self._zero_px) for edge in (field.disparity_min_px, field.disparity_max_px))
        self._quantum = _quantum(self.method, extent)
        self._settings = (self.method, render.anaglyph, render.light, render.ghost_compensation, self._zero_px)

    def _quantised(self, position: Position) -> Position:
        """position rounded to the key's grid, within the stored views plus the extrapolated zone; the centre if not finite."""
        reach = extrapolation_views(self.method, self._render)
        found = []
        for value, count in zip(position, (self._field.rows, self._field.cols), strict=True):
            value = value if math.isfinite(value) else (count - 1) / 2
            inside = min(max(value, -reach), count - 1 + reach)
            found.append(math.floor(inside / self._quantum + 0.5) * self._quantum)
        return found[0], found[1]

    def _eyes(self, left: Position, right: Position) -> tuple[Position, Position]:
        if self._render.anaglyph == "mono":
            middle = ((left[0] + right[0]) / 2, (left[1] + right[1]) / 2)
            left = right = middle
        return self._quantised(left), self._quantised(right)

    def key(self, left: Position, right: Position, frame: int = 0) -> Hashable:
        """Equal keys mean the same picture: a caller that holds it need not compose it again.

        left, right: (row, col) viewpoints of the eyes. frame: of light-field video, taken modulo its length.
        """
        return (*self._settings, frame % self._field.frames, *self._eyes(left, right))

    def compose(self, left: Position, right: Position, frame: int = 0) -> NDArray[np.uint8]:
        """The picture for the two viewpoints: uint8 (height, width, 3) BGR, valid until the next call."""
        eyes = self._eyes(left, right)
        self._frame = frame % self._field.frames
        if self.pair is None:
            self._draw(eyes, self._picture)
            return self._picture
        for position, whole in zip(eyes, self.pair, strict=True):
            self._draw((position, position), whole)
        if self._render.anaglyph == "row-interleaved":
            for eye, whole in enumerate(self.pair):
                self._picture[eye::2] = whole[eye::2]
        else:
            height, width = self._picture.shape[:2]
            for whole, x0, x1 in ((self.pair[0], 0, width // 2), (self.pair[1], width // 2, width)):
                if x1 > x0:
                    self._picture[:, x0:x1] = cv2.resize(whole, (x1 - x0, height), interpolation=cv2.INTER_AREA)
        return self._picture

    def _draw(self, eyes: tuple[Position, Position], out: NDArray[np.uint8]) -> None:
        for position, places, sources, outs in zip(eyes, self._places, self._sources, self._outs, strict=True):
            if places:
                drawn = self._synthesiser.render(position, self._frame, self._zero_px, sources, outs)
                for k, made in zip(places, drawn, strict=True):
                    self._made[k] = made
        self._mixer.mix(self._made, out)

    def _source(self, plane: Plane, row: int, col: int) -> NDArray[np.uint8]:
        return self._store.get(self._frame, row, col, plane)
