"""Paints the picture of two viewpoints: the interface, and the processor's way."""

from collections.abc import Sequence
from concurrent.futures import Executor
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lfpipe.config.quality import WARPS
from lfpipe.errors import UserError
from lfpipe.plugins import PAINTERS, load, plugins
from lfpipe.render.synthesis.anaglyph import Mixer, Recipe
from lfpipe.render.synthesis.blocks import split_rows
from lfpipe.render.synthesis.engine import Synthesiser
from lfpipe.render.synthesis.scene_views import SceneViews
from lfpipe.render.synthesis.viewpoint import Position


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


def open_painters(asked: str, thread: Executor) -> tuple[Painters | None, str]:
    """The painters for `render.device` = asked that an entry point of `lfpipe.painters` offers, or
    None, and what draws, for people. thread: of their own.
    """
    try:
        for name in plugins(PAINTERS) if asked != "cpu" else ():
            opened: tuple[Painters | None, str] = load(PAINTERS, name)(asked, thread)
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
                sources = [self._sources[k] for k in of_eye]
                outs = [self._planes[k] for k in of_eye]
                drawn = part.render(position, frame, zero_px, sources, outs, eye)
                for k, plane in zip(of_eye, drawn, strict=True):
                    planes[k] = plane
        self._mixer.mix(planes, out, part.rows)
