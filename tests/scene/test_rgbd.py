"""A picture with its depth map becomes views around it: near moves most, and what was hidden is filled from behind."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene import layouts
from lfpipe.scene.missing_views import warped_disparity, warped_view
from lfpipe.scene.orientation import orient
from lfpipe.scene.packing import pack_scene
from tests.scene import made

AUTO = config.Scene()
PICTURE = made.views(1, 1, 96, 128, 1.0, -1.0)[0, 0]
DISPARITY = made.middle_disparity(96, 128, 1.0, -1.0)
DEPTH = np.repeat(((DISPARITY + 1) * 127).astype(np.uint8)[..., None], 3, axis=2)


def one(picture: np.ndarray, name: str = "x_rgbd.png") -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        made.write(folder / name, picture)
        return folder / name

    return make


def two(picture: str, depth: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        made.write(folder / picture, PICTURE)
        made.write(folder / depth, DEPTH[..., 0])
        return folder

    return make


FORMS = {
    "beside": one(np.hstack([PICTURE, DEPTH])),
    "depth first": one(np.hstack([DEPTH, PICTURE])),
    "below": one(np.vstack([PICTURE, DEPTH])),
    "two files": two("x.png", "x_depth.png"),
    "named by content": two("rgb.png", "depth.png"),
    "named before": two("photo.png", "depth_photo.png"),
    "named by a network": two("photo.png", "photo-dpt_beit_large_512.png"),
}


@pytest.mark.parametrize("form", FORMS)
def test_near_moves_to_the_left_as_the_camera_moves_to_the_right(tmp_path: Path, form: str) -> None:
    source = layouts.describe(FORMS[form](tmp_path), AUTO)
    assert (source.layout, source.rows, source.cols) == ("rgbd", 5, 9)
    assert np.array_equal(source.read(0, 2, 4), PICTURE)
    moved = source.read(0, 2, 6).astype(int)
    shift = round(2 * 0.5 * 0.008 * 128)
    near = DISPARITY == 1
    inner = near & np.roll(near, 5, axis=1) & np.roll(near, -5, axis=1)
    expected = np.roll(PICTURE, -shift, axis=1)
    y, x = np.nonzero(np.roll(inner, -shift, axis=1))
    assert np.abs(moved[y, x] - expected[y, x]).mean() < 3


def test_what_was_hidden_is_filled_from_behind() -> None:
    far, near = np.full((40, 60), 50, np.uint8), np.zeros((40, 60), bool)
    near[10:30, 20:40] = True
    picture, disparity = np.where(near, 200, far).astype(np.uint8), np.where(near, 2.0, -1.0).astype(np.float32)
    view = warped_view(picture, disparity, warped_disparity(disparity, 0, 3), 0, 3)
    assert (view == 200).sum() == pytest.approx(400, abs=45)
    assert not ((view > 60) & (view < 190)).sum() > 60


def test_a_depth_picture_becomes_a_scene(tmp_path: Path) -> None:
    path = FORMS["two files"](tmp_path / "s")
    field = pack_scene(path, config.Scene(cache_dir=str(tmp_path / "cache"), grid="3x3"))
    assert (field.rows, field.cols, field.disparity_source) == (3, 3, "truth")
    assert field.disparity_max_px == pytest.approx(0.512, abs=0.05)


@pytest.mark.parametrize("picture", [np.hstack([PICTURE, PICTURE]), np.hstack([PICTURE, np.full_like(PICTURE, 90)])])
def test_what_is_no_depth_is_refused(tmp_path: Path, picture: np.ndarray) -> None:
    made.write(tmp_path / "x.png", picture)
    with pytest.raises(UserError, match="depth"):
        layouts.describe(tmp_path / "x.png", config.Scene(layout="rgbd"))


def test_depth_in_false_colours_is_refused(tmp_path: Path) -> None:
    made.write(tmp_path / "x.png", PICTURE)
    made.write(tmp_path / "x_depth.png", cv2.applyColorMap(DEPTH[..., 0], cv2.COLORMAP_INFERNO))
    with pytest.raises(UserError, match="false colours") as caught:
        layouts.describe(tmp_path, AUTO)
    assert "in grey" in caught.value.remedy


@pytest.mark.parametrize("far_white", [False, True])
def test_white_that_stands_high_may_be_far(far_white: bool, tmp_path: Path) -> None:
    ramp = np.repeat(np.linspace(20, 230, 96).astype(np.uint8)[:, None], 128, axis=1)  # a floor: lower is nearer
    made.write(tmp_path / "s" / "x.png", PICTURE)
    made.write(tmp_path / "s" / "x_depth.png", 255 - ramp if far_white else ramp)
    found = orient(layouts.describe(tmp_path / "s", AUTO), AUTO)
    assert ("whether white is near" in found.undecided) == far_white and found.half_turn_sure != far_white
    for flip in ("auto", "both"):
        scene = config.Scene(cache_dir=str(tmp_path / flip), grid="3x3", flip=flip)
        disparity = pack_scene(tmp_path / "s", scene).disparity
        assert disparity is not None
        top, bottom = (disparity[0, 1, 1, row].mean() for row in (2, -2))
        assert (bottom > top) == (far_white == (flip == "both"))
