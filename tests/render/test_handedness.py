"""From pixels to pixels: a scene with known depth, photographed from known places, written in every layout, packed, and seen
through the glasses. Near objects must appear further right for the left eye, and a viewer who moves must see them from there."""

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from lfpipe.config import Render, Scene
from lfpipe.render.compositor import Compositor
from lfpipe.render.viewpoint import ViewSolver
from lfpipe.scene.packing import pack_scene
from tests.scene import made

Grid = NDArray[np.uint8]  # (rows, cols, height, width, 3), top left camera first

FOCAL_PX, FOCUS_MM, BASELINE_MM = 500.0, 1000.0, 10.0
HEIGHT, WIDTH = 96, 128
RADIUS_PX = 13.0
EYES_PX, STEP_PX = 60.0, 30.0  # between the eyes, and per view: they look from two views apart


def depth_mm(disparity_px: float) -> float:
    """Distance of an object that moves by disparity_px to the left when the camera moves a baseline to the right."""
    return 1 / (disparity_px / (BASELINE_MM * FOCAL_PX) + 1 / FOCUS_MM)


@lru_cache(maxsize=4)
def photographs(rows: int, cols: int, near_px: float = 2.0, far_px: float = -1.0) -> Grid:
    """What cameras BASELINE_MM apart see, all aimed at the same rectangle FOCUS_MM away: a textured wall with a black disc on it
    and before it a bright disc. Rays are cast through each pixel; nothing here knows what a disparity map is."""
    out = np.empty((rows, cols, HEIGHT, WIDTH, 3), np.uint8)
    v, u = (np.mgrid[0:HEIGHT, 0:WIDTH] - np.array([HEIGHT / 2, WIDTH / 2])[:, None, None]).astype(float)
    wall, front = (made.texture(2 * HEIGHT, 2 * WIDTH, seed).astype(float) for seed in (1, 3))

    def texels(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        low, size = np.array([HEIGHT, WIDTH]), np.array([2 * HEIGHT, 2 * WIDTH])
        i, j = (np.rint(value + at).clip(0, n - 1).astype(np.intp) for value, at, n in zip((y, x), low, size, strict=True))
        return i, j

    for row in range(rows):
        for col in range(cols):
            right_mm, down_mm = (col - (cols - 1) / 2) * BASELINE_MM, (row - (rows - 1) / 2) * BASELINE_MM

            def meets(at_mm: float, right: float = right_mm, down: float = down_mm) -> list[NDArray[np.float64]]:
                """Where the ray of each pixel meets the plane at_mm away, in px of that plane as the middle camera sees it."""
                aimed = (u * FOCUS_MM / FOCAL_PX, v * FOCUS_MM / FOCAL_PX)
                return [(c + (a - c) * at_mm / FOCUS_MM) * FOCAL_PX / at_mm for a, c in zip(aimed, (right, down), strict=True)]

            x, y = meets(depth_mm(far_px))
            view = 45 + 0.3 * wall[texels(x, y)]
            view[np.hypot(x + 34, y + 14) < RADIUS_PX] = 8
            x, y = meets(depth_mm(near_px))
            inside = np.hypot(x - 18, y - 6) < RADIUS_PX
            view[inside] = (170 + 0.3 * front[texels(x, y)])[inside]
            out[row, col] = np.rint(view)
    out.setflags(write=False)
    return out


def truth(near_px: float = 2.0, far_px: float = -1.0) -> NDArray[np.float32]:
    """Disparity of the middle view."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH] - np.array([HEIGHT / 2, WIDTH / 2])[:, None, None]
    return np.where(np.hypot(u - 18, v - 6) < RADIUS_PX, near_px, far_px).astype(np.float32)


def hci(folder: Path, grid: Grid) -> Path:
    (folder / "parameters.cfg").write_text("[extrinsics]\nnum_cams_x = 5\nnum_cams_y = 5\n")
    return made.write_grid(folder, grid, "input_Cam{n:03d}.png")


def hci_old(folder: Path, grid: Grid) -> Path:
    with h5py.File(folder / "lf.h5", "w") as file:
        file["LF"] = grid[:, ::-1]
        file["GT_DEPTH"] = np.broadcast_to((0.5 * 20 / (truth() + 3)).astype(np.float32), (5, 5, HEIGHT, WIDTH))
        file.attrs.update({"dH": 0.5, "focalLength": 20.0, "shift": 3.0, "hRes": HEIGHT})
    return folder


def hci_text(folder: Path, grid: Grid) -> Path:
    values = {"xRes": WIDTH, "yRes": HEIGHT, "hRes": 5, "vRes": 5, "dH": 0.5, "shift": 3, "focalLength": 20}
    (folder / "attributes.dat").write_text("".join(f"{value:e} //{name}\n" for name, value in values.items()))
    (folder / "depth.bin").write_bytes((10 / (truth() + 3)).astype("<f4").tobytes())
    made.write_grid(folder / "lf", grid, "{r:02d}_{c:02d}.png")
    return folder


def stanford(folder: Path, grid: Grid) -> Path:
    for row in range(5):
        for col in range(5):  # shot from the right to the left and upwards: the coordinates say so
            name = f"out_{row:02d}_{col:02d}_{-300 - 8.5 * row:.4f}_{1100 - 8.6 * col:.4f}_.png"
            made.write(folder / name, grid[4 - row, 4 - col])
    return folder


def stereo(folder: Path, grid: Grid) -> Path:
    made.write(folder / "shop_left.png", grid[0, 0])
    made.write(folder / "shop_right.png", grid[0, 1])
    return folder


def rgbd(folder: Path, grid: Grid) -> Path:
    made.write(folder / "shop.png", grid[0, 0])
    near = truth() > 0
    made.write(folder / "shop_depth.png", np.repeat(np.where(near, 230, 60).astype(np.uint8)[..., None], 3, axis=2))
    return folder


# Layouts whose order of views or depth has its own sense; that all others keep the order of views is shown in tests/scene.
WRITTEN: dict[str, Callable[[Path, Grid], Path]] = {
    "hci": hci, "hci-old": hci_old, "hci-text": hci_text, "stanford": stanford,
}  # fmt: skip


def place(plane: NDArray[np.uint8], bright: bool) -> NDArray[np.float64]:
    """(x, y) of the bright disc, or of the black one, in one eye's plane of the picture."""
    y, x = np.nonzero(plane > 145 if bright else plane < 26)
    assert len(x) > 300, "the disc is in the picture"
    return np.array([x.mean(), y.mean()])


PHOTOGRAPHS = {"stereo": (stereo, 2), "rgbd": (rgbd, 1)}  # and how many views there are of it


@pytest.mark.parametrize("layout", PHOTOGRAPHS)
def test_near_is_crossed_in_3d_photographs(layout: str, tmp_path: Path) -> None:
    write, cols = PHOTOGRAPHS[layout]
    field = pack_scene(write(tmp_path, photographs(1, cols)), Scene(cache_dir=str(tmp_path / "cache")))
    assert field.manifest["layout"] == layout
    how = Render(method="auto", anaglyph="colour")
    eyes = [[320 + EYES_PX / 2, 240], [320 - EYES_PX / 2, 240]]
    solver = ViewSolver(field.rows, field.cols, how, EYES_PX, (320.0, 240.0))
    drawn = Compositor(field, how).compose(*solver.views(tuple(np.ravel(eyes).tolist())))
    apart_px = [(place(drawn[..., 2], bright) - place(drawn[..., 1], bright))[0] for bright in (True, False)]
    assert apart_px[0] > apart_px[1] + 0.5, "the near disc is crossed against the far one"


@pytest.mark.parametrize("layout", WRITTEN)
def test_near_is_crossed_and_the_viewer_sees_from_where_they_are(layout: str, tmp_path: Path) -> None:
    rows, cols, near_px, far_px = 5, 5, 2.0, -1.0
    folder = tmp_path / layout
    folder.mkdir()
    scene = WRITTEN[layout](folder, photographs(rows, cols, near_px, far_px))
    field = pack_scene(scene, Scene(cache_dir=str(tmp_path / "cache")))
    assert (field.manifest["layout"], field.rows, field.cols) == (layout, rows, cols)
    for method in ("nearest", "auto"):
        how = Render(method=method, anaglyph="colour", zero_plane_px=0.0)
        compositor = Compositor(field, how)

        def seen(
            right_px: float, up_px: float, bright: bool, how: Render = how, compositor: Compositor = compositor
        ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
            """Where the disc stands for the left eye and for the right one. The camera's picture shows the viewer unmirrored:
            their left eye at larger x, a step to their right as one to the left, and upwards is to smaller y."""
            eyes = [[320 + EYES_PX / 2 - right_px, 240 - up_px], [320 - EYES_PX / 2 - right_px, 240 - up_px]]
            solver = ViewSolver(rows, cols, how, STEP_PX, (320.0, 240.0), compositor.method)
            drawn = compositor.compose(*solver.views(tuple(np.ravel(eyes).tolist())))
            return place(drawn[..., 2], bright), place(drawn[..., 1], bright)  # red glass left, cyan right

        close = 0.3 * near_px
        for bright, disparity_px in ((True, near_px), (False, far_px)):
            left, right = seen(0, 0, bright)
            moved_right, moved_up = seen(STEP_PX, 0, bright)[0], seen(0, STEP_PX, bright)[0]
            step_px = disparity_px if cols > 1 else 0.0
            rise_px = disparity_px if rows > 1 else 0.0
            assert left - right == pytest.approx([2 * step_px, 0], abs=close), f"{method}: near is crossed, far is not"
            assert moved_right - left == pytest.approx([-step_px, 0], abs=close), f"{method}: seen from further right"
            assert moved_up - left == pytest.approx([0, rise_px], abs=close), f"{method}: seen from higher up"
