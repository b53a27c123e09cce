"""Errors of a scene are reported clearly, and nothing stays half-written. The importers are fuzzed."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import read_picture
from lfpipe.scene import layouts
from lfpipe.scene.files import MAX_FILES, list_scene, read_pfm
from lfpipe.scene.layouts import hci_text, mat
from lfpipe.scene.layouts._grid import parse_grid
from lfpipe.scene.packing import pack_scene
from tests.scene import made

GRID = made.views(3, 3, 48, 64)


def hci(folder: Path, cfg: str = "[extrinsics]\nnum_cams_x = 3\nnum_cams_y = 3\n") -> Path:
    (folder / "parameters.cfg").write_text(cfg)
    return made.write_grid(folder, GRID, "input_Cam{n:03d}.png")


def no_such(folder: Path) -> Path:
    return folder / "nowhere"


def empty(folder: Path) -> Path:
    return folder


def holes(folder: Path) -> Path:
    (hci(folder) / "input_Cam004.png").unlink()
    return folder


def truncated(folder: Path) -> Path:
    path = hci(folder) / "input_Cam007.png"
    path.write_bytes(path.read_bytes()[:-300])
    return folder


def other_size(folder: Path) -> Path:
    made.write(hci(folder) / "input_Cam003.png", GRID[0, 0, :-2])
    return folder


def other_depth(folder: Path) -> Path:
    made.write(hci(folder) / "input_Cam003.png", GRID[0, 0].astype(np.uint16) * 257)
    return folder


def no_picture(folder: Path) -> Path:
    (hci(folder) / "input_Cam003.png").write_text("hello")
    return folder


def bomb(folder: Path) -> Path:
    path = hci(folder) / "input_Cam004.png"
    data = bytearray(path.read_bytes())
    data[16:24] = (1_000_000).to_bytes(4, "big") * 2
    path.write_bytes(bytes(data))
    return folder


def link_out(folder: Path) -> Path:
    outside = folder.parent / "outside.png"
    made.write(outside, GRID[0, 0])
    (hci(folder) / "input_Cam005.png").unlink()
    (folder / "input_Cam005.png").symlink_to(outside)
    return folder


def link_to_nothing(folder: Path) -> Path:
    (hci(folder) / "input_Cam005.png").unlink()
    (folder / "input_Cam005.png").symlink_to(folder / "gone.png")
    return folder


def nan_disparity(folder: Path) -> Path:
    truth = made.middle_disparity(48, 64).copy()
    truth[3, 4] = np.nan
    made.write_pfm(hci(folder) / "gt_disp_lowres.pfm", truth)
    return folder


def small_disparity(folder: Path) -> Path:
    made.write_pfm(hci(folder) / "gt_disp_lowres.pfm", made.middle_disparity(40, 64))
    return folder


def cut_disparity(folder: Path) -> Path:
    made.write_pfm(hci(folder) / "gt_disp_lowres.pfm", made.middle_disparity(48, 64))
    os.truncate(folder / "gt_disp_lowres.pfm", 500)
    return folder


def bad_parameters(folder: Path) -> Path:
    (hci(folder) / "parameters.cfg").write_text("no section = 1")
    return folder


def crowded(folder: Path) -> Path:
    for n in range(MAX_FILES + 1):
        (folder / f"v_{n}.png").touch()
    return folder


def h5_without_key(folder: Path) -> Path:
    with h5py.File(folder / "lf.h5", "w") as file:
        file["other"] = np.zeros(3)
    return folder


def h5_truncated(folder: Path) -> Path:
    with h5py.File(folder / "lf.h5", "w") as file:
        file["LF"] = GRID
    os.truncate(folder / "lf.h5", 4000)
    return folder


def h5_leads_out(folder: Path) -> Path:
    with h5py.File(folder.parent / "secret.h5", "w") as file:
        file["LF"] = GRID
    with h5py.File(folder / "lf.h5", "w") as file:
        file["LF"] = h5py.ExternalLink("../secret.h5", "LF")
    return folder


def h5_kept_elsewhere(folder: Path) -> Path:
    (folder.parent / "raw").write_bytes(GRID.tobytes())
    with h5py.File(folder / "lf.h5", "w") as file:
        file.create_dataset("LF", GRID.shape, np.uint8, external=[(str(folder.parent / "raw"), 0, GRID.nbytes)])
    return folder


def h5_of_other_shape(folder: Path) -> Path:
    with h5py.File(folder / "lf.h5", "w") as file:
        file["LF"] = GRID[0]
    return folder


def mat_axes(folder: Path) -> Path:
    scipy.io.savemat(folder / "a.mat", {"LF": np.zeros((3, 3, 4), np.uint8)})
    return folder


def mat_key(folder: Path) -> Path:
    scipy.io.savemat(folder / "a.mat", {"data": GRID})
    return folder


def mat_garbage(folder: Path) -> Path:
    (folder / "a.mat").write_bytes(b"MATLAB 5.0 MAT-file" + bytes(range(256)) * 3)
    return folder


def mat_nan(folder: Path) -> Path:
    values = (GRID / 255).astype(np.float32)
    values[1, 1, 5, 5] = np.nan
    scipy.io.savemat(folder / "a.mat", {"LF": values})
    return folder


def quilt(folder: Path) -> Path:
    made.write(folder / "shop_qs5x3a1.png", GRID[0, 0])
    return folder


def quilt_of_nothing(folder: Path) -> Path:
    made.write(folder / "shop_qs0x3a1.png", GRID[0, 0])
    return folder


def no_video(folder: Path) -> Path:
    (folder / "a.mp4").write_bytes(b"\0" * 1000)
    return folder / "a.mp4"


def plain_video(folder: Path) -> Path:
    picture = made.texture(240, 320, 3)
    writer = cv2.VideoWriter(str(folder / "a.mkv"), cv2.VideoWriter.fourcc(*"FFV1"), 12.0, (320, 240))
    writer.write(picture)
    writer.release()
    return folder / "a.mkv"


def archive(folder: Path) -> Path:
    (folder / "scene.zip").write_bytes(b"PK\x03\x04")
    return folder / "scene.zip"


def depth_of_other_size(folder: Path) -> Path:
    made.write_grid(folder / "lf", GRID, "{r:02d}_{c:02d}.png")
    (folder / "attributes.dat").write_text("0 //focalLength\n3 //hRes\n3 //vRes\n")
    (folder / "depth.bin").write_bytes(b"\0" * 100)
    return folder


def two_names_for_a_place(folder: Path) -> Path:
    made.write_grid(folder, GRID)
    made.write(folder / "view_1_1.png", GRID[0, 0])
    return folder


def two_names_for_every_place(folder: Path) -> Path:
    made.write_grid(folder, GRID)
    return made.write_grid(folder, GRID, "view_{r}_{c}.png")


def many_numbers_that_are_no_places(folder: Path) -> Path:
    for numbers in np.random.default_rng(0).integers(0, 3, (60, 12)):
        made.write(folder / f"{'_'.join(map(str, numbers))}.png", GRID[0, 0])
    return folder


CASES: list[tuple[Callable[[Path], Path], str]] = [
    (no_such, "no such scene"),
    (empty, "empty"),
    (holes, "1 of 3x3 views missing: row 1 column 1"),
    (truncated, r"input_Cam007\.png: not a readable picture"),
    (other_size, r"input_Cam003\.png: 64x46 px, but input_Cam004\.png has 64x48"),
    (other_depth, r"input_Cam003\.png: 16-bit, but"),
    (no_picture, r"input_Cam003\.png: not a readable picture"),
    (bomb, "input_Cam004.png"),
    (link_out, "outside of the folder"),
    (link_to_nothing, r"input_Cam005\.png"),
    (nan_disparity, "1 of 3072 values are NaN or infinite"),
    (small_disparity, "64x40 values, the views 64x48"),
    (cut_disparity, "values claimed"),
    (bad_parameters, r"parameters\.cfg"),
    (crowded, f"more than {MAX_FILES} files"),
    (h5_without_key, "no data set LF .*other"),
    (h5_truncated, "not a readable HDF5 file"),
    (h5_leads_out, "links to another file"),
    (h5_kept_elsewhere, "stored in other files"),
    (h5_of_other_shape, r"shape \(3, 48, 64, 3\)"),
    (mat_axes, "3 axes"),
    (mat_key, "no variable LF"),
    (mat_garbage, r"not a readable \.mat"),
    (mat_nan, "NaN or infinite"),
    (quilt, "do not divide into 5 columns and 3 rows"),
    (quilt_of_nothing, "do not divide"),
    (no_video, "not a readable video"),
    (plain_video, "not a mosaic"),
    (archive, "an archive"),
    (depth_of_other_size, "100 bytes"),
    (two_names_for_a_place, "are the same view"),
    (two_names_for_every_place, "are the same view, and so are 8 more pairs"),
    (many_numbers_that_are_no_places, "51 pictures have the same numbers as another one"),
]


@pytest.mark.parametrize(("make", "message"), CASES, ids=lambda value: getattr(value, "__name__", ""))
def test_bad_scene_is_told_clearly(tmp_path: Path, make: Callable[[Path], Path], message: str) -> None:
    (tmp_path / "scene").mkdir()
    path = make(tmp_path / "scene")
    scene = config.Scene(cache_dir=str(tmp_path / "cache"))
    with pytest.raises(UserError, match=message) as told:
        pack_scene(path, scene)
    assert told.value.remedy
    if (tmp_path / "cache" / "scenes").exists():
        assert list((tmp_path / "cache" / "scenes").iterdir()) == []


def test_ten_bit_values_are_not_taken_for_eight(tmp_path: Path) -> None:
    made.write_ppm(tmp_path / "a.ppm", np.full((4, 5, 3), 1000, np.uint16), 1023)
    pixels, full = read_picture(tmp_path / "a.ppm")
    assert (int(pixels.max()), full) == (1000, 1023)


@pytest.mark.parametrize("text", ["9", "x9", "0x3", "9x", "-1x2", "99999x1", "3x3x3", "٣x٣x"])
def test_bad_grids(text: str) -> None:
    with pytest.raises(UserError, match="ROWSxCOLS"):
        parse_grid(text)


def test_a_grid_that_does_not_fit_is_told(tmp_path: Path) -> None:
    made.write_grid(tmp_path, GRID, "v{n}.png")
    with pytest.raises(UserError, match="9 views do not make 2x3"):
        layouts.describe(tmp_path, config.Scene(grid="2x3"))


FUZZ = settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow])
NAMES = [
    "v_00_00.png",
    "input_Cam000.png",
    "lf.h5",
    "a.mat",
    "x_qs4x2a1.png",
    "000_001.ppm",
    "a.mp4",
    "gt_disp_lowres.pfm",
    "out_00_00_1.5_-2.5_.png",
    "parameters.cfg",
    "attributes.dat",
    "v001.png",
    "a_eslf.png",
    "depth.bin",
    "n.jpg",
]


def seeds(folder: Path) -> list[bytes]:
    """Good files of several kinds, to be damaged."""
    made.write(folder / "a.png", GRID[0, 0])
    made.write(folder / "a.jpg", GRID[0, 0])
    made.write_ppm(folder / "a.ppm", GRID[0, 0].astype(np.uint16), 1023)
    made.write_pfm(folder / "a.pfm", made.middle_disparity(48, 64))
    with h5py.File(folder / "a.h5", "w") as file:
        file["LF"] = GRID
        file.attrs["dH"] = 3.0
    scipy.io.savemat(folder / "a.mat", {"LF": GRID})
    (folder / "a.cfg").write_text("[extrinsics]\nnum_cams_x = 3\nnum_cams_y = 3\nbaseline_mm = 1e400\n")
    return [path.read_bytes() for path in sorted(folder.glob("a.*"))]


@FUZZ
@given(data=st.data())
def test_damaged_files_give_a_clear_error_or_a_scene(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    base = tmp_path_factory.mktemp("fuzz")
    good = seeds(base)
    folder = base / "scene"
    folder.mkdir()
    try:
        for name in data.draw(st.lists(st.sampled_from(NAMES), min_size=1, max_size=4, unique=True)):
            body = bytearray(data.draw(st.sampled_from(good)))
            for _ in range(data.draw(st.integers(0, 3))):
                place = data.draw(st.integers(0, len(body) - 1))
                body[place] = data.draw(st.integers(0, 255))
            keep = data.draw(st.integers(0, len(body))) if data.draw(st.booleans()) else len(body)
            (folder / name).write_bytes(bytes(body[:keep]))
        scene = config.Scene(
            layout=data.draw(st.sampled_from(["auto", *layouts.layouts()])), grid=data.draw(st.sampled_from(["", "1x1", "3x2"]))
        )
        try:
            source = layouts.describe(folder, scene)
            view = source.read(0, source.rows // 2, source.cols // 2)
        except UserError as error:
            assert error.message and error.remedy
            return
        assert view.shape[:2] == (source.height_px, source.width_px)
    finally:
        shutil.rmtree(base)


@FUZZ
@given(st.binary(max_size=400))
def test_parsers_of_small_files(tmp_path_factory: pytest.TempPathFactory, body: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "fuzzed"
    for head in (b"", b"Pf\n4 4\n-1.0\n", b"P6\n4 4\n1023\n", b"\x89PNG\r\n\x1a\n"):
        path.write_bytes(head + body)
        for parser in (read_pfm, read_picture):
            try:
                parser(path)
            except UserError as error:
                assert str(path) in error.message
    hci_text.attributes(body.decode("latin-1"))


@given(st.lists(st.integers(0, 700), max_size=7))
def test_axis_order_is_a_permutation_or_none(shape: list[int]) -> None:
    order = mat.axis_order(tuple(shape))
    assert order is None or sorted(order) == list(range(len(shape)))


def test_a_listing_sorts_numbers_as_numbers(tmp_path: Path) -> None:
    for name in ("v10.png", "v2.png", ".hidden"):
        (tmp_path / name).touch()
    assert list_scene(tmp_path).names == ("v2.png", "v10.png")
