"""From pixels to pixels: a scene with known depth, photographed from known places, written in every
layout, packed, and seen through the glasses. Near objects must appear further right for the left
eye, and a viewer who moves must see them from there.
"""

from functools import lru_cache, partial
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from numpy.typing import NDArray

from lfpipe.config import Render, Scene
from lfpipe.config.tree import Method
from lfpipe.render.synthesis.compositor import Compositor
from lfpipe.render.synthesis.viewpoint import ViewSolver
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.packing import pack_scene
from tests.scene import made
from tests.scene.writers import Make, files, h5, stanford

Grid = NDArray[np.uint8]  # (rows, cols, height, width, 3), top left camera first

FOCAL_PX, FOCUS_MM, BASELINE_MM = 500.0, 1000.0, 10.0
NEAR_PX, FAR_PX = 2.0, -1.0  # disparities, per baseline
HEIGHT, WIDTH, RADIUS_PX = 96, 128, 13.0
EYES_PX, STEP_PX = 60.0, 30.0  # between the eyes, and per view: they look from two views apart
V, U = np.mgrid[0:HEIGHT, 0:WIDTH] - np.array([HEIGHT / 2, WIDTH / 2])[:, None, None]


@lru_cache(maxsize=4)
def photographs(rows: int, cols: int) -> Grid:
    """What cameras BASELINE_MM apart see, all aimed at the same rectangle FOCUS_MM away: a textured
    wall with a black disc on it and before it a bright disc. Rays are cast through each pixel;
    nothing here knows what a disparity map is.
    """
    out = np.empty((rows, cols, HEIGHT, WIDTH, 3), np.uint8)
    wall, front = (made.texture(2 * HEIGHT, 2 * WIDTH, seed).astype(float) for seed in (1, 3))

    def texels(
        texture: NDArray[np.float64], x: NDArray[np.float64], y: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        i, j = np.rint(y + HEIGHT).astype(int), np.rint(x + WIDTH).astype(int)
        return np.asarray(texture[i.clip(0, 2 * HEIGHT - 1), j.clip(0, 2 * WIDTH - 1)])

    for row, col in np.ndindex(rows, cols):
        camera_mm = (col - (cols - 1) / 2) * BASELINE_MM, (row - (rows - 1) / 2) * BASELINE_MM

        def meets(
            disparity_px: float, camera_mm: tuple[float, float] = camera_mm
        ) -> list[NDArray[np.float64]]:
            """(x, y) where the ray of each pixel meets the plane of that disparity, in px of it as
            the middle camera sees it.
            """
            at_mm = 1 / (disparity_px / (BASELINE_MM * FOCAL_PX) + 1 / FOCUS_MM)
            aimed = (U * FOCUS_MM / FOCAL_PX, V * FOCUS_MM / FOCAL_PX)
            return [
                (c + (a - c) * at_mm / FOCUS_MM) * FOCAL_PX / at_mm
                for a, c in zip(aimed, camera_mm, strict=True)
            ]

        x, y = meets(FAR_PX)
        view = 45 + 0.3 * texels(wall, x, y)
        view[np.hypot(x + 34, y + 14) < RADIUS_PX] = 8
        x, y = meets(NEAR_PX)
        inside = np.hypot(x - 18, y - 6) < RADIUS_PX
        view[inside] = (170 + 0.3 * texels(front, x, y))[inside]
        out[row, col] = np.rint(view)
    out.setflags(write=False)
    return out


# disparity of the middle view
TRUTH = np.where(np.hypot(U - 18, V - 6) < RADIUS_PX, NEAR_PX, FAR_PX).astype(np.float32)


def packed(layout: str, write: Make, folder: Path) -> LightField:
    (folder / layout).mkdir()
    write(folder / layout)
    field = pack_scene(folder / layout, Scene(cache_dir=str(folder / "cache")))
    assert field.manifest.layout == layout
    return field


def seen(
    compositor: Compositor,
    grid: tuple[int, int],
    bright: bool,
    alpha_px: float,
    right: float = 0,
    up: float = 0,
) -> NDArray[np.float64]:
    """(x, y) of the bright disc, or of the black one, for the left eye and for the right one, when
    the viewer has moved by px of the camera's picture. It shows them unmirrored: their left eye at
    larger x, a step to their right as one to the left.
    """
    x, y = 320 - right, 240 - up
    solver = ViewSolver(*grid, Render(), alpha_px, (320.0, 240.0), compositor.method)
    drawn = compositor.compose(*solver.views((x + EYES_PX / 2, y, x - EYES_PX / 2, y)))
    places = []
    for plane in (drawn[..., 2], drawn[..., 1]):  # red glass left, cyan right
        rows, cols = np.nonzero(plane > 145 if bright else plane < 26)
        assert len(cols) > 300, "the disc is in the picture"
        places.append((cols.mean(), rows.mean()))
    return np.array(places)


@pytest.mark.parametrize(
    ("layout", "write"),
    [
        (
            "stereo",
            files(
                shop_left_png=photographs(1, 2)[0, 0],
                shop_right_png=photographs(1, 2)[0, 1],
            ),
        ),
        (
            "rgbd",
            files(
                shop_png=photographs(1, 1)[0, 0],
                shop_depth_png=np.where(TRUTH > 0, 230, 60).astype(np.uint8),
            ),
        ),
    ],
)
def test_compositor_crosses_near_in_3d_photographs(
    layout: str, write: Make, tmp_path: Path
) -> None:
    field = packed(layout, write, tmp_path)
    compositor = Compositor(field, Render(anaglyph="colour"))
    near, far = (
        seen(compositor, (field.rows, field.cols), bright, EYES_PX) for bright in (True, False)
    )
    assert (near[0] - near[1])[0] > (far[0] - far[1])[0] + 0.5, (
        "the near disc is crossed against the far one"
    )


# One whose depth, and one whose order of views, has its own sense; that all others keep that order
# is shown in tests/scene.
@pytest.mark.parametrize(
    ("layout", "write"),
    [
        ("hci-old", h5(photographs(5, 5)[:, ::-1], depth=(10 / (TRUTH + 3)).astype(np.float32))),
        # shot from the right to the left and upwards: the coordinates say so
        ("stanford", stanford(photographs(5, 5)[::-1, ::-1])),
    ],
)
def test_compositor_crosses_near_and_shows_the_view_from_the_viewer(
    layout: str, write: Make, tmp_path: Path
) -> None:
    field = packed(layout, write, tmp_path)
    for method in get_args(Method):
        compositor = Compositor(field, Render(method=method, anaglyph="colour", zero_plane_px=0.0))
        for bright, disparity_px in ((True, NEAR_PX), (False, FAR_PX)):
            left, right = seen(compositor, (5, 5), bright, STEP_PX)
            moved_right = seen(compositor, (5, 5), bright, STEP_PX, right=STEP_PX)[0]
            moved_up = seen(compositor, (5, 5), bright, STEP_PX, up=STEP_PX)[0]
            close = partial(pytest.approx, abs=0.3 * NEAR_PX)
            assert left - right == close([2 * disparity_px, 0]), (
                f"{method}: near is crossed, far is not"
            )
            assert moved_right - left == close([-disparity_px, 0]), (
                f"{method}: seen from further right"
            )
            assert moved_up - left == close([0, disparity_px]), f"{method}: seen from higher up"
