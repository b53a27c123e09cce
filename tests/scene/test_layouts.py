"""Each layout from files that the test writes: detected without being named, every view read where
it belongs.
"""

from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import scipy.io

from lfpipe import config
from lfpipe.scene import layouts
from lfpipe.scene.layouts._grid import Tiling
from lfpipe.scene.layouts._likeness import find_tiles
from lfpipe.scene.orientation import orient
from lfpipe.scene.source import SceneSource, read_pfm
from tests.scene import made
from tests.scene.writers import (
    HCI,
    Make,
    files,
    grid,
    h5,
    numbered,
    one,
    stanford,
    together,
    walk,
)

AUTO = config.Scene()
GRID, SQUARE, QUILT = made.views(3, 4, 64, 80), made.views(3, 3, 64, 80), made.views(1, 12, 64, 80)
TRUTH = made.middle_disparity(64, 80)
CFG = (
    "[intrinsics]\nfocal_length_mm = 100\nimage_resolution_x_px = 80\nimage_resolution_y_px ="
    " 64\nsensor_size_mm = 35\n[extrinsics]\nnum_cams_x = {}\nnum_cams_y = {}\nbaseline_mm ="
    " 25\nfocus_distance_m = 4.25\n[meta]\nscene = %(odd)s\n"
)


def described(path: Path, layout: str, scene: config.Scene = AUTO) -> SceneSource:
    source = layouts.describe(path, scene)
    assert source.layout == layout
    return source


STANFORD = "out_{r:02d}_{c:02d}_{y:.6f}_{x:.6f}"
LINE, LARGE = made.views(1, 9, 96, 128), made.views(5, 7, 96, 128)
UPRIGHT, TEN = made.views(9, 1, 96, 128), made.views(10, 10, 60, 72, 0.4, -0.2)
DEPTH = (0.5 * 20 / (TRUTH + 3)).astype(np.float32)
DOWNWARDS = QUILT[0].reshape(3, 4, *QUILT.shape[2:])


def in_the_dark(views: np.ndarray, channels: int = 3, sides: int = 1) -> np.ndarray:
    """Views of a lens whose outer ones are dark; channels: the fourth holds weights."""
    around = ((sides, sides), (sides, sides), (0, 0), (0, 0), (0, channels - 3))
    return np.pad(views, around)


def lenslets(views: np.ndarray) -> np.ndarray:
    """Not a multiple of the views: filled up at the end."""
    rows, cols, height, width, _ = views.shape
    return views.transpose(2, 0, 3, 1, 4).reshape(height * rows, width * cols, 3)[:-2]


def decoded(folder: Path) -> Path:
    """As LFToolbox writes it: linear light, weights, and dark sides."""
    path = folder / "IMG__Decoded.mat"
    whole = in_the_dark(made.views(5, 5, 48, 64), 4).astype(np.uint16) * 257
    write_mat(path, whole, True, chunks=True, compression="gzip")
    with h5py.File(path, "a") as file:
        file["LFMetadata"] = np.zeros(1)
    return path


FORMS: dict[str, tuple[str, Make, np.ndarray]] = {  # layout, files, views in canonical order
    **{
        f"hci, {rows}x{cols}": ("hci", grid(made.views(rows, cols), HCI), made.views(rows, cols))
        for rows, cols in ((1, 9), (3, 5), (4, 4), (9, 1))
    },
    "hci, parameters": ("hci", grid(GRID, HCI, parameters_cfg=CFG.format(4, 3)), GRID),
    "hci-old": ("hci-old", together(h5(SQUARE[:, ::-1], depth=DEPTH)), SQUARE),
    "an .h5 of one's own": (
        "hci-old",
        lambda f: h5py.File(f / "my.h5", "w").create_dataset("LF", data=SQUARE) and f,
        SQUARE,
    ),
    "stanford": ("stanford", stanford(GRID[::-1, ::-1]), GRID),
    "stanford, copies": (
        "stanford",
        stanford(GRID[:, ::-1], "jpg_" + STANFORD + ".png", y_mm=8.5),
        GRID,
    ),
    "stanford, more fields": (
        "stanford",
        stanford(GRID[::-1], STANFORD + "_0.5_1.25_.png", x_mm=8.6),
        GRID,
    ),
    "stanford, rows for columns": (
        "stanford",
        stanford(GRID.swapaxes(0, 1), y_mm=5.0, x_mm=5.0, turned=True),
        GRID,
    ),
    "quilt": ("quilt", one("a_qs4x3a1.25.png", made.mosaic(DOWNWARDS[::-1])), QUILT),
    "quilt without its name": ("mosaic", one("a.png", made.mosaic(DOWNWARDS[::-1])), QUILT),
    "rows-cols": ("rows-cols", grid(made.views(5, 5)), made.views(5, 5)),
    "rows-cols, every fourth": (
        "rows-cols",
        files(**{f"v_{4 * r}_{4 * c}_png": GRID[r, c] for r, c in np.ndindex(3, 4)}),
        GRID,
    ),
    **{
        f"numbered, {order}": ("numbered", numbered(walk(LARGE, order), "im_{:03d}.png"), LARGE)
        for order in ("rows", "cols")
    },
    "a line": ("numbered", numbered(LINE[0], "im_{:03d}.png"), LINE),
    "an upright line": ("numbered", numbered(UPRIGHT[:, 0], "im_{:03d}.png"), UPRIGHT),
    "lenslets": ("eslf", one("IMG_0001_eslf.png", lenslets(in_the_dark(TEN, sides=2))), TEN),
    "LFToolbox": ("mat", decoded, made.views(5, 5, 48, 64).astype(np.uint16) * 257),
}


@pytest.mark.parametrize("form", FORMS)
def test_every_view_stands_where_it_belongs(tmp_path: Path, form: str) -> None:
    layout, make, views = FORMS[form]
    source = described(make(tmp_path), layout)
    assert np.array_equal(made.canonical(source), views) and source.linear == (form == "LFToolbox")


def test_hci_with_geometry_and_truth_of_two_views(tmp_path: Path) -> None:
    grid(SQUARE, HCI, parameters_cfg=CFG.format(3, 3))(tmp_path)
    made.write(tmp_path / "gt_disp_lowres.pfm", TRUTH)
    made.write(tmp_path / "gt_disp_lowres_Cam002.pfm", TRUTH + 1)
    source = described(tmp_path, "hci")
    assert (source.geometry.baseline_mm, source.geometry.focus_distance_mm) == (25, 4250)
    assert source.geometry.focal_length_px == pytest.approx(80 * 100 / 35)
    assert sorted(source.truth) == [(0, 2), (1, 1)]
    assert np.array_equal(source.truth[1, 1](), TRUTH)


def test_truth_of_the_first_hci_data_set(tmp_path: Path) -> None:
    source = described(h5(SQUARE[:, ::-1], depth=DEPTH)(tmp_path), "hci-old")
    assert np.allclose(source.truth[1, 1](), TRUTH, atol=1e-4)
    assert orient(source, AUTO).by == "layout"


def write_mat(path: Path, views: np.ndarray, modern: bool, **more: Any) -> None:
    if not modern:
        scipy.io.savemat(path, {"LF": views})
        return
    h5(views.transpose(), path.name, **more)(path.parent)
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM")


@pytest.mark.parametrize("dtype", ["u1", "u2", "f4"])
@pytest.mark.parametrize("modern", [True, False])
def test_mat_both_versions_and_types(tmp_path: Path, modern: bool, dtype: str) -> None:
    scale = {"u1": 1, "u2": 257, "f4": 1 / 255}[dtype]
    write_mat(tmp_path / "scene.mat", (GRID * np.float64(scale)).astype(dtype), modern)
    source = described(tmp_path, "mat")
    assert source.max_value == (255 if dtype == "u1" else 65535)
    views = (
        made.canonical(source, config.Scene(flip="none", transpose="no")).astype(np.float64)
        / source.max_value
    )
    assert np.abs(views - GRID / 255).max() < 1e-4


@pytest.mark.parametrize(
    ("rows", "cols", "px"),
    [(9, 9, 96), (5, 7, 110), (15, 15, 64), (2, 3, 180), (1, 7, 110), (7, 1, 110)],
)
@pytest.mark.parametrize("scale", [0.7, 0.995, 1.1])
def test_tiles_may_be_no_whole_number_of_px(rows: int, cols: int, px: int, scale: float) -> None:
    whole = made.mosaic(made.views(rows, cols, px, px + 13, 1.0, -0.5))
    size = round(scale * whole.shape[1]) + 1, round(scale * whole.shape[0]) + 1
    resized = cv2.resize(whole, size, interpolation=cv2.INTER_AREA)
    assert find_tiles(resized) == (rows, cols)
    tiles = Tiling.even(resized, rows, cols)
    off = [abs(at - size[0] * k / cols) for k, at in enumerate(tiles.lefts)]
    assert max(off) <= 0.5


@pytest.mark.parametrize(
    ("scale", "order"), [("-1", "<f4"), ("-0.25", "<f4"), ("1.0", ">f4"), ("300", ">f4")]
)
def test_the_scale_of_a_pfm_map_is_its_byte_order_only(
    tmp_path: Path, scale: str, order: str
) -> None:
    values = np.arange(12, dtype=np.float32).reshape(3, 4)
    (tmp_path / "x.pfm").write_bytes(
        f"Pf\n4 3\n{scale}\n".encode() + values[::-1].astype(order).tobytes()
    )
    np.testing.assert_allclose(read_pfm(tmp_path / "x.pfm"), values, rtol=1e-6)
