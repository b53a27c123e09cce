"""Each layout from files that the test writes: detected without being named, every view read where
it belongs.
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import scipy.io

from lfpipe import config
from lfpipe.scene import layouts
from lfpipe.scene.files import read_pfm
from lfpipe.scene.layouts._tiles import find_tiles
from lfpipe.scene.orientation import orient
from lfpipe.scene.source import SceneSource
from tests.scene import made

AUTO = config.Scene()
GRID, SQUARE, QUILT = made.views(3, 4, 64, 80), made.views(3, 3, 64, 80), made.views(1, 12, 64, 80)
TRUTH = made.middle_disparity(64, 80)
CFG = (
    "[intrinsics]\nfocal_length_mm = 100\nimage_resolution_x_px = 80\nimage_resolution_y_px ="
    " 64\nsensor_size_mm = 35\n[extrinsics]\nnum_cams_x = {}\nnum_cams_y = {}\nbaseline_mm ="
    " 25\nfocus_distance_m = 4.25\n[meta]\nscene = %(odd)s\n"
)
Make = Callable[[Path], object]


def canonical(source: SceneSource, scene: config.Scene = AUTO) -> np.ndarray:
    """All views of a source in canonical order as the packer places them, uint8 or uint16."""
    turn = orient(source, scene).turn
    rows, cols = turn.grid(source.rows, source.cols)
    return np.array(
        [
            [source.read(0, *turn.file_index(r, c, rows, cols)) for c in range(cols)]
            for r in range(rows)
        ]
    )


def described(path: Path, layout: str, scene: config.Scene = AUTO) -> SceneSource:
    source = layouts.describe(path, scene)
    assert source.layout == layout
    return source


def named(grid: np.ndarray, name: str, **more: str) -> Make:
    """One file per view, and texts beside them."""
    return lambda f: [
        made.write_grid(f, grid, name),
        *((f / k.replace("_", ".")).write_text(v) for k, v in more.items()),
    ]


def stanford(
    name: str,
    index: Callable[[int, int], tuple[int, int]],
    y: float,
    x: float,
    shape: tuple[int, int],
) -> Make:
    """Views under camera coordinates.

    index: of the view in GRID; y, x: by which the coordinates grow with the index in names.
    """

    def make(folder: Path) -> None:
        for r, c in np.ndindex(shape):
            at = index(r, c)
            down, across = (y * r, x * c) if shape == (3, 4) else (y * c, x * r)
            made.write(folder / name.format(r=r, c=c, y=down - 300, x=across + 1100), GRID[at])

    return make


def old_hci(path: Path, grid: np.ndarray, depth: np.ndarray | None = None) -> None:
    with h5py.File(path, "w") as file:
        file["LF"] = grid[:, ::-1]
        file.attrs.update({"dH": 0.5, "focalLength": 20.0, "shift": 3.0, "hRes": grid.shape[1]})
        if depth is not None:
            file["GT_DEPTH"] = np.broadcast_to(depth, (*grid.shape[:2], *depth.shape))


def text_export(folder: Path, focal: float) -> None:
    made.write_grid(folder / "lf", SQUARE, "{r:02d}_{c:02d}.png")
    values = {
        "xRes": 80,
        "yRes": 64,
        "hRes": 3,
        "vRes": 3,
        "dH": 0.5,
        "shift": 3,
        "focalLength": focal,
    }
    (folder / "attributes.dat").write_text(
        "".join(f"{value:e} //{name}\n" for name, value in values.items()) + "junk\n"
    )
    (folder / "depth.bin").write_bytes(
        (TRUTH if focal == 0 else 10 / (TRUTH + 3)).astype("<f4").tobytes()
    )
    made.write(folder / "mask.png", np.full((64, 80), 255, np.uint8))


def numbered(grid: np.ndarray, order: str) -> Make:
    rows, cols = grid.shape[:2]

    def make(folder: Path) -> None:
        for r, c in np.ndindex(rows, cols):
            n = {
                "rows": r * cols + c,
                "cols": c * rows + r,
                "snake": r * cols + (cols - 1 - c if r % 2 else c),
            }[order]
            made.write(folder / f"im_{n + 1:03d}.png", grid[r, c])

    return make


def picture(name: str, pixels: np.ndarray) -> Make:
    return lambda folder: made.write(folder / name, pixels)


STANFORD = "out_{r:02d}_{c:02d}_{y:.6f}_{x:.6f}"
LINE, LARGE = made.views(1, 9, 96, 128), made.views(5, 7, 96, 128)
DEPTH = (0.5 * 20 / (TRUTH + 3)).astype(np.float32)
FORMS: dict[str, tuple[str, Make, np.ndarray]] = {  # layout, files, views in canonical order
    **{
        f"hci, {rows}x{cols}": (
            "hci",
            named(made.views(rows, cols), "input_Cam{n:03d}.png"),
            made.views(rows, cols),
        )
        for rows, cols in ((1, 9), (3, 5), (4, 4), (9, 1))
    },
    "hci, parameters": (
        "hci",
        named(GRID, "input_Cam{n:03d}.png", parameters_cfg=CFG.format(4, 3)),
        GRID,
    ),
    "hci-old": ("hci-old", lambda f: old_hci(f / "lf.h5", SQUARE, DEPTH), SQUARE),
    "hci-old, turned": ("hci-old", lambda f: old_hci(f / "lf.h5", SQUARE[:, ::-1], DEPTH), SQUARE),
    "an .h5 of one's own": (
        "hci-old",
        lambda f: h5py.File(f / "my.h5", "w").create_dataset("LF", data=SQUARE),
        SQUARE,
    ),
    "hci-text": ("hci-text", lambda f: text_export(f, 20.0), SQUARE),
    "stanford": (
        "stanford",
        stanford(STANFORD + "_.png", lambda r, c: (2 - r, 3 - c), -8.5, -8.6, (3, 4)),
        GRID,
    ),
    "stanford, copies": (
        "stanford",
        stanford("jpg_" + STANFORD + ".png", lambda r, c: (r, 3 - c), 8.5, -8.6, (3, 4)),
        GRID,
    ),
    "stanford, more fields": (
        "stanford",
        stanford(STANFORD + "_0.5_1.25_.png", lambda r, c: (2 - r, c), -8.5, 8.6, (3, 4)),
        GRID,
    ),
    "stanford, rows for columns": (
        "stanford",
        stanford(STANFORD + "_.png", lambda r, c: (c, r), 5.0, 5.0, (4, 3)),
        GRID,
    ),
    "quilt": (
        "quilt",
        picture("a_qs4x3a1.25.png", made.mosaic(QUILT[0].reshape(3, 4, *QUILT.shape[2:])[::-1])),
        QUILT,
    ),
    "quilt without its name": (
        "mosaic",
        picture("a.png", made.mosaic(QUILT[0].reshape(3, 4, *QUILT.shape[2:])[::-1])),
        QUILT,
    ),
    "quilt downwards": (
        "mosaic",
        picture("a.png", made.mosaic(QUILT[0].reshape(3, 4, *QUILT.shape[2:]))),
        QUILT,
    ),
    "rows-cols": (
        "rows-cols",
        named(made.views(5, 5), "view_{r:02d}_{c:02d}.png"),
        made.views(5, 5),
    ),
    "rows-cols, every fourth": (
        "rows-cols",
        lambda f: [
            made.write(f / f"v_{4 * r}_{4 * c}.png", GRID[r, c]) for r, c in np.ndindex(3, 4)
        ],
        GRID,
    ),
    **{
        f"numbered, {order}": ("numbered", numbered(LARGE, order), LARGE)
        for order in ("rows", "cols", "snake")
    },
    "a line": ("numbered", numbered(LINE, "rows"), LINE),
    "an upright line": (
        "numbered",
        numbered(made.views(9, 1, 96, 128), "rows"),
        made.views(9, 1, 96, 128),
    ),
}


@pytest.mark.parametrize("form", FORMS)
def test_every_view_stands_where_it_belongs(tmp_path: Path, form: str) -> None:
    layout, make, views = FORMS[form]
    make(tmp_path)
    assert np.array_equal(canonical(described(tmp_path, layout)), views)


def test_hci_with_geometry_and_truth_of_two_views(tmp_path: Path) -> None:
    named(SQUARE, "input_Cam{n:03d}.png", parameters_cfg=CFG.format(3, 3))(tmp_path)
    made.write_pfm(tmp_path / "gt_disp_lowres.pfm", TRUTH)
    made.write_pfm(tmp_path / "gt_disp_lowres_Cam002.pfm", TRUTH + 1)
    source = described(tmp_path, "hci")
    assert (source.geometry.baseline_mm, source.geometry.focus_distance_mm) == (25, 4250)
    assert source.geometry.focal_length_px == pytest.approx(80 * 100 / 35)
    assert sorted(source.truth) == [(0, 2), (1, 1)]
    assert np.array_equal(source.truth[1, 1](), TRUTH)


@pytest.mark.parametrize("layout", ["hci", "hci-text", "stanford", "jpeg-pleno"])
def test_views_that_are_missing_or_of_another_size_are_named(tmp_path: Path, layout: str) -> None:
    name = {
        "hci": "input_Cam{n:03d}.png",
        "hci-text": "lf/{r:02d}_{c:02d}.png",
        "stanford": "out_{r:02d}_{c:02d}_{r}_{c}_.png",
        "jpeg-pleno": "{r:03d}_{c:03d}.png",
    }[layout]
    named(
        made.views(4, 4, 64, 80), name, parameters_cfg=CFG.format(4, 4), attributes_dat="1 //dH\n"
    )(tmp_path)
    gone, odd = (tmp_path / name.format(r=r, c=c, n=4 * r + c) for r, c in ((1, 2), (2, 1)))
    gone.unlink()
    made.write(odd, GRID[0, 0, :-2])
    source = described(tmp_path, layout)
    assert (source.rows, source.cols, source.missing) == (4, 4, frozenset({(1, 2), (2, 1)}))
    assert (
        "2 of 4x4 views missing, made from others: row 1 column 2, row 2 column 1" in source.notes
    )
    assert any(f"{odd.name} (80x62 px)" in note for note in source.notes)


def test_truth_of_the_first_hci_data_set(tmp_path: Path) -> None:
    for focal in (0.0, 20.0):
        text_export(tmp_path / str(focal), focal)
        assert np.allclose(
            described(tmp_path / str(focal), "hci-text").truth[1, 1](), TRUTH, atol=1e-4
        )
    for grid, by in ((SQUARE, "layout"), (SQUARE[:, ::-1], "truth")):
        old_hci(tmp_path / f"{by}.h5", grid, DEPTH)
        source = described(tmp_path / f"{by}.h5", "hci-old")
        assert np.allclose(source.truth[1, 1](), TRUTH, atol=1e-4) and orient(source, AUTO).by in (
            by,
            "truth",
        )


def test_jpeg_pleno_10_bit_dark_sides_and_missing_corners(tmp_path: Path) -> None:
    inner = made.views(5, 5, 48, 64).astype(np.uint16) * 4
    whole = np.zeros((7, 7, 48, 64, 3), np.uint16)
    whole[1:6, 1:6] = inner
    whole[1, 1] = 3
    for r, c in np.ndindex(7, 7):
        if (r, c) not in ((0, 0), (0, 1), (1, 0), (0, 6), (5, 5)):
            made.write_ppm(tmp_path / f"{r:03d}_{c:03d}.ppm", whole[r, c], 1023)
    source = described(tmp_path, "jpeg-pleno")
    assert (source.rows, source.cols, source.bit_depth, source.missing) == (
        5,
        5,
        10,
        frozenset({(0, 0), (4, 4)}),
    )
    assert np.array_equal(source.read(0, 2, 3), inner[2, 3])


def write_mat(path: Path, grid: np.ndarray, modern: bool, **more: object) -> None:
    if not modern:
        scipy.io.savemat(path, {"LF": grid})
        return
    with h5py.File(path, "w", userblock_size=512) as file:
        file.create_dataset("LF", data=grid.transpose(), **more)
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
        canonical(source, config.Scene(flip="none", transpose="no")).astype(np.float64)
        / source.max_value
    )
    assert np.abs(views - GRID / 255).max() < 1e-4


def test_mat_of_lftoolbox_is_linear_light_with_weights_and_dark_sides(tmp_path: Path) -> None:
    inner = made.views(5, 5, 48, 64)
    whole = np.zeros((7, 7, 48, 64, 4), np.uint16)
    whole[1:6, 1:6, ..., :3] = inner.astype(np.uint16) * 257
    write_mat(tmp_path / "IMG__Decoded.mat", whole, True, chunks=True, compression="gzip")
    with h5py.File(tmp_path / "IMG__Decoded.mat", "a") as file:
        file["LFMetadata"] = np.zeros(1)
    source = described(tmp_path, "mat")
    assert (source.linear, source.rows, source.cols) == (True, 5, 5)
    assert np.array_equal(source.read(0, 1, 4), inner[1, 4].astype(np.uint16) * 257)


OPTIONS: list[dict[str, Any]] = [
    {},
    {"compression": "gzip", "fletcher32": True, "shuffle": True},
    {"compression": "lzf"},
]


@pytest.mark.parametrize(
    "grid",
    [
        GRID,
        GRID[..., :1],
        GRID[..., 0],
        np.random.default_rng(1).integers(0, 255, GRID.shape, np.uint8),
    ],
)
def test_ways_to_pack_hdf5(tmp_path: Path, grid: np.ndarray) -> None:
    for n, options in enumerate(OPTIONS):
        for name, values in ((f"{n}.h5", grid), (f"{n}.mat", grid.transpose())):
            with h5py.File(tmp_path / name, "w") as file:
                file.create_dataset("LF", data=values.astype(np.uint8), **options)
            source = layouts.describe(tmp_path / name, AUTO)
            views = np.array([[source.read(0, r, c) for c in range(4)] for r in range(3)])
            assert np.array_equal(views, grid.reshape(views.shape))


def test_eslf_lenslets_with_dark_outer_views(tmp_path: Path) -> None:
    inner = made.views(10, 10, 60, 72, 0.4, -0.2)
    whole = np.zeros((14, 14, 60, 72, 3), np.uint8)
    whole[2:12, 2:12] = inner
    lenslets = whole.transpose(2, 0, 3, 1, 4).reshape(60 * 14, 72 * 14, 3)
    # not a multiple of 14: filled up at the end
    made.write(tmp_path / "IMG_0001.png", lenslets[:-3])
    source = described(tmp_path, "eslf")
    assert (source.rows, source.cols, source.height_px, source.width_px) == (10, 10, 60, 72)
    assert np.array_equal(source.read(0, 3, 7), inner[3, 7])


@pytest.mark.parametrize("suffix", ["png", "jpg"])
@pytest.mark.parametrize(("line_px", "edge_px"), [(0, 0), (1, 0), (2, 2), (7, 7), (3, 40)])
@pytest.mark.parametrize(("rows", "cols", "level"), [(3, 4, 255), (5, 2, 0), (1, 5, 128)])
def test_lines_between_tiles_are_cut_away(
    rows: int, cols: int, level: int, line_px: int, edge_px: int, suffix: str, tmp_path: Path
) -> None:
    grid = made.views(rows, cols, 90, 131)
    height, width = (
        (count - 1) * (size + line_px) + size + 2 * edge_px
        for count, size in ((rows, 90), (cols, 131))
    )
    sheet = np.full((height, width, 3), level, np.uint8)
    for r, c in np.ndindex(rows, cols):
        top, left = edge_px + r * (90 + line_px), edge_px + c * (131 + line_px)
        sheet[top : top + 90, left : left + 131] = grid[r, c]
    made.write(tmp_path / f"sheet.{suffix}", sheet)
    source = described(tmp_path / f"sheet.{suffix}", "mosaic")
    assert (source.rows, source.cols) == (rows, cols)
    assert abs(source.height_px - 90) + abs(source.width_px - 131) <= (0 if suffix == "png" else 8)
    if suffix == "png":
        assert all(
            np.array_equal(source.read(0, r, c), grid[r, c]) for r, c in np.ndindex(rows, cols)
        )


def test_find_tiles_ranks_what_the_name_and_the_pictures_say(
    caplog: pytest.LogCaptureFixture,
) -> None:
    picture = made.mosaic(made.views(4, 6, 90, 120))
    caplog.set_level("INFO", "lfpipe.scene")
    tiles = find_tiles(picture, "sheet_2x6")
    assert tiles is not None
    assert tiles.shape == (4, 6), "the picture contradicts the name"
    caplog.clear()
    tiles = find_tiles(picture, "sheet_4x6")
    assert tiles is not None
    assert tiles.shape == (4, 6)
    _, first, second = caplog.text.splitlines()[-3:]
    assert "4x6, by the name" in first
    assert "4x6, by likeness along both axes" in second


def test_the_scale_of_a_pfm_map_is_its_byte_order_only(tmp_path: Path) -> None:
    values = np.arange(12, dtype=np.float32).reshape(3, 4)
    for scale, order in (("-1", "<f4"), ("-0.25", "<f4"), ("1.0", ">f4"), ("300", ">f4")):
        (tmp_path / "x.pfm").write_bytes(
            f"Pf\n4 3\n{scale}\n".encode() + values[::-1].astype(order).tobytes()
        )
        np.testing.assert_allclose(read_pfm(tmp_path / "x.pfm"), values, rtol=1e-6)


def test_tiles_with_a_plain_background_are_not_cropped(tmp_path: Path) -> None:
    grid = made.views(4, 6, 90, 120).copy()
    grid[:, :, :12], grid[:, :, -9:], grid[:, :, :, :15], grid[:, :, :, -15:] = 0, 0, 0, 0
    made.write(tmp_path / "sheet.png", made.mosaic(grid))
    source = described(tmp_path / "sheet.png", "mosaic")
    assert (source.rows, source.cols, source.height_px, source.width_px) == (4, 6, 90, 120)


def test_a_quilt_whose_tiles_do_not_divide_it(tmp_path: Path) -> None:
    line = made.views(1, 45, 91, 102, 0.5, -0.3)[0]
    tiles = np.array(
        [
            [cv2.resize(line[9 * 5 - 5 * (r + 1) + c], (819, 455)) for c in range(5)]
            for r in range(9)
        ]
    )
    pixels = np.zeros((4096, 4096, 3), np.uint8)
    pixels[:4095, :4095] = made.mosaic(tiles)
    made.write(tmp_path / "45_01.jpg", pixels)
    source = described(tmp_path / "45_01.jpg", "mosaic")
    assert (source.rows, source.cols, source.height_px, source.width_px) == (1, 45, 455, 819)


def test_what_the_doubt_about_a_quilt_offers(tmp_path: Path) -> None:
    line = made.views(1, 45, 150, 200, 0.5, -0.3)
    made.write(tmp_path / "45_01.png", made.mosaic(line[0].reshape(9, 5, 150, 200, 3)[::-1]))
    for layout, grid in (("quilt", (1, 45)), ("mosaic", (9, 5))):
        for text in ("", "9x5"):
            source = described(tmp_path, layout, config.Scene(layout=layout, grid=text))
            assert (source.rows, source.cols) == grid
    assert np.array_equal(described(tmp_path, "mosaic").read(0, 0, 5), line[0, 5])


def test_light_field_video_from_pictures_and_from_a_file(tmp_path: Path) -> None:
    grids = [GRID, made.views(3, 4, 64, 80, 1.8)]
    for n, grid in enumerate(grids):
        made.write(tmp_path / "frames" / f"frame_{n + 1:04d}.png", made.mosaic(grid))
    made.write_film(tmp_path / "lf.mkv", [made.mosaic(grid) for grid in grids], "FFV1")
    for path, rate_hz in ((tmp_path / "frames", 25.0), (tmp_path / "lf.mkv", 12.0)):
        source = described(path, "mosaic-video")
        assert (source.frames, source.rows, source.cols, source.frame_rate_hz) == (2, 3, 4, rate_hz)
        for frame in (1, 0, 1):  # backwards too
            assert np.abs(source.read(frame, 0, 3).astype(int) - grids[frame][0, 3]).mean() < 2


def test_pictures_that_are_no_video_are_told_apart(tmp_path: Path) -> None:
    made.write(tmp_path / "example01.png", made.mosaic(GRID))
    made.write(tmp_path / "example02.png", made.mosaic(GRID[:, :, ::-1, ::-1]))
    source = described(tmp_path, "mosaic-video")
    assert source.frames == 1 and "example01.png" in source.notes[0]


def test_every_layout_has_a_row_in_the_docs() -> None:
    text = (Path(__file__).parents[2] / "docs" / "layouts.md").read_text()
    rows = set(re.findall(r"^\| `([\w-]+)` \|", text, re.MULTILINE))
    assert rows == {name for name in layouts.layouts() if name != "demo"}
