"""A light field as one web page that any browser opens, on a phone, too: mouse, finger or tilt look
around, and a button shows red/cyan. The views are one quilt of JPEG inside the page; the browser
cross-fades neighbours. The page loads nothing.
"""

import base64
import html
import json
import math
import re
from pathlib import Path

import attrs
import cv2
import numpy as np

from lfpipe.config import Config
from lfpipe.config.quality import WARPS
from lfpipe.errors import UserError
from lfpipe.files.output import write_output
from lfpipe.render.synthesis.anaglyph import MATRICES
from lfpipe.render.synthesis.compositor import ViewRenderer, method_for
from lfpipe.render.synthesis.zero_plane import zero_plane_px
from lfpipe.render.viewer.geometry import parallax
from lfpipe.scene.lightfield import LightField

MAX_BYTES = 8_000_000  # of the page
MAX_PX = 32_000_000  # of the quilt: 128 MB of a phone's graphics memory
MAX_SIDE_PX = 8192  # of the quilt: a texture of phones since 2016
MIN_SIDE_PX = 320  # of a view's longer side, before views are left out
JPEG_QUALITY = 85
# disparity up to which a cross-fade of neighbours shows no double edges worth mentioning; eyes move
# less up and down
STEP_PX = {"cols": 1.5, "rows": 3.0}
MIN_VIEWS = 5  # per axis, as far as the scene has them: what is hidden appears step by step
SHRINK = 0.95  # per attempt


@attrs.frozen(kw_only=True)
class Quilt:
    """How the views of a page lie in its picture, row by row from the top left.

    rows, cols: views. width_px, height_px: of a tile. across: tiles side by side.
    wanted: (rows, cols) for a smooth cross-fade; more than there are where the page was too large.
    """

    rows: int
    cols: int
    width_px: int
    height_px: int
    across: int
    wanted: tuple[int, int]

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
        """Views along an axis of count stored ones, for tiles of this scale."""
        if self._method not in WARPS or count == 1:
            return count
        ends = (self._field.disparity_min_px, self._field.disparity_max_px)
        across_px = scale * (count - 1) * max(abs(end - self._zero_px) for end in ends)
        return max(min(count, MIN_VIEWS), math.ceil(across_px / step_px) + 1)

    def _quilt(self, scale: float, keep: float) -> Quilt:
        """The quilt of tiles of a scale. keep: share of the wanted views along each axis."""
        field = self._field
        rows, cols = (
            self._wanted(count, STEP_PX[axis], scale)
            for axis, count in (("rows", field.rows), ("cols", field.cols))
        )
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

    def _picture(self, quilt: Quilt) -> bytes:
        """The quilt as a JPEG."""
        size = quilt.width_px, quilt.height_px
        whole = np.zeros((quilt.down * size[1], quilt.across * size[0], 3), np.uint8)
        places = [
            (row, col)
            for row in np.linspace(0, self._field.rows - 1, quilt.rows)
            for col in np.linspace(0, self._field.cols - 1, quilt.cols)
        ]
        for number, (row, col) in enumerate(places):
            view = self._renderer.render(float(row), float(col))
            y, x = size[1] * (number // quilt.across), size[0] * (number % quilt.across)
            whole[y : y + size[1], x : x + size[0]] = cv2.resize(
                view, size, interpolation=cv2.INTER_AREA
            )
        return cv2.imencode(".jpg", whole, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()

    def _page(self, quilt: Quilt, picture: bytes, credit: str) -> bytes:
        field = self._field
        chosen = parallax(self._config, field, self._config.camera.frame_px[0], None)
        step = (quilt.cols - 1) / max(1, field.cols - 1)
        eye_distance = min(chosen.views_between_eyes, field.cols - 1) * step
        matrix = np.array(MATRICES["dubois"])  # (channels, eyes, weights)
        about = {
            "rows": quilt.rows,
            "cols": quilt.cols,
            "width": quilt.width_px,
            "height": quilt.height_px,
            "across": quilt.across,
            "apart": eye_distance,
            "fromLeft": matrix[:, 0].T.ravel().tolist(),
            "fromRight": matrix[:, 1].T.ravel().tolist(),
        }
        texts = {
            "TITLE": html.escape(field.name),
            "CREDIT": html.escape(credit or f"{field.name}, made with lfpipe"),
            "SCENE": json.dumps(about),
            "QUILT": base64.b64encode(picture).decode(),
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
        keep = 1.0
        while True:
            quilt = self._quilt(scale, keep)
            page = self._page(quilt, self._picture(quilt), credit) if quilt.fits else b""
            if quilt.fits and len(page) <= MAX_BYTES:
                write_output(path, page)
                return quilt
            if scale * SHRINK * longer_px >= MIN_SIDE_PX:
                scale *= SHRINK
            else:
                keep *= SHRINK


def check_page(path: Path) -> None:
    """Raises UserError if path names no page."""
    if path.suffix.lower() not in (".html", ".htm"):
        raise UserError(f"{path}: not .html", "use for example scene.html")
