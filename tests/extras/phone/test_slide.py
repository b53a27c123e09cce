"""A light field from a camera slid by hand: rectified, in order, or a reason why the clip does not
do.
"""

from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.extras.phone.slide import Slide, make_slide
from lfpipe.scene import layouts
from tests.scene import made
from tests.scene.test_plausibility import zoomed

SIZE = (240, 320)
FOCAL_PX = 1.2 * SIZE[1]
# the near moves to the left as the camera goes to the right
SLID = made.views(1, 17, *SIZE, 2.0, -1.0)[0]


def rotated(view: np.ndarray, degrees: np.ndarray) -> np.ndarray:
    """The view as the same camera sees it, turned by (pitch, yaw, roll)."""
    inner = np.array([[FOCAL_PX, 0, SIZE[1] / 2], [0, FOCAL_PX, SIZE[0] / 2], [0, 0, 1.0]])
    turn = inner @ cv2.Rodrigues(np.radians(degrees))[0] @ np.linalg.inv(inner)
    return np.asarray(
        cv2.warpPerspective(
            view, turn, SIZE[::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
        )
    )


def shaken(views: np.ndarray, degrees: float, seed: int = 1) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.normal(0, 1, (len(views), 3)), axis=0)
    walk = (walk - walk.mean(axis=0)) / np.abs(walk).max()
    return [
        rotated(view, degrees * (turn + rng.normal(0, 0.2, 3)))
        for view, turn in zip(views, walk, strict=True)
    ]


def slide(folder: Path, views: list[np.ndarray]) -> Slide:
    for number, view in enumerate(views):
        made.write(folder / "clip" / f"f{number:03d}.png", view)
    return make_slide(folder / "clip", folder / "out", lambda *_: None)


def vertical_px(folder: Path) -> float:
    """95th percentile of the vertical motion of corners between neighbouring views of a
    made scene.
    """
    views = [made.read(path, cv2.IMREAD_GRAYSCALE) for path in sorted(folder.glob("*.png"))]
    found = []
    for a, b in pairwise(views):
        start = np.asarray(cv2.goodFeaturesToTrack(a, 300, 0.01, 6))
        there, ok, _ = cv2.calcOpticalFlowPyrLK(a, b, start, start.copy(), winSize=(15, 15))
        back, _, _ = cv2.calcOpticalFlowPyrLK(b, a, there, there.copy(), winSize=(15, 15))
        good = (ok.ravel() == 1) & (np.linalg.norm(back - start, axis=2).ravel() < 0.1)
        found.append(np.abs((there - start)[good, 0, 1]))
    return float(np.percentile(np.concatenate(found), 95))


@pytest.mark.parametrize(("degrees", "backwards"), [(0.0, True), (0.6, False)])
def test_a_shaken_slide_becomes_a_rectified_row(
    tmp_path: Path, degrees: float, backwards: bool
) -> None:
    found = slide(tmp_path, shaken(SLID[::-1] if backwards else SLID, degrees))
    assert found.residual_px <= 0.5
    assert vertical_px(tmp_path / "out") <= 0.5
    assert found.views >= 7
    assert found.order_sure or degrees == 0.0, (
        "there, 6 places of 74 speak against the order: either end may be the left one"
    )
    source = layouts.describe(tmp_path / "out", config.Scene())
    assert (source.rows, source.cols) == (1, found.views)
    assert near_moves_to_the_left(tmp_path / "out") or not found.order_sure


PHYSICAL = made.views(1, 17, *SIZE, 3.0, 0.6)[0]  # all moves to the left, the near the most


@pytest.mark.parametrize(("kept_px", "backwards"), [(3.0, True), (-1.0, False)])
def test_a_camera_that_is_turned_while_it_slides_does_not_exchange_near_and_far(
    tmp_path: Path, kept_px: float, backwards: bool
) -> None:
    """kept_px: motion per view of what is kept in the middle."""
    angles = np.degrees(np.arctan(kept_px * (np.arange(17) - 8) / FOCAL_PX))
    views = [
        rotated(view, np.array([0, angle, 0])) for view, angle in zip(PHYSICAL, angles, strict=True)
    ]
    row = slide(tmp_path, views[::-1] if backwards else views)
    assert row.order_sure
    assert near_moves_to_the_left(tmp_path / "out")


def near_moves_to_the_left(folder: Path) -> bool:
    """Whether the near shape of a made row moves to the left of the wall."""
    source = layouts.describe(folder, config.Scene())
    first, last = (source.read(0, 0, col)[..., 1] for col in (0, source.cols - 1))
    flow = cv2.calcOpticalFlowFarneback(
        first, last, np.zeros((*first.shape, 2), np.float32), 0.5, 4, 21, 5, 7, 1.5, 0
    )
    height, width = first.shape
    near = flow[int(0.6 * height), int(0.55 * width) : int(0.65 * width), 0].mean()
    return bool(near < np.median(flow[: height // 8, :, 0]))


BASE = SLID[8]
CLIPS = {
    "still": ([BASE] * 9, "turned, not slid, or hardly moved"),
    "turned": (
        [rotated(BASE, np.array([0, angle, 0])) for angle in np.linspace(-4, 4, 9)],
        "turned, not slid",
    ),
    "up and down": (list(made.views(17, 1, *SIZE, 2.0, -1.0)[:, 0]), "up and down"),
    "smeared": ([cv2.blur(view, (41, 1)) for view in SLID], "blurred"),
    "unrelated": ([made.texture(*SIZE, seed) for seed in range(9)], "too little detail"),
    "short": ([BASE] * 3, "too few"),
    "zoomed": ([zoomed(BASE, 1.005**k) for k in range(17)], "the scale changed by"),
    "small": ([np.ascontiguousarray(view[:, 100:290]) for view in SLID], "need a width of 200"),
}


@pytest.mark.parametrize("clip", CLIPS)
def test_a_clip_that_does_not_do_is_refused_with_the_reason(tmp_path: Path, clip: str) -> None:
    views, why = CLIPS[clip]
    with pytest.raises(UserError, match=why) as caught:
        slide(tmp_path, views)
    assert caught.value.remedy
    assert not (tmp_path / "out").exists()
