"""Blocks of 2x2 pixels against the same thing done pixel by pixel."""

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from lfpipe.render.blocks import Blocks, bands_of, places, size_of

SIZES = [(1, 1), (1, 6), (5, 1), (2, 2), (7, 9), (8, 12)]


def picture(height: int, width: int) -> NDArray[np.uint8]:
    return np.random.default_rng(height * 100 + width).integers(0, 256, (height, width), dtype=np.uint8)


def through(plane: NDArray[np.uint8], dx: NDArray[np.float32], dy: NDArray[np.float32]) -> NDArray[np.uint8]:
    """plane, each block displaced by its (dx, dy)."""
    subject = Blocks(*plane.shape)
    x, y = places(*plane.shape)
    x, y = x + dx, y + dy
    drawn, again = (np.empty((*x.shape, 4), np.uint8) for _ in range(2))
    out, banded = (np.full(plane.shape, 99, np.uint8) for _ in range(2))
    most_px = float(np.abs(dy).max())
    subject.sample(plane, x, subject.reach(slice(0, len(y)), y, most_px), drawn)
    subject.pixels(drawn, out)
    for band in bands_of(len(y), 3, 1):  # of one row each
        subject.sample(plane, x[band], subject.reach(band, y[band], most_px), again[band])
        subject.pixels(again[band], banded[2 * band.start : 2 * band.stop])
    np.testing.assert_array_equal(again, drawn)
    np.testing.assert_array_equal(banded, out)
    return out


@settings(max_examples=60)
@given(st.sampled_from(SIZES), st.integers(0, 1000), st.sampled_from([0.0, 0.6, 3.0, 100.0]))
def test_blocks_sample_as_pixels_do_even_beyond_the_border(size: tuple[int, int], seed: int, reach_px: float) -> None:
    height, width = size
    plane = picture(height, width)
    rng = np.random.default_rng(seed)
    dx, dy = rng.uniform(-reach_px, reach_px, (2, *size_of(height, width))).astype(np.float32)
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    each_x, each_y = (np.repeat(np.repeat(d, 2, axis=0), 2, axis=1)[:height, :width] for d in (dx, dy))
    wanted = cv2.remap(plane, x + each_x, y + each_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    error = np.abs(through(plane, dx, dy).astype(int) - wanted).max()
    assert error <= (reach_px > 0), "the margin shifts the rounding of coordinates; where nothing moves the plane comes back"


def test_large_planes_are_sampled_in_bands_that_cover_them() -> None:
    assert bands_of(256, 4096) == [slice(0, 256)], "512x512 stays whole"
    bands = bands_of(540, 8 * 1920)
    assert len(bands) > 4 and [band.start for band in bands[1:]] == [band.stop for band in bands[:-1]] and bands[-1].stop == 540
