"""Exports of a light field: pictures, and short videos as MP4 or GIF. The method that suits the
scene draws every view; light-field videos play on.

    quilt    views from left to right as tiles of one picture, the leftmost at the bottom left, for
             Looking Glass displays: https://docs.lookingglassfactory.com/keyconcepts/quilts
    pair     the left eye's view beside the right eye's, both in full width
    wiggle   from the left eye's view to the right eye's and back, for ever
    sweep    along the middle row from the first column to the last and back
"""

import io
import itertools
import math
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lfpipe.config import Config
from lfpipe.errors import UserError
from lfpipe.files.codecs import VideoWriter, require_encoder, write_error
from lfpipe.files.safe_files import replaced
from lfpipe.render.synthesis.compositor import ViewRenderer
from lfpipe.render.synthesis.viewpoint import zero_plane_px
from lfpipe.render.viewer.geometry import parallax
from lfpipe.scene.lightfield import LightField

Picture = NDArray[np.uint8]

GIF_PICTURES = 300  # a GIF is held in memory
QUILT_PX = 8192  # of a side: the largest that they accept
MAX_TILES = 20  # a side: the quilts of Looking Glass have up to 11
RATE_HZ = 30.0  # smooth, and half the size of 60
JPEG_QUALITY = 95  # hardly different from the original
WIGGLE_S, SWEEP_S = 0.8, 6.0  # there and back


class SceneExport:
    """Draws the exports of one scene. config: render.method, render.zero_plane_px, and the keys
    that determine the distance between the eyes' views.
    """

    def __init__(self, field: LightField, config: Config) -> None:
        self._field = field
        self._config = config
        self._last = field.cols - 1.0
        self._renderer = ViewRenderer(
            field, config.render.method, zero_plane_px(field, config.render)
        )

    def _view(self, col: float, frame: int = 0) -> Picture:
        return self._renderer.render((self._field.rows - 1) / 2, col, frame)

    def _columns(self, eye_distance_views: float | None) -> tuple[float, float]:
        """Columns of the left and the right eye; by default as a session would choose them before
        it sees a face. Raises UserError.
        """
        if eye_distance_views is None:
            chosen = parallax(self._config, self._field, self._config.camera.frame_px[0], None)
            eye_distance_views = min(chosen.views_between_eyes, self._last)
        if not 0 < eye_distance_views <= self._last:
            what = f"the scene has {self._field.cols} columns of views" + (
                "" if self._last else ", one eye's"
            )
            remedy = (
                f"use up to {self._last:g}"
                if self._last
                else "use a scene with two columns or more"
            )
            raise UserError(f"--apart {eye_distance_views:g}: {what}", remedy)
        return (self._last - eye_distance_views) / 2, (self._last + eye_distance_views) / 2

    def quilt(self, cols: int, rows: int) -> Picture:
        """cols * rows views, evenly from the first column to the last; tiles shrink if the quilt
        would exceed QUILT_PX.
        """
        field = self._field
        scale = min(1.0, QUILT_PX / (cols * field.width_px), QUILT_PX / (rows * field.height_px))
        width, height = (
            max(1, math.floor(scale * side)) for side in (field.width_px, field.height_px)
        )
        tiles = [
            cv2.resize(self._view(float(col)), (width, height), interpolation=cv2.INTER_AREA)
            for col in np.linspace(0, self._last, cols * rows)
        ]
        return np.vstack(
            [np.hstack(tiles[row * cols : (row + 1) * cols]) for row in reversed(range(rows))]
        )

    def eyes(self, eye_distance_views: float | None = None) -> tuple[Picture, Picture]:
        """The left and the right eye's view. Raises UserError."""
        left, right = self._columns(eye_distance_views)
        return self._view(left), self._view(right)

    def clip(
        self, form: str, eye_distance_views: float | None, seconds: float
    ) -> Iterator[Picture]:
        """One turn at RATE_HZ, whose last picture leads to the first. form: "sweep", "wiggle", or
        "pair", two views side by side that sweep. Raises UserError.
        """
        if form == "sweep":
            return self._swing(0.0, self._last, seconds)
        left, right = self._columns(eye_distance_views)
        if form == "wiggle":
            return self._swing(left, right, seconds)
        free = self._last - (right - left)
        eyes = (self._swing(first, first + free, seconds) for first in (0.0, right - left))
        return (np.hstack(pair) for pair in zip(*eyes, strict=True))

    def _swing(self, first: float, last: float, seconds: float) -> Iterator[Picture]:
        count = max(2, round(seconds * RATE_HZ))
        for number in range(count):
            share = (1 - math.cos(2 * math.pi * number / count)) / 2
            yield self._view(
                first + (last - first) * share, int(number * self._field.frame_rate_hz / RATE_HZ)
            )


def quilt_name(path: Path, cols: int, rows: int, aspect: float) -> Path:
    """path with the grid and aspect that quilt viewers read from a name; unchanged if it
    has them.
    """
    has_grid = re.search(r"_qs\d+x\d+", path.stem)
    return path if has_grid else path.with_stem(f"{path.stem}_qs{cols}x{rows}a{aspect:.2f}")


def pair_name(path: Path) -> Path:
    """path with the words by which players know a pair: _sbs for pictures, _LR for videos. .jps and
    .mpo need none.
    """
    if path.suffix.lower() in (".jps", ".mpo") or re.search(
        r"(?<![A-Za-z])(h?sbs|LR)(?![A-Za-z])", path.stem
    ):
        return path
    return path.with_stem(f"{path.stem}{'_LR' if path.suffix.lower() == '.mp4' else '_sbs'}")


def stereo_file(left: Picture, right: Picture, suffix: str) -> bytes:
    """The pair as .mpo (two pictures, left first; CIPA DC-007), or side by side: .jps (right eye
    first), .jpg, .png (left).
    """
    if suffix == ".mpo":
        first, second = (
            Image.fromarray(np.ascontiguousarray(eye[..., ::-1])) for eye in (left, right)
        )
        buffer = io.BytesIO()
        first.save(buffer, "MPO", save_all=True, append_images=[second], quality=JPEG_QUALITY)
        return buffer.getvalue()
    eyes = (right, left) if suffix == ".jps" else (left, right)
    coder = ".png" if suffix == ".png" else ".jpg"
    quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY] if coder == ".jpg" else []
    _, data = cv2.imencode(coder, np.hstack(eyes), quality)
    return data.tobytes()


def parse_tiles(text: str) -> tuple[int, int]:
    """(columns, rows) from COLSxROWS. Raises UserError."""
    cols, _, rows = text.partition("x")
    if not (
        cols.isdecimal()
        and rows.isdecimal()
        and 0 < int(cols) <= MAX_TILES
        and 0 < int(rows) <= MAX_TILES
    ):
        raise UserError(
            f"--tiles {text}: not COLSxROWS", f"use for example 8x6; 1 to {MAX_TILES} a side"
        )
    return int(cols), int(rows)


def check_clip(path: Path, count: int) -> None:
    """Raises UserError if path names no kind of clip of this many pictures that can be written
    here.
    """
    if path.suffix.lower() not in (".mp4", ".gif"):
        raise UserError(f"{path}: not .mp4 or .gif", "use for example boxes.mp4")
    if path.suffix.lower() == ".gif" and count > GIF_PICTURES:
        raise UserError(
            f"{path}: has {count} pictures; a GIF may have {GIF_PICTURES}",
            "make a shorter one, or an .mp4",
        )
    if path.suffix.lower() == ".mp4":
        require_encoder()


def write_clip(path: Path, pictures: Iterable[Picture], rate_hz: float) -> None:
    """Writes pictures, uint8 (height, width, 3) BGR of one size, to a path that `check_clip`
    allows.

    Raises UserError if the disk is full; path is then unchanged.
    """
    pictures = iter(pictures)
    first = next(pictures)
    try:
        with replaced(path, 0o644) as file:
            if path.suffix.lower() == ".gif":
                _write_gif(file, [first, *pictures], rate_hz)
                return
            writer = VideoWriter(Path(file.name), (first.shape[1], first.shape[0]), rate_hz)
            for picture in itertools.chain([first], pictures):
                writer.write(picture)
            writer.release()
    except OSError as error:
        raise write_error(path, error) from None


def _write_gif(file: IO[bytes], pictures: list[Picture], rate_hz: float) -> None:
    images = [Image.fromarray(np.ascontiguousarray(picture[..., ::-1])) for picture in pictures]
    # one palette for all: a palette per picture makes static parts flicker
    sample = Image.fromarray(np.vstack([np.asarray(image)[::4, ::4] for image in images]))
    palette = sample.quantize(256, dither=Image.Dither.NONE)
    first, *more = [image.quantize(palette=palette) for image in images]
    # unit of a GIF's delays; players slow down shorter ones
    hundredths = max(2, round(100 / rate_hz))
    first.save(
        file,
        "GIF",
        save_all=True,
        append_images=more,
        duration=10 * hundredths,
        loop=0,
    )
