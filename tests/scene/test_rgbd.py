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
from lfpipe.scene.packing import pack_scene
from lfpipe.scene.source import SceneSource
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


FLOOR = np.repeat(np.linspace(20, 230, 96).astype(np.uint8)[:, None], 128, axis=1)  # brighter below, where a floor is nearer


def relief(source: SceneSource) -> tuple[float, float]:
    """Disparity above and below in the middle view."""
    disparity = source.truth[source.rows // 2, source.cols // 2]()
    return float(disparity[2].mean()), float(disparity[-3].mean())


@pytest.mark.parametrize("black_near", [False, True])
def test_what_stands_lower_says_whether_white_is_near(black_near: bool, tmp_path: Path) -> None:
    made.write(tmp_path / "x.png", PICTURE)
    made.write(tmp_path / "x_depth.png", 255 - FLOOR if black_near else FLOOR)
    source = layouts.describe(tmp_path, AUTO)
    above, below = relief(source)
    assert below > above and bool(source.doubt) == black_near


def test_without_a_cue_white_is_near_and_the_doubt_is_told(tmp_path: Path) -> None:
    source = layouts.describe(FORMS["two files"](tmp_path), AUTO)
    assert "whether white is near" in source.doubt and "half_turn" in source.doubt


@pytest.mark.parametrize("per_m", [1000, 5000, 256])
def test_sixteen_bits_are_a_distance_with_holes(per_m: int, tmp_path: Path) -> None:
    distance = (per_m * np.linspace(4, 1, 96)[:, None] * np.ones(128)).astype(np.uint16)  # Kinect, RealSense; TUM; KITTI
    holes = np.zeros(distance.shape, bool)
    holes[60:70, 30:50] = holes[:, :6] = True
    made.write(tmp_path / "x.png", PICTURE)
    made.write(tmp_path / "x_depth.png", np.where(holes, 0, distance).astype(np.uint16))
    source = layouts.describe(tmp_path, AUTO)
    above, below = relief(source)
    disparity = source.truth[2, 4]()
    assert below > above and not source.doubt and "distances" in source.notes[0]
    assert np.abs(disparity[62:68, 32:48] - disparity[62:68, 60:76]).max() < 0.2 * (below - above)  # no pit, no peak


def test_sixteen_bits_over_the_whole_range_are_no_distance(tmp_path: Path) -> None:
    made.write(tmp_path / "x.png", PICTURE)
    made.write(tmp_path / "x_depth.png", ((FLOOR.astype(np.float32) - 20) / 210 * 65535).astype(np.uint16))
    above, below = relief(layouts.describe(tmp_path, AUTO))
    assert below > above


def test_two_files_of_one_name_are_a_picture_and_its_depth_or_one_picture(tmp_path: Path) -> None:
    made.write(tmp_path / "car" / "car.jpg", PICTURE)
    made.write(tmp_path / "car" / "car.png", FLOOR)
    source = layouts.describe(tmp_path / "car", AUTO)
    assert (source.layout, [path.name for path in source.files]) == ("rgbd", ["car.jpg", "car.png"])
    for name, picture in (("moon", PICTURE[..., 1]), ("sun", PICTURE)):
        made.write(tmp_path / name / f"{name}.jpg", picture)
        made.write(tmp_path / name / f"{name}.png", picture)
        source = layouts.describe(tmp_path / name, AUTO)
        assert (source.layout, source.files) == ("picture", (tmp_path / name / f"{name}.png",))
        assert any(f"{name}.jpg" in note for note in source.notes)
    made.write(tmp_path / "grey" / "a.jpg", PICTURE[..., 1])
    made.write(tmp_path / "grey" / "a.png", FLOOR)
    source = layouts.describe(tmp_path / "grey", AUTO)
    assert [path.name for path in source.files] == ["a.jpg", "a.png"] and "whether a.png is the depth" in source.doubt


def test_a_photograph_of_a_phone_is_made_small(tmp_path: Path) -> None:
    made.write(tmp_path / "x.jpg", made.texture(1500, 2000, 1))
    made.write(tmp_path / "x_depth.png", cv2.resize(FLOOR, (640, 480)))
    source = layouts.describe(tmp_path, AUTO)
    assert source.height_px * source.width_px <= 710_000 and any("for speed" in note for note in source.notes)
