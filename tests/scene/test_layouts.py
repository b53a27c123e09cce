"""Each layout from files that the test writes: found without being named, every view read where it belongs."""

import json
from pathlib import Path

import attrs
import cv2
import h5py
import numpy as np
import pytest
import scipy.io

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene import layouts
from lfpipe.scene.layouts._running import Running
from lfpipe.scene.layouts._tiles import Tiling
from lfpipe.scene.orientation import orient
from lfpipe.scene.source import SceneSource
from tests.scene import made

GRID = made.views(3, 4, 64, 80)
AUTO = config.Scene()


def canonical(source: SceneSource, scene: config.Scene = AUTO) -> np.ndarray:
    """All views of a source in canonical order as the packer places them, uint8 or uint16."""
    turn = orient(source, scene).turn
    rows, cols = turn.grid(source.rows, source.cols)
    return np.array([[source.read(0, *turn.file_index(r, c, rows, cols)) for c in range(cols)] for r in range(rows)])


def found(path: Path, layout: str, scene: config.Scene = AUTO) -> SceneSource:
    source = layouts.describe(path, scene)
    assert source.layout == layout
    return source


@pytest.mark.parametrize(("rows", "cols"), [(1, 9), (3, 5), (4, 4), (9, 1)])
def test_names_of_the_hci_benchmark_on_any_grid(rows: int, cols: int, tmp_path: Path) -> None:
    grid = made.views(rows, cols)
    made.write_grid(tmp_path, grid, "input_Cam{n:03d}.png")
    source = found(tmp_path, "hci")
    told = orient(source, AUTO)
    assert told.turn.grid(source.rows, source.cols) == (rows, cols)
    order = [[source.read(0, *told.turn.file_index(r, c, rows, cols)) for c in range(cols)] for r in range(rows)]
    assert np.array_equal(order, grid)


def test_hci_with_geometry_and_truth_of_two_views(tmp_path: Path) -> None:
    grid = made.views(3, 3, 64, 80)
    made.write_grid(tmp_path, grid, "input_Cam{n:03d}.png")
    (tmp_path / "parameters.cfg").write_text(
        "[intrinsics]\nfocal_length_mm = 100\nimage_resolution_x_px = 80\nimage_resolution_y_px = 64\nsensor_size_mm = 35\n"
        "[extrinsics]\nnum_cams_x = 3\nnum_cams_y = 3\nbaseline_mm = 25\nfocus_distance_m = 4.25\n[meta]\nscene = %(odd)s\n"
    )
    truth = made.middle_disparity(64, 80)
    made.write_pfm(tmp_path / "gt_disp_lowres.pfm", truth)
    made.write_pfm(tmp_path / "gt_disp_lowres_Cam002.pfm", truth + 1)
    source = found(tmp_path, "hci")
    assert np.array_equal(canonical(source), grid)
    assert (source.geometry.baseline_mm, source.geometry.focus_distance_mm) == (25, 4250)
    assert source.geometry.focal_length_px == pytest.approx(80 * 100 / 35)
    assert sorted(source.truth) == [(0, 2), (1, 1)]
    assert np.array_equal(source.truth[1, 1](), truth)


def test_hci_of_a_grid_that_is_not_square(tmp_path: Path) -> None:
    made.write_grid(tmp_path, GRID, "input_Cam{n:03d}.png")
    source = found(tmp_path, "hci", config.Scene(grid="3x4"))
    assert np.array_equal(canonical(source), GRID)
    (tmp_path / "parameters.cfg").write_text("[extrinsics]\nnum_cams_x = 4\nnum_cams_y = 3\n")
    assert np.array_equal(canonical(found(tmp_path, "hci")), GRID)


def old_hci(path: Path, grid: np.ndarray, depth: np.ndarray | None) -> None:
    with h5py.File(path, "w") as file:
        file["LF"] = grid[:, ::-1]
        file.attrs.update({"dH": 0.5, "focalLength": 20.0, "shift": 3.0, "hRes": grid.shape[1]})
        if depth is not None:
            file["GT_DEPTH"] = np.broadcast_to(depth, (*grid.shape[:2], *depth.shape))


def test_old_hci_runs_right_to_left_and_its_depth_becomes_disparity(tmp_path: Path) -> None:
    grid = made.views(3, 3, 64, 80)
    truth = made.middle_disparity(64, 80)
    old_hci(tmp_path / "lf.h5", grid, (0.5 * 20 / (truth + 3)).astype(np.float32))
    source = found(tmp_path, "hci-old")
    assert orient(source, AUTO).turn.cols
    assert np.array_equal(canonical(source), grid)
    assert np.allclose(source.truth[1, 1](), truth, atol=1e-4)
    assert np.array_equal(canonical(found(tmp_path / "lf.h5", "hci-old")), grid)


def test_old_hci_written_the_right_way_round_is_told_by_its_truth(tmp_path: Path) -> None:
    grid = made.views(3, 3, 64, 80)
    truth = made.middle_disparity(64, 80)
    old_hci(tmp_path / "lf.h5", grid[:, ::-1], (0.5 * 20 / (truth + 3)).astype(np.float32))
    source = found(tmp_path, "hci-old")
    assert orient(source, AUTO).by == "truth"
    assert np.array_equal(canonical(source), grid)


@pytest.mark.parametrize("focal", [0.0, 20.0])
def test_text_export(tmp_path: Path, focal: float) -> None:
    grid = made.views(3, 3, 64, 80)
    truth = made.middle_disparity(64, 80)
    made.write_grid(tmp_path / "lf", grid, "{r:02d}_{c:02d}.png")
    values = {"xRes": 80, "yRes": 64, "hRes": 3, "vRes": 3, "dH": 0.5, "shift": 3, "focalLength": focal}
    (tmp_path / "attributes.dat").write_text("".join(f"{value:e} //{name}\n" for name, value in values.items()) + "junk\n")
    (tmp_path / "depth.bin").write_bytes((truth if focal == 0 else 10 / (truth + 3)).astype("<f4").tobytes())
    made.write(tmp_path / "mask.png", np.full((64, 80), 255, np.uint8))
    source = found(tmp_path, "hci-text")
    assert np.array_equal(canonical(source), grid)
    assert np.allclose(source.truth[1, 1](), truth, atol=1e-4)


@pytest.mark.parametrize(
    "name",
    [
        "out_{r:02d}_{c:02d}_{y:.6f}_{x:.6f}_.png",
        "jpg_out_{r:02d}_{c:02d}_{y:.6f}_{x:.6f}.png",
        "out_{r:02d}_{c:02d}_{y:.3f}_{x:.3f}_0.5_1.25_.png",
    ],
)
def test_stanford_follows_coordinates_not_indices(tmp_path: Path, name: str) -> None:
    for r in range(3):
        for c in range(4):  # index rows run upwards, columns from right to left
            made.write(tmp_path / name.format(r=r, c=c, y=-300 - 8.5 * r, x=1100.0 - 8.6 * c), GRID[2 - r, 3 - c])
    source = found(tmp_path, "stanford")
    assert np.array_equal(canonical(source), GRID)


def test_stanford_with_rows_for_columns(tmp_path: Path) -> None:
    for r in range(4):
        for c in range(3):
            made.write(tmp_path / f"out_{r:02d}_{c:02d}_{5.0 * c:.4f}_{5.0 * r:.4f}_.png", GRID[c, r])
    assert np.array_equal(canonical(found(tmp_path, "stanford")), GRID)


def test_jpeg_pleno_10_bit_dark_sides_and_missing_corners(tmp_path: Path) -> None:
    inner = made.views(5, 5, 48, 64).astype(np.uint16) * 4
    whole = np.zeros((7, 7, 48, 64, 3), np.uint16)
    whole[1:6, 1:6] = inner
    whole[1, 1] = 3
    for r in range(7):
        for c in range(7):
            if (r, c) not in ((0, 0), (0, 6), (5, 5)):
                made.write_ppm(tmp_path / f"{r:03d}_{c:03d}.ppm", whole[r, c], 1023)
    source = found(tmp_path, "jpeg-pleno")
    assert (source.rows, source.cols, source.bit_depth) == (5, 5, 10)
    assert source.missing == {(0, 0), (4, 4)}
    assert np.array_equal(source.read(0, 2, 3), inner[2, 3])
    assert len(source.notes) == 2


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("modern", [True, False])
def test_mat_both_versions_and_types(tmp_path: Path, modern: bool, dtype: type) -> None:
    grid = GRID.astype(dtype) if dtype != np.uint16 else GRID.astype(np.uint16) * 257
    if dtype == np.float32:
        grid = (GRID / 255).astype(np.float32)
    path = tmp_path / "scene.mat"
    if modern:
        with h5py.File(path, "w", userblock_size=512) as file:
            file["LF"] = grid.transpose(4, 3, 2, 1, 0)
        with path.open("r+b") as stream:
            stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM")
    else:
        scipy.io.savemat(path, {"LF": grid})
    source = found(path, "mat")
    assert source.max_value == (255 if dtype == np.uint8 else 65535)
    got = canonical(source, config.Scene(flip="none", transpose="no")).astype(np.float64) / source.max_value
    assert np.abs(got - GRID / 255).max() < 1e-4


def test_mat_of_lftoolbox_is_linear_light_with_weights_and_dark_sides(tmp_path: Path) -> None:
    inner = made.views(5, 5, 48, 64)
    whole = np.zeros((7, 7, 48, 64, 4), np.uint16)
    whole[1:6, 1:6, ..., :3] = inner.astype(np.uint16) * 257
    with h5py.File(tmp_path / "IMG__Decoded.mat", "w", userblock_size=512) as file:
        file.create_dataset("LF", data=whole.transpose(4, 3, 2, 1, 0), chunks=True, compression="gzip")
        file["LFMetadata"] = np.zeros(1)
    source = found(tmp_path, "mat")
    assert source.linear
    assert (source.rows, source.cols) == (5, 5)
    assert np.array_equal(source.read(0, 1, 4), inner[1, 4].astype(np.uint16) * 257)


def test_eslf_lenslets_with_dark_outer_views(tmp_path: Path) -> None:
    inner = made.views(10, 10, 60, 72, 0.4, -0.2)
    whole = np.zeros((14, 14, 60, 72, 3), np.uint8)
    whole[2:12, 2:12] = inner
    picture = whole.transpose(2, 0, 3, 1, 4).reshape(60 * 14, 72 * 14, 3)
    made.write(tmp_path / "IMG_0001.png", picture[:-3])  # not a multiple of 14: filled up at the end
    source = found(tmp_path, "eslf")
    assert (source.rows, source.cols, source.height_px, source.width_px) == (10, 10, 60, 72)
    assert np.array_equal(source.read(0, 3, 7), inner[3, 7])


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_mosaic_is_found_by_its_period(tmp_path: Path, suffix: str) -> None:
    grid = made.views(4, 5, 96, 128)
    made.write(tmp_path / f"toys{suffix}", made.mosaic(grid))
    source = found(tmp_path / f"toys{suffix}", "mosaic")
    assert (source.rows, source.cols) == (4, 5)
    assert np.abs(source.read(0, 1, 3).astype(int) - grid[1, 3]).mean() < (0.01 if suffix == ".png" else 6)


@pytest.mark.parametrize("suffix", ["png", "jpg"])
@pytest.mark.parametrize(("line_px", "edge_px"), [(1, 0), (2, 2), (7, 7), (3, 40)])
@pytest.mark.parametrize(("rows", "cols", "level"), [(3, 4, 255), (5, 2, 0), (1, 5, 128)])
def test_lines_between_tiles_are_cut_away(
    rows: int, cols: int, level: int, line_px: int, edge_px: int, suffix: str, tmp_path: Path
) -> None:
    grid = made.views(rows, cols, 90, 131)
    height, width = ((count - 1) * (size + line_px) + size + 2 * edge_px for count, size in ((rows, 90), (cols, 131)))
    sheet = np.full((height, width, 3), level, np.uint8)
    for r, c in np.ndindex(rows, cols):
        top, left = edge_px + r * (90 + line_px), edge_px + c * (131 + line_px)
        sheet[top : top + 90, left : left + 131] = grid[r, c]
    made.write(tmp_path / f"sheet.{suffix}", sheet)
    source = found(tmp_path / f"sheet.{suffix}", "mosaic")
    assert (source.rows, source.cols) == (rows, cols)
    assert abs(source.height_px - 90) + abs(source.width_px - 131) <= (0 if suffix == "png" else 8)
    if suffix == "png":
        assert all(np.array_equal(source.read(0, r, c), grid[r, c]) for r, c in np.ndindex(rows, cols))


def test_tiles_with_a_plain_background_are_not_cropped(tmp_path: Path) -> None:
    grid = made.views(4, 6, 90, 120).copy()
    grid[:, :, :12], grid[:, :, -9:], grid[:, :, :, :15], grid[:, :, :, -15:] = 0, 0, 0, 0
    made.write(tmp_path / "sheet.png", made.mosaic(grid))
    source = found(tmp_path / "sheet.png", "mosaic")
    assert (source.rows, source.cols, source.height_px, source.width_px) == (4, 6, 90, 120)


def test_an_ordinary_picture_is_no_mosaic(tmp_path: Path) -> None:
    made.write(tmp_path / "photo.png", made.texture(360, 480, 5))
    source = found(tmp_path, "picture")
    assert (source.rows, source.cols) == (1, 1)


QUILT = made.views(1, 12, 64, 80)


def test_quilt_by_name_starts_at_the_bottom_left(tmp_path: Path) -> None:
    tiles = QUILT[0].reshape(3, 4, *QUILT.shape[2:])[::-1]
    made.write(tmp_path / "shop_qs4x3a1.25.png", made.mosaic(tiles))
    assert np.array_equal(canonical(found(tmp_path, "quilt")), QUILT)


@pytest.mark.parametrize("bottom_first", [True, False])
def test_quilt_without_its_name_is_told_from_a_grid(tmp_path: Path, bottom_first: bool) -> None:
    tiles = QUILT[0].reshape(3, 4, *QUILT.shape[2:])
    made.write(tmp_path / "example.png", made.mosaic(tiles[::-1] if bottom_first else tiles))
    assert np.array_equal(canonical(found(tmp_path, "mosaic")), QUILT)


@pytest.mark.parametrize(
    ("name", "first"), [("view_{r:02d}_{c:02d}.png", 0), ("scene-r{r:d}_c{c:d}.jpg", 1), ("2067_{r:02d}_{c:02d}.png", 1)]
)
def test_rows_and_columns_in_the_names(tmp_path: Path, name: str, first: int) -> None:
    grid = made.views(5, 5)
    for r in range(5):
        for c in range(5):
            made.write(tmp_path / name.format(r=r + first, c=c + first), grid[r, c])
    source = found(tmp_path, "rows-cols")
    assert np.abs(canonical(source).astype(int) - grid).mean() < 3
    assert orient(source, AUTO).by == "flow"


def test_every_fourth_row_is_a_grid_of_its_own(tmp_path: Path) -> None:
    for r in range(3):
        for c in range(4):
            made.write(tmp_path / f"v_{4 * r}_{4 * c}.png", GRID[r, c])
    source = found(tmp_path, "rows-cols")
    assert (source.rows, source.cols) == (3, 4)


def numbered_files(folder: Path, grid: np.ndarray, order: str) -> None:
    rows, cols = grid.shape[:2]
    for r in range(rows):
        for c in range(cols):
            n = {"rows": r * cols + c, "cols": c * rows + r, "snake": r * cols + (cols - 1 - c if r % 2 else c)}[order]
            made.write(folder / f"im_{n + 1:03d}.png", grid[r, c])


@pytest.mark.parametrize("order", ["rows", "cols", "snake"])
def test_numbered_views_in_any_order(tmp_path: Path, order: str) -> None:
    grid = made.views(5, 7, 96, 128)
    numbered_files(tmp_path, grid, order)
    source = found(tmp_path, "numbered")
    assert np.array_equal(canonical(source), grid), orient(source, AUTO)


@pytest.mark.parametrize("upright", [False, True])
def test_a_numbered_line_of_cameras(tmp_path: Path, upright: bool) -> None:
    line = made.views(9, 1, 96, 128) if upright else made.views(1, 9, 96, 128)
    for n, view in enumerate(line.reshape(9, *line.shape[2:])):
        made.write(tmp_path / f"{n}.png", view)
    source = found(tmp_path, "numbered")
    assert np.array_equal(canonical(source), line), orient(source, AUTO)


def test_numbers_of_a_snake_by_hand() -> None:
    snake = Running(2, 3, snake=True, first=1)
    assert [snake.index(n) for n in range(8)] == [None, (0, 0), (0, 1), (0, 2), (1, 2), (1, 1), (1, 0), None]


def test_light_field_video_from_pictures_and_from_a_file(tmp_path: Path) -> None:
    grids = [made.views(3, 4, 64, 80), made.views(3, 4, 64, 80, 1.8)]
    for n, grid in enumerate(grids):
        made.write(tmp_path / "frames" / f"frame_{n + 1:04d}.png", made.mosaic(grid))
    source = found(tmp_path / "frames", "mosaic-video")
    assert (source.frames, source.rows, source.cols, source.frame_rate_hz) == (2, 3, 4, 25.0)
    assert np.array_equal(source.read(1, 2, 1), grids[1][2, 1])
    video = tmp_path / "lf.mkv"
    picture = made.mosaic(grids[0])
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"FFV1"), 12.0, picture.shape[1::-1])
    for grid in grids:
        writer.write(cv2.cvtColor(made.mosaic(grid), cv2.COLOR_RGB2BGR))
    writer.release()
    source = found(video, "mosaic-video")
    assert (source.frames, source.rows, source.cols, source.frame_rate_hz) == (2, 3, 4, 12.0)
    for frame in (1, 0, 1):  # backwards too
        assert np.abs(source.read(frame, 0, 3).astype(int) - grids[frame][0, 3]).mean() < 2


def test_pictures_that_are_no_video_are_told_apart(tmp_path: Path) -> None:
    made.write(tmp_path / "example01.png", made.mosaic(made.views(3, 4, 64, 80)))
    made.write(tmp_path / "example02.png", made.mosaic(made.views(3, 4, 64, 80)[:, :, ::-1, ::-1]))
    source = found(tmp_path, "mosaic-video")
    assert source.frames == 1
    assert "example01.png" in source.notes[0]


def test_named_layout_and_grid_override(tmp_path: Path) -> None:
    made.write(tmp_path / "view_0_0.png", made.mosaic(GRID))
    source = found(tmp_path, "mosaic", config.Scene(layout="mosaic", grid="6x2"))
    assert (source.rows, source.cols) == (6, 2)
    with pytest.raises(UserError, match="did you mean 'quilt'"):
        layouts.describe(tmp_path, config.Scene(layout="qilt"))


def test_every_layout_offers_the_protocol() -> None:
    for name, layout in layouts.layouts().items():
        assert name == layout.NAME
        assert callable(layout.detect)
        assert callable(layout.describe)
    assert len(layouts.layouts()) == 18


@pytest.mark.parametrize("counts", [(2, 9), (9, 2), (8, 8), (17, 1)])
def test_tiling_covers_every_tile_once(counts: tuple[int, int]) -> None:
    rows, cols = counts
    picture = np.arange(rows * 4 * cols * 5).reshape(rows * 4, cols * 5)
    for quilt in (False, True):
        cut = Tiling.even(picture, rows, cols, quilt)
        tiles = [cut.cut(picture, r, c) for r in range(cut.grid[0]) for c in range(cut.grid[1])]
        assert np.array_equal(np.sort(np.concatenate([t.ravel() for t in tiles])), picture.ravel())
        assert json.dumps(attrs.asdict(cut))


def test_a_quilt_whose_tiles_do_not_divide_it(tmp_path: Path) -> None:
    line = made.views(1, 45, 91, 102, 0.5, -0.3)[0]
    tiles = np.array([[cv2.resize(line[9 * 5 - 5 * (r + 1) + c], (819, 455)) for c in range(5)] for r in range(9)])
    picture = np.zeros((4096, 4096, 3), np.uint8)
    picture[:4095, :4095] = made.mosaic(tiles)
    made.write(tmp_path / "45_01.jpg", picture)
    source = found(tmp_path / "45_01.jpg", "mosaic")
    assert (source.rows, source.cols, source.height_px, source.width_px) == (1, 45, 455, 819)


@pytest.mark.parametrize(("cols", "rows"), [(5, 9), (4, 8), (6, 10), (8, 6)])
def test_a_quilt_without_its_name_is_a_line(tmp_path: Path, cols: int, rows: int) -> None:
    line = made.views(1, cols * rows, 150, 200, 0.5, -0.3)
    made.write(tmp_path / "45_01.png", made.mosaic(line[0].reshape(rows, cols, 150, 200, 3)[::-1]))
    source = layouts.describe(tmp_path, config.Scene())
    assert (source.layout, source.rows, source.cols) == ("mosaic", 1, cols * rows)
    assert np.array_equal(source.read(0, 0, 1), line[0, 1]) and np.array_equal(source.read(0, 0, cols), line[0, cols])
    for layout, grid in (("quilt", (1, cols * rows)), ("mosaic", (rows, cols))):  # what the doubt offers
        for text in ("", f"{rows}x{cols}"):
            source = layouts.describe(tmp_path, config.Scene(layout=layout, grid=text))
            assert (source.rows, source.cols) == grid
