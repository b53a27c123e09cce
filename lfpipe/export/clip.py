"""Short videos: MP4 that any player opens, and GIF."""

from collections.abc import Iterable
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.files.output import MARK, finished_output
from lfpipe.files.video_writer import VideoWriter, encoder_name, write_error

SUFFIXES = (".mp4", ".gif")
GIF_PICTURES = 300  # a GIF is held in memory


def check_clip(path: Path, count: int) -> None:
    """Raises UserError if path names no kind of clip of this many pictures that can be written here."""
    if path.suffix.lower() not in SUFFIXES:
        raise UserError(f"{path}: not .mp4 or .gif", "for example boxes.mp4")
    if path.suffix.lower() == ".gif" and count > GIF_PICTURES:
        raise UserError(f"{path}: {count} pictures, a GIF may have {GIF_PICTURES}", "a shorter one, or .mp4")
    if path.suffix.lower() == ".mp4":
        encoder_name()


def write_clip(path: Path, pictures: Iterable[NDArray[np.uint8]], rate_hz: float) -> int:
    """Writes pictures, uint8 (height, width, 3) BGR of one size, to a path that `check_clip` allows; returns how many.

    Raises UserError if the disk is full; path is then unchanged.
    """
    count = 0
    try:
        with finished_output(path, 0o644) as output:
            if path.suffix.lower() == ".gif":
                return _write_gif(output.file, list(pictures), rate_hz)
            writer: VideoWriter | None = None
            for picture in pictures:
                size_px = picture.shape[1], picture.shape[0]
                writer = writer or VideoWriter(output.beside, size_px, rate_hz)
                writer.write(picture)
                count += 1
            if writer is not None:
                writer.release(output.beside)
    except OSError as error:
        raise write_error(path, error) from None
    return count


def _write_gif(file: IO[bytes], pictures: list[NDArray[np.uint8]], rate_hz: float) -> int:
    from PIL import Image  # comes with matplotlib

    images = [Image.fromarray(np.ascontiguousarray(picture[..., ::-1])) for picture in pictures]
    # one palette for all: a palette per picture makes static parts flicker
    sample = Image.fromarray(np.vstack([np.asarray(image)[::4, ::4] for image in images]))
    palette = sample.quantize(256, dither=Image.Dither.NONE)
    indexed = [image.quantize(palette=palette) for image in images]
    hundredths = max(2, round(100 / rate_hz))  # unit of a GIF's delays; players slow down shorter ones
    more = {"append_images": indexed[1:], "duration": 10 * hundredths, "loop": 0, "comment": MARK}
    indexed[0].save(file, "GIF", save_all=True, **more)
    return len(images)
