"""A light field as one web page that any browser opens, on a phone, too: mouse, finger or tilt look
around, and a button shows red/cyan. The views are one quilt of JPEG inside the page, and their
disparities one of PNG; the browser warps views as a session does, or cross-fades neighbours where
it has no WebGL 2. The page loads nothing.
"""

import base64
import html
import itertools
import json
import math
import re
from pathlib import Path
from urllib.parse import quote

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Config, Render
from lfpipe.config.quality import WARPS
from lfpipe.errors import UserError
from lfpipe.extras.gpu.shader import mixture, source
from lfpipe.files.safe_files import write_output
from lfpipe.render.synthesis.compositor import ViewRenderer, method_for, recipe_for
from lfpipe.render.synthesis.engine import Cameras
from lfpipe.render.synthesis.scene_views import SceneViews, reduced
from lfpipe.render.synthesis.viewpoint import COL_FADE, ROW_FADE, zero_plane_px
from lfpipe.render.synthesis.warper import ZERO, Levels
from lfpipe.render.viewer.geometry import parallax
from lfpipe.scene.lightfield import UNKNOWN, LightField

MAX_BYTES = 8_000_000  # of the page
MAX_PX = 32_000_000  # of the quilt: 128 MB of a phone's graphics memory
MAX_SIDE_PX = 8192  # of the quilt: a texture of phones since 2016
MIN_SIDE_PX = 320  # of a view's longer side, before views are left out
JPEG_QUALITY = 85
# disparity up to which a cross-fade of neighbours shows no double edges worth mentioning; eyes move
# less up and down
STEP_PX = {"cols": 1.5, "rows": 3.0}
MAX_VIEWS = 256  # layers of a texture in every WebGL 2
MIN_VIEWS = 5  # per axis, as far as the scene has them: what is hidden appears step by step
MIN_UNIT_PX = (
    1 / 8
)  # of a step of disparity: half of it is the error between views; finer costs size
FRAME_PX, BARS_PX = 640, 110  # width of an embedded page: a column of text; title and buttons
SHRINK = 0.95  # per attempt, at most


@attrs.frozen(kw_only=True)
class Quilt:
    """How the views of a page lie in its picture, row by row from the top left."""

    rows: int
    cols: int
    """Of the grid, as rows."""
    width_px: int
    height_px: int
    """Of a tile, as width_px."""
    across: int
    """Tiles side by side."""
    wanted: tuple[int, int]
    """(rows, cols) for a smooth picture; more than there are where the page was too large."""

    @property
    def down(self) -> int:
        """Tiles above one another."""
        return math.ceil(self.rows * self.cols / self.across)

    @property
    def fits(self) -> bool:
        """Whether a phone can show it."""
        width, height = self.across * self.width_px, self.down * self.height_px
        return width * height <= MAX_PX and max(width, height) <= MAX_SIDE_PX


class PageExport:
    """Draws the views of a page. config: as for `SceneExport`."""

    def __init__(self, field: LightField, config: Config) -> None:
        self._field = field
        self._config = config
        self._zero_px = zero_plane_px(field, config.render)
        self._method = method_for(field, config.render.method)
        self._renderer = ViewRenderer(field, config.render.method, self._zero_px)

    def _wanted(self, count: int, step_px: float, scale: float) -> int:
        """Views along an axis, of count stored ones, for tiles of this scale."""
        if self._method not in WARPS or count == 1:
            return count
        ends = (self._field.disparity_min_px, self._field.disparity_max_px)
        across_px = scale * (count - 1) * max(abs(end - self._zero_px) for end in ends)
        return min(count, max(MIN_VIEWS, math.ceil(across_px / step_px) + 1))

    def _quilt(self, scale: float, keep: float) -> Quilt:
        """The quilt of tiles of a scale. keep: share of the wanted views along each axis."""
        field = self._field
        rows, cols = (
            self._wanted(count, STEP_PX[axis], scale)
            for axis, count in (("rows", field.rows), ("cols", field.cols))
        )
        while rows * cols > MAX_VIEWS:
            rows, cols = (rows - 1, cols) if rows > cols else (rows, cols - 1)
        kept_rows, kept_cols = (min(n, max(2, round(keep * n))) for n in (rows, cols))
        width, height = (max(1, round(scale * px)) for px in (field.width_px, field.height_px))
        count = kept_rows * kept_cols
        across = min(count, math.ceil(math.sqrt(count * height / width)), MAX_SIDE_PX // width)
        return Quilt(
            rows=kept_rows,
            cols=kept_cols,
            width_px=width,
            height_px=height,
            across=max(1, across),
            wanted=(rows, cols),
        )

    def _places(self, quilt: Quilt) -> list[tuple[int, int]]:
        """(row, col) of the stored views in it, which alone have disparities."""
        rows, cols = (
            np.rint(np.linspace(0, count - 1, wanted)).astype(int).tolist()
            for count, wanted in ((self._field.rows, quilt.rows), (self._field.cols, quilt.cols))
        )
        return list(itertools.product(rows, cols))

    def _picture(self, quilt: Quilt) -> bytes:
        """The quilt as a JPEG."""
        size = quilt.width_px, quilt.height_px
        tiles = [reduced(self._renderer.render(*place), size) for place in self._places(quilt)]
        quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
        return cv2.imencode(".jpg", _tiled(tiles, quilt.across), quality)[1].tobytes()

    def _maps(self, quilt: Quilt, unit_px: float) -> tuple[bytes, tuple[int, int]]:
        """The disparities as a grey PNG in the quilt's order, and (columns, rows) of each; one
        unknown value each where views are cross-faded. unit_px: of a tile, per level.
        """
        places = self._places(quilt)
        maps = [np.zeros((1, 1), np.uint8)] * len(places)
        if self._method in WARPS:
            views = SceneViews(self._field, (quilt.width_px, quilt.height_px))
            maps = [self._levels(views, place, unit_px) for place in places]
        best = [cv2.IMWRITE_PNG_COMPRESSION, 9]
        picture = cv2.imencode(".png", _tiled(maps, quilt.across), best)[1].tobytes()
        return picture, (maps[0].shape[1], maps[0].shape[0])

    def _levels(self, views: SceneViews, place: tuple[int, int], unit_px: float) -> Levels:
        """The disparities of a view against the zero plane, moved as its picture is."""
        stored = views.disparity(0, *place)
        moved_px = Cameras(self._field).shift_px(self._zero_px * views.scale, place)
        rows, cols = (
            np.clip(np.arange(count) + round(by / 2), 0, count - 1)  # half as many as pixels
            for count, by in zip(stored.shape, moved_px, strict=True)
        )
        stored = stored[np.ix_(rows, cols)]
        px = (stored * self._field.disparity_scale_px - self._zero_px) * views.scale
        levels = np.clip(np.rint(px / unit_px) + ZERO, 1, 255)
        return np.where(stored == UNKNOWN, 0, levels).astype(np.uint8)

    def _page(self, quilt: Quilt, picture: bytes, credit: str) -> bytes:
        field = self._field
        chosen = parallax(self._config, field, self._config.camera.frame_px[0], None)
        step = (quilt.cols - 1) / max(1, field.cols - 1)
        eye_distance = min(chosen.views_between_eyes, field.cols - 1) * step
        scale = quilt.width_px / field.width_px
        ends_px = field.disparity_min_px, field.disparity_max_px
        farthest_px = scale * max(abs(end - self._zero_px) for end in ends_px)
        unit_px = max(farthest_px / (ZERO - 1), MIN_UNIT_PX)
        maps, cells = self._maps(quilt, unit_px)
        plain, glasses = (mixture(recipe_for(Render(anaglyph=name))) for name in ("mono", "dubois"))
        about = {
            "rows": quilt.rows,
            "cols": quilt.cols,
            "width": quilt.width_px,
            "height": quilt.height_px,
            "across": quilt.across,
            "apart": eye_distance,
            "cells": cells,
            "unit": unit_px,
            "span": scale * (ends_px[1] - ends_px[0]),
            "cameras": [
                [round(float(col + right), 3), round(float(row + down), 3)]
                for row, col in self._places(quilt)
                for down, right in [field.offsets[row, col]]
            ],
            "fade": (ROW_FADE, COL_FADE),
            "plain": plain,
            "glasses": glasses,
        }
        texts = {
            "TITLE": html.escape(field.name),
            "CREDIT": html.escape(credit or f"{field.name}, made with lfpipe"),
            "SCENE": json.dumps(about),
            "QUILT": base64.b64encode(picture).decode(),
            "MAPS": base64.b64encode(maps).decode(),
            "SHADER": source(),
        }
        template = Path(__file__).with_name("page.html").read_text("utf-8")
        page = re.sub("@([A-Z]+)@", lambda mark: texts[mark[1]], template)
        return page.encode("utf-8", "replace")

    def write(self, path: Path, credit: str = "") -> Quilt:
        """Writes the page, which has at most MAX_BYTES, to a path that `check_page` allows.

        First the tiles shrink, to MIN_SIDE_PX; then there are fewer views. Raises UserError.
        """
        longer_px = max(self._field.width_px, self._field.height_px)
        scale = min(1.0, MAX_SIDE_PX / longer_px)
        least = min(scale, MIN_SIDE_PX / longer_px)
        keep = 1.0
        while True:
            quilt = self._quilt(scale, keep)
            page = self._page(quilt, self._picture(quilt), credit) if quilt.fits else b""
            if quilt.fits and len(page) <= MAX_BYTES:
                write_output(path, page)
                return quilt
            share = min(SHRINK, math.sqrt(MAX_BYTES / len(page))) if page else SHRINK
            if scale > least:
                scale = max(least, scale * share)
            else:
                keep *= share


def _tiled(tiles: list[NDArray[np.uint8]], across: int) -> NDArray[np.uint8]:
    """Tiles of one size as one picture, row by row from the top left."""
    height, width = tiles[0].shape[:2]
    down = math.ceil(len(tiles) / across)
    whole = np.zeros((down * height, across * width, *tiles[0].shape[2:]), np.uint8)
    for number, tile in enumerate(tiles):
        y, x = height * (number // across), width * (number % across)
        whole[y : y + height, x : x + width] = tile
    return whole


def frame_of(path: Path, name: str, quilt: Quilt) -> str:
    """The line of HTML that shows a page within another one."""
    height_px = round(FRAME_PX * quilt.height_px / quilt.width_px) + BARS_PX
    return (
        f'<iframe src="{quote(path.name)}" title="{html.escape(name)}" width="{FRAME_PX}"'
        f' height="{height_px}" style="border: 0" allow="fullscreen; accelerometer; gyroscope">'
        "</iframe>"
    )


def check_page(path: Path) -> None:
    """Raises UserError if path names no page."""
    if path.suffix.lower() not in (".html", ".htm"):
        raise UserError(f"{path}: not .html", "use for example scene.html")
