"""From two viewpoints to one picture, by the processor or a painter of another package, and from
one viewpoint to one camera's view.
"""

import contextlib
import math
from collections.abc import Sequence
from concurrent.futures import Executor
from functools import partial
from typing import Protocol

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Render
from lfpipe.config.quality import WARPS, method_in_use
from lfpipe.errors import UserError
from lfpipe.plugins import PAINTERS, load, plugins
from lfpipe.render.synthesis.anaglyph import (
    BLUE,
    GREEN,
    MATRICES,
    RED,
    Channel,
    Mixer,
    Pair,
    Plane,
    Recipe,
    arrange_stereo_pair,
    recipe,
)
from lfpipe.render.synthesis.engine import Synthesiser
from lfpipe.render.synthesis.scene_views import SceneViews
from lfpipe.render.synthesis.viewpoint import Position, extrapolation_views, zero_plane_px
from lfpipe.render.synthesis.warper import split_rows, unaligned_array
from lfpipe.scene.lightfield import LightField


class Painter(Protocol):
    """Paints pictures of one light field by one method and one recipe."""

    def paint(
        self,
        frame: int,
        eyes: Sequence[Position],
        zero_px: float,
        out: NDArray[np.uint8],
        alone: bool = False,
    ) -> None:
        """Paints what the left and the right eye see into out, uint8 (height, width, 3) BGR.

        zero_px: disparity in the plane of the screen. alone: in the calling thread.
        """

    def reset(self) -> None:
        """Takes the views and disparities of the scene anew, which were replaced."""


class PainterLost(Exception):
    """A painter can paint no longer."""


class Painters(Protocol):
    """Makes painters for the methods that warp, in place of the processor's."""

    failure: str
    """Why they paint no longer; "" while they do."""

    def painter(self, views: SceneViews, method: str, mix: Recipe) -> Painter:
        """A painter. It, and its `paint`, raise PainterLost."""


def open_painters(device: str, thread: Executor) -> tuple[Painters | None, str]:
    """The painters for `render.device` = device that an entry point of `lfpipe.painters` offers, or
    None, and what draws, for people. thread: of their own.
    """
    try:
        for name in plugins(PAINTERS) if device != "cpu" else ():
            opened: tuple[Painters | None, str] = load(PAINTERS, name)(device, thread)
            return opened
    except UserError as error:
        return None, f"CPU: {error.message}"
    return None, "CPU"


class PlanePainter:
    """Draws planes on the processor and mixes them. helpers: threads that draw with the calling
    one, `threads` in all, each some rows.
    """

    def __init__(
        self,
        views: SceneViews,
        method: str,
        mix: Recipe,
        helpers: Executor | None = None,
        threads: int = 1,
    ) -> None:
        shape = views.height_px, views.width_px
        self._mixer = Mixer(mix, shape)
        self._planes = [np.empty(shape, np.uint8) for _ in mix.planes]
        self._eyes = [
            [k for k, plane in enumerate(mix.planes) if plane.eye == eye] for eye in (0, 1)
        ]
        self._sources = [views.source(plane) for plane in mix.planes]
        # a cross-fade is limited by memory, not by the processor
        parts = threads if helpers is not None and method in WARPS else 1
        self._parts = [
            Synthesiser(views, method, rows) for rows in split_rows(views.height_px, parts)
        ]
        self._helpers = helpers

    def reset(self) -> None:
        """See `Painter`."""
        for part in self._parts:
            part.reset()

    def paint(
        self,
        frame: int,
        eyes: Sequence[Position],
        zero_px: float,
        out: NDArray[np.uint8],
        alone: bool = False,
    ) -> None:
        """See `Painter`."""
        first, *others = self._parts
        drawn = []
        for part in others:
            if self._helpers is None or alone:
                self._draw_rows(part, frame, eyes, zero_px, out)
            else:
                drawn.append(self._helpers.submit(self._draw_rows, part, frame, eyes, zero_px, out))
        self._draw_rows(first, frame, eyes, zero_px, out)
        for rows in drawn:
            rows.result()

    def _draw_rows(
        self,
        part: Synthesiser,
        frame: int,
        eyes: Sequence[Position],
        zero_px: float,
        out: NDArray[np.uint8],
    ) -> None:
        planes = list(self._planes)
        for eye, (of_eye, position) in enumerate(zip(self._eyes, eyes, strict=True)):
            if of_eye:
                drawn = part.render(
                    position,
                    frame,
                    zero_px,
                    [self._sources[k] for k in of_eye],
                    [self._planes[k] for k in of_eye],
                    eye,
                )
                for k, plane in zip(of_eye, drawn, strict=True):
                    planes[k] = plane
        self._mixer.mix(planes, out, part.rows)


# frame of a video, viewpoints of the eyes on a grid of small steps
Key = tuple[int, Position, Position]

_RGB = tuple(Plane(0, weights, False) for weights in (RED, GREEN, BLUE))
# one eye's view in its own colours
_WHOLE = Recipe(_RGB, (Channel(0), Channel(1), Channel(2)), False)
TWO_VIEWS = ("side-by-side", "row-interleaved")  # outputs with separate views, in original colours


def method_for(field: LightField, method: str) -> str:
    """The method that renders field for render.method = method; never "auto"."""
    return method_in_use(method, field.method, field.disparity is not None)


def settings_for_scene(field: LightField, method: str, render: Render) -> Render:
    """render as it applies to a scene: if both eyes see the same view, it is drawn in its original
    colours.
    """
    same = field.cols == 1 and not extrapolation_views(method, render)
    return attrs.evolve(render, anaglyph="mono") if same and render.anaglyph in MATRICES else render


def recipe_for(render: Render) -> Recipe:
    """The recipe for mixing pictures; outputs without glasses show original colours."""
    return (
        recipe(render.anaglyph, render.light, render.ghost_compensation)
        if render.anaglyph in MATRICES
        else _WHOLE
    )


def planes_of_eyes(render: Render) -> tuple[tuple[Plane, ...], tuple[Plane, ...]]:
    """The planes for the left and for the right viewpoint. The single viewpoint of `mono`, midway
    between the eyes, counts as the left one.
    """
    left, right = (
        tuple(plane for plane in recipe_for(render).planes if plane.eye == eye) for eye in (0, 1)
    )
    return (left, left) if render.anaglyph in TWO_VIEWS else (left, right)


def _quantum(method: str, disparity_px: float) -> float:
    """Grid step to which coordinates are rounded, a power of two, at least 1/1024. Up to 64 px per
    view, this moves pixels by at most 1/32 px, and it changes the weights of a cross-fade by at
    most 1/512, of two warped views by at most 1/128.
    """
    if method == "nearest":
        return 1.0
    if method == "blend":
        return 1 / 256
    step = 1 / 16 if method == "warp" else 1 / 64
    if disparity_px > 0:
        step = min(step, 1 / (16 * disparity_px))
    return max(1 / 1024, 2.0 ** math.floor(math.log2(step)))


class Compositor:
    """Draws pictures of one light field with one set of render settings; a changed setting is a new
    Compositor.

    method: the method in use: `auto` resolved, and `nearest` for a light field that cannot be
    warped for want of disparity. Starts with a few small tables; views are built when first shown.
    helpers: threads that draw warped pictures with the calling one, `threads` in all, each some
    rows. size_px: (width, height) of the pictures, of the light field's aspect and no larger; its
    own for None. gpu: draws warped pictures, until it fails.
    """

    def __init__(
        self,
        field: LightField,
        render: Render,
        helpers: Executor | None = None,
        threads: int = 1,
        size_px: tuple[int, int] | None = None,
        gpu: Painters | None = None,
    ) -> None:
        self.method = method_for(field, render.method)
        render = settings_for_scene(field, self.method, render)
        self.size_px = size_px or (field.width_px, field.height_px)
        """(width, height) of its pictures."""
        self._render = render
        self._views = views = SceneViews(field, self.size_px)
        self._make_plane_painter = partial(
            PlanePainter, views, self.method, recipe_for(render), helpers, threads
        )
        self._painter = self._make_painter(gpu)
        self._picture = unaligned_array((views.height_px, views.width_px, 3))
        self.pair: Pair | None = None
        """The views of the last picture, if it consists of two."""
        if render.anaglyph in TWO_VIEWS:
            self.pair = np.empty_like(self._picture), np.empty_like(self._picture)
        self._reach = extrapolation_views(self.method, render)
        self._update_depth()

    def _make_painter(self, gpu: Painters | None) -> Painter:
        """The GPU's if there is one and it draws the method, else the processor's."""
        if gpu is not None and self.method in WARPS:
            with contextlib.suppress(PainterLost):
                return gpu.painter(self._views, self.method, recipe_for(self._render))
        return self._make_plane_painter()

    @property
    def field(self) -> LightField:
        """The light field that it draws."""
        return self._views.field

    def replace(self, field: LightField) -> None:
        """Draws another light field of the same size, grid and method from now on."""
        self._views.replace(field)
        self._painter.reset()
        self._update_depth()

    def _update_depth(self) -> None:
        """Computes what depends on the range of disparity."""
        field, scale = self._views.field, self._views.scale
        zero_px = zero_plane_px(field, self._render)
        extent_px = max(
            abs(edge - zero_px) for edge in (field.disparity_min_px, field.disparity_max_px)
        )
        self._zero_px = zero_px * scale
        self._quantum = _quantum(self.method, extent_px * scale)

    def _rounded(self, value: float, last: int) -> float:
        """value on an axis of views 0 to last, rounded to the key's grid, within the extrapolated
        zone; the middle if not finite.
        """
        inside = (
            min(max(value, -self._reach), last + self._reach) if math.isfinite(value) else last / 2
        )
        return math.floor(inside / self._quantum + 0.5) * self._quantum

    def key(self, left: Position, right: Position, frame: int = 0) -> Key:
        """The key of the picture for (row, col) viewpoints of the eyes: equal keys mean equal
        pictures, which need not be drawn again. frame: of light-field video, modulo its length.
        """
        last_row, last_col = self.field.rows - 1, self.field.cols - 1
        if self._render.anaglyph == "mono":
            left = right = (left[0] + right[0]) / 2, (left[1] + right[1]) / 2
        row = self._rounded(left[0], last_row)
        right_row = row if right[0] == left[0] else self._rounded(right[0], last_row)
        return (
            frame % self.field.frames,
            (row, self._rounded(left[1], last_col)),
            (right_row, self._rounded(right[1], last_col)),
        )

    def compose(self, left: Position, right: Position, frame: int = 0) -> NDArray[np.uint8]:
        """The picture for two viewpoints: uint8 (height, width, 3) BGR, valid until the
        next call.
        """
        return self.draw(self.key(left, right, frame))

    def draw(self, key: Key) -> NDArray[np.uint8]:
        """The picture of a key of this Compositor: uint8 (height, width, 3) BGR, valid until the
        next call.
        """
        frame, left, right = key
        if self.pair is None:
            self._paint(frame, (left, right), self._picture)
            return self._picture
        for position, whole in zip((left, right), self.pair, strict=True):
            self._paint(frame, (position, position), whole)
        height, width = self._picture.shape[:2]
        return arrange_stereo_pair(
            self.pair, self._render.anaglyph, (width, height), out=self._picture
        )

    def prepare(self, left: Position, right: Position, frame: int = 0) -> None:
        """Builds, in the calling thread alone, what the picture for two viewpoints needs."""
        frame, left, right = self.key(left, right, frame)
        self._paint(frame, (left, right), self._picture, alone=True)

    def _paint(
        self,
        frame: int,
        eyes: tuple[Position, Position],
        out: NDArray[np.uint8],
        alone: bool = False,
    ) -> None:
        try:
            self._painter.paint(frame, eyes, self._zero_px, out, alone)
        except PainterLost:
            self._painter = self._make_plane_painter()
            self._painter.paint(frame, eyes, self._zero_px, out, alone)


class ViewRenderer:
    """Draws one camera's views of a light field, in its own colours; keeps its tables from view to
    view. method: as `render.method`. zero_plane_px: disparity that stays in place from view to
    view; only warps shift by it. size_px: (width, height) as for `Compositor`.
    """

    def __init__(
        self,
        field: LightField,
        method: str = "auto",
        zero_plane_px: float = 0.0,
        size_px: tuple[int, int] | None = None,
    ) -> None:
        self._frames = field.frames
        views = SceneViews(field, size_px)
        self._zero_plane_px = zero_plane_px * views.scale
        self._synthesiser = Synthesiser(views, method_for(field, method))
        self._sources = [views.source(channel) for channel in _RGB[: field.channels]]
        self._outs = [
            np.empty((views.height_px, views.width_px), np.uint8) for _ in range(field.channels)
        ]

    def planes(self, row: float, col: float, frame: int = 0) -> list[NDArray[np.uint8]]:
        """The planes of the view at (row, col), fractions allowed: uint8 (height, width) each, one
        or red, green and blue, valid until the next call.

        frame: of a light-field video.
        """
        return self._synthesiser.render(
            (row, col),
            frame % self._frames,
            self._zero_plane_px,
            self._sources,
            self._outs,
        )

    def render(self, row: float, col: float, frame: int = 0) -> NDArray[np.uint8]:
        """As `planes`, in a new array, uint8 (height, width, 3) BGR."""
        planes = self.planes(row, col, frame)
        return np.stack(planes * 3 if len(planes) == 1 else planes[::-1], axis=2)
