"""Light fields in a notebook: opens them and renders any view."""

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfpipe.api.settings import config_of
from lfpipe.errors import UserError
from lfpipe.render.compositor import Compositor
from lfpipe.render.single_view import ViewRenderer
from lfpipe.scene import open_scene as open_scene_module
from lfpipe.scene.lightfield import LightField


def open_scene(path: str | os.PathLike[str] | None = None, settings: Mapping[str, Any] | None = None) -> LightField:
    """The light field at path, in any layout; the demo's if path is omitted.

    The first call packs it into the cache, which may take a minute; later calls return at once. settings: as for `--set`, for
    example {"scene.layout": "hci"}. Raises lfpipe.UserError.
    """
    config = config_of(settings).scene
    return open_scene_module.open_scene(path, config)


def render_view(field: LightField, row: float, col: float, *, method: str = "auto", frame: int = 0) -> NDArray[np.uint8]:
    """The view of a camera at (row, col) of the grid, fractions allowed: uint8 (height, width, 3) BGR.

    (0, 0) is the top left camera. method: auto, nearest, blend, warp, warp2 or best. frame: of a light-field video. Positions
    outside the grid are extrapolated by up to `render.extrapolate_views`. Raises lfpipe.UserError.
    """
    config = config_of({"render.method": method})
    _check_place(field, (row, col), config.render.extrapolate_views)
    return ViewRenderer(field, method).render(row, col, frame)


def render_anaglyph(
    field: LightField,
    left: tuple[float, float],
    right: tuple[float, float],
    *,
    mode: str = "dubois",
    frame: int = 0,
    settings: Mapping[str, Any] | None = None,
) -> NDArray[np.uint8]:
    """The picture for two eyes at the grid positions left and right, (row, col) each: uint8 (height, width, 3) BGR.

    mode: as `render.anaglyph`, including side-by-side. settings: of `render`, for example {"render.zero_plane_px": 0.5}. Raises
    lfpipe.UserError.
    """
    render = config_of({"render.anaglyph": mode, **(settings or {})}).render
    for place in (left, right):
        _check_place(field, place, render.extrapolate_views)
    return Compositor(field, render).compose(left, right, frame).copy()


def _check_place(field: LightField, place: tuple[float, float], beyond: float) -> None:
    for name, value, count in zip(("row", "col"), place, (field.rows, field.cols), strict=True):
        if not -beyond <= value <= count - 1 + beyond:
            raise UserError(f"{name} {value:g}: the scene has {count} views that way", f"0 to {count - 1}, {beyond:g} beyond it")
