"""Frames of a picture beside its depth: read by the words of the stills' layout, and drawn."""

from collections.abc import Callable
from pathlib import Path

import attrs
import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from lfpipe.capture.recordings import open_recording
from lfpipe.live.depth_picture import SPAN, DepthPicture
from lfpipe.live.field import LiveViews
from lfpipe.live.records import disparity_dtype
from lfpipe.render.synthesis.compositor import ViewRenderer
from lfpipe.render.synthesis.scoring import psnr_db
from tests.live import made
from tests.render import rendered
from tests.support.films import write_film

HEIGHT, WIDTH = 96, 128
LIVE = attrs.evolve(made.source(1, 2, HEIGHT, WIDTH), depth=True)
# steps of the drawn scene's grid that are one of the live one's: wall and square are then as far
# apart in disparity as the ends of the depth
STEPS = SPAN * WIDTH / (rendered.NEAR - rendered.FAR)
# the disparity halfway between them, which is 0 in the live field: there, views are moved by it
MIDDLE_PX = STEPS * (rendered.NEAR + rendered.FAR) / 2


def view(col: float) -> NDArray[np.uint8]:
    """The exact view at a column of the live grid, uint8 (height, width, 3) BGR."""
    planes = rendered.view(0.0, (col - 0.5) * STEPS, HEIGHT, WIDTH)
    return np.ascontiguousarray(np.moveaxis(planes, 0, -1)[..., ::-1])


def nearness() -> NDArray[np.float32]:
    """Of the view in the middle: 0 for the wall, 1 for the square."""
    near = np.zeros((HEIGHT, WIDTH), np.float32)
    low, high = map(int, rendered.SQUARE)
    near[low:high, low:high] = 1
    return near


def as_grey(near: NDArray[np.float32]) -> NDArray[np.uint8]:
    return np.repeat((40 + 180 * near).astype(np.uint8)[..., None], 3, axis=2)


def as_hue(near: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Red is near. The hue of noise around red is on both sides of it."""
    hue = (180 * (1 - near)).astype(np.int64)
    noise = np.random.default_rng(1).integers(-3, 4, near.shape)
    hsv = np.dstack([(hue + noise) % 256, np.full_like(hue, 255), np.full_like(hue, 255)])
    return np.asarray(cv2.cvtColor(hsv.astype(np.uint8), cv2.COLOR_HSV2BGR_FULL), np.uint8)


def by_video(frame: NDArray[np.uint8], folder: Path) -> NDArray[np.uint8]:
    """As a Motion JPEG camera or file delivers it."""
    read = open_recording(write_film(folder / "clip.avi", [frame])).read(0)
    assert read is not None
    return read.picture


def by_jpeg(frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """As a camera sends it."""
    data = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, 95])[1]
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)


@pytest.mark.parametrize("stored", [as_grey, as_hue])
@pytest.mark.parametrize("depth_first", [False, True])
@pytest.mark.parametrize("above", [False, True])
def test_depth_of_a_frame_gives_the_views_of_both_eyes(
    stored: Callable[[NDArray[np.float32]], NDArray[np.uint8]], depth_first: bool, above: bool
) -> None:
    halves = [view(0.5), stored(nearness())]
    frame = by_jpeg(np.concatenate(halves[:: -1 if depth_first else 1], axis=0 if above else 1))
    live = attrs.evolve(LIVE, tiles_across=1 if above else 2, frame_px=frame.shape[1::-1])
    picture = DepthPicture(live)
    found = picture.read(frame, inverted=False)
    assert picture.swapped == depth_first and not picture.unclear_frames
    exact_px = (nearness() - 0.5)[::2, ::2] * SPAN * WIDTH
    error_px = np.abs(found.maps[0, 1] * found.step_px - exact_px)
    # the hue of a JPEG varies by a twentieth of its range
    assert np.median(error_px) < (0.1 if stored is as_grey else 0.07 * SPAN * WIDTH)
    assert np.mean(error_px > 0.1 * SPAN * WIDTH) < 0.05
    record = found.write(np.zeros((), disparity_dtype(live)), swapped=picture.swapped)
    shown = LiveViews(live, "demo").show(frame, [(0, 0), (0, 1)], record, 0)
    for eye, col in enumerate((0.1, 0.9)):
        drawn = ViewRenderer(shown, "warp2", eye=eye).render(0, col)
        exact = np.roll(view(col), round(MIDDLE_PX * (col - 0.5)), axis=1)
        better_db = 7 if stored is as_grey else 3  # a JPEG's colours of hue run into the picture
        assert _psnr_db(drawn, exact) > _psnr_db(view(0.5), exact) + better_db


def _psnr_db(picture: NDArray[np.generic], exact: NDArray[np.uint8]) -> float:
    """Away from the sides, where the views end."""
    return psnr_db(float(np.mean((picture.astype(float) - exact)[:, 8:-8] ** 2)))


@pytest.mark.parametrize("size", [1, 2])
def test_depth_is_told_apart_in_video(tmp_path: Path, size: int) -> None:
    halves = [as_grey(nearness()), view(0.5)]
    frame = np.hstack([cv2.resize(half, None, fx=size, fy=size) for half in halves])
    picture = DepthPicture(attrs.evolve(LIVE, frame_px=frame.shape[1::-1]))
    picture.read(by_video(np.asarray(frame, np.uint8), tmp_path), inverted=False)
    assert picture.swapped and not picture.unclear_frames


def test_unmeasured_depth_is_behind_its_neighbours_and_dark_frames_are_reported() -> None:
    picture = DepthPicture(LIVE)
    black = np.zeros((HEIGHT, 2 * WIDTH, 3), np.uint8)
    for number in range(1, 4):
        picture.read(black, inverted=False)
        assert picture.unclear_frames == number
    hue = as_hue(nearness())
    hue[40:48, 30:40] = 0  # within the square and the wall
    found = picture.read(np.hstack([view(0.5), hue]), inverted=False)
    assert picture.unclear_frames == 3
    hole = found.maps[0, 0][20:24, 15:20] * found.step_px
    assert (hole < 0).all()


def test_inverted_depth_is_the_opposite() -> None:
    frame = np.hstack([view(0.5), as_grey(nearness())])
    plain, turned = (DepthPicture(LIVE).read(frame, inverted) for inverted in (False, True))
    total = plain.maps[0, 0].astype(int) + turned.maps[0, 0]
    assert np.abs(total * plain.step_px).max() < 0.3


def test_a_flash_of_depth_moves_little() -> None:
    picture = DepthPicture(LIVE)
    frame = np.hstack([view(0.5), as_grey(nearness())])
    before = picture.read(frame, inverted=False)
    flash = np.hstack([view(0.5), as_grey(np.ones_like(nearness()) * 1.19)])
    picture.read(flash, inverted=False)
    after = picture.read(frame, inverted=False)
    moved = np.abs(after.maps[0, 0] * after.step_px - before.maps[0, 0] * before.step_px)
    assert moved.max() < 0.05 * SPAN * WIDTH
