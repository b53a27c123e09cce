"""Stereo pairs in the forms that people have them: left eye first, or undecided and said so."""

import struct
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene import layouts
from lfpipe.scene.orientation import orient
from tests.scene import made

AUTO = config.Scene()
LEFT, RIGHT = made.views(1, 3, 192, 256, 6.0, -3.0)[0, ::2]


def jpeg(rgb: np.ndarray) -> bytes:
    return cv2.imencode(".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 97])[1].tobytes()


def mpo(first: np.ndarray, second: np.ndarray) -> bytes:
    """Two JPEGs in one file with an index of two entries, as cameras write it."""
    a, b = jpeg(first), jpeg(second)
    index = struct.pack("<H", 3) + struct.pack("<HHI4s", 0xB000, 7, 4, b"0100") + struct.pack("<HHII", 0xB001, 4, 1, 2)
    index += struct.pack("<HHII", 0xB002, 7, 32, 50) + struct.pack("<I", 0)
    length = 2 + 4 + 8 + len(index) + 32
    start = len(a) + 2 + length
    entries = struct.pack("<IIIHH", 0x20020002, start, 0, 0, 0) + struct.pack("<IIIHH", 0x20002, len(b), start - 10, 0, 0)
    return a[:2] + b"\xff\xe2" + struct.pack(">H", length) + b"MPF\0II*\0" + struct.pack("<I", 8) + index + entries + a[2:] + b


def two_files(left: str, right: str, *others: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        made.write(folder / left, LEFT)
        made.write(folder / right, RIGHT)
        for name in others:
            made.write(folder / name, made.texture(192, 256, 3))
        return folder

    return make


def one_file(name: str, picture: np.ndarray, size: tuple[int, int] | None = None) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        made.write(folder / name, picture if size is None else cv2.resize(picture, size, interpolation=cv2.INTER_AREA))
        return folder / name

    return make


def data_file(name: str, data: bytes) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        (folder / name).write_bytes(data)
        return folder / name

    return make


BESIDE = np.hstack([LEFT, RIGHT])
FORMS = {
    "left, right": two_files("room_left.png", "room_right.png"),
    "L, R": two_files("L.jpg", "R.jpg"),
    "gauche, droite": two_files("gauche.jpg", "droite.jpg"),
    "Middlebury": two_files("im2.png", "im6.png", "disp2.png", "disp6.png", "im3.png"),
    "with a map": two_files("a_r_left.png", "a_r_right.png", "a_depth.png"),
    "side by side": one_file("x_sbs.png", BESIDE),
    "half side by side": one_file("x_half-sbs.png", BESIDE, (256, 192)),
    "over and under": one_file("x_ou.png", np.vstack([LEFT, RIGHT])),
    "half over and under": one_file("x_hou.png", np.vstack([LEFT, RIGHT]), (256, 192)),
    "crossed": one_file("x_crosseyed.png", np.hstack([RIGHT, LEFT])),
    "jps": data_file("x.jps", jpeg(np.hstack([RIGHT, LEFT]))),
    "mpo": data_file("x.mpo", mpo(LEFT, RIGHT)),
}


@pytest.mark.parametrize("form", FORMS)
def test_the_left_eye_comes_first(tmp_path: Path, form: str) -> None:
    source = layouts.describe(FORMS[form](tmp_path), AUTO)
    assert (source.layout, source.rows, source.cols) == ("stereo", 1, 2)
    found = orient(source, AUTO)
    assert not found.undecided
    first = source.read(0, *found.turn.file_index(0, 0, 1, 2))
    assert first.shape == LEFT.shape
    assert np.abs(first.astype(int) - LEFT).mean() < 0.6 * np.abs(first.astype(int) - RIGHT).mean()


def test_files_beside_a_pair_are_named(tmp_path: Path) -> None:
    source = layouts.describe(FORMS["Middlebury"](tmp_path), AUTO)
    assert source.notes == ("2 of 5 files used; the others are disp2.png, disp6.png, im3.png",)


def test_of_an_album_of_pairs_the_first_is_shown_and_the_others_are_named(tmp_path: Path) -> None:
    for number, roll in (("001", 0), ("002", 40), ("010", 80)):
        made.write(tmp_path / f"{number}_L.png", np.roll(LEFT, roll, 0))
        made.write(tmp_path / f"{number}_R.png", np.roll(RIGHT, roll, 0))
    source = layouts.describe(tmp_path, AUTO)
    assert (source.layout, source.rows, source.cols) == ("stereo", 1, 2)
    assert np.array_equal(source.read(0, 0, 0), LEFT) and np.array_equal(source.read(0, 0, 1), RIGHT)
    assert source.notes == ("2 of 6 files used; the others are 002_L.png, 002_R.png, 010_L.png, 010_R.png",)


@pytest.mark.parametrize("above", [False, True])
def test_halves_without_a_word_are_found_by_their_content(tmp_path: Path, above: bool) -> None:
    made.write(tmp_path / "x.png", np.vstack([LEFT, RIGHT]) if above else BESIDE)
    source = layouts.describe(tmp_path / "x.png", AUTO)
    assert source.layout == "stereo"
    found = orient(source, AUTO)
    assert found.undecided or np.array_equal(source.read(0, *found.turn.file_index(0, 0, 1, 2)), LEFT)


def test_an_anaglyph_is_refused_with_the_reason(tmp_path: Path) -> None:
    made.write(tmp_path / "x.png", np.dstack([LEFT[..., 0], RIGHT[..., 0], RIGHT[..., 0]]))
    with pytest.raises(UserError, match="anaglyph") as caught:
        layouts.describe(tmp_path / "x.png", AUTO)
    assert "scene.force" in caught.value.remedy
    assert layouts.describe(tmp_path / "x.png", config.Scene(force=True)).rows == 1


def test_the_halves_of_a_mosaic_are_no_pair(tmp_path: Path) -> None:
    made.write(tmp_path / "x.png", made.mosaic(made.views(4, 4, 96, 128)))
    source = layouts.describe(tmp_path / "x.png", AUTO)
    assert (source.layout, source.rows, source.cols) == ("mosaic", 4, 4)


def test_an_ordinary_picture_is_no_pair(tmp_path: Path) -> None:
    made.write(tmp_path / "x.png", made.texture(192, 512, 5))
    assert layouts.describe(tmp_path / "x.png", AUTO).layout == "picture"


@pytest.mark.parametrize(
    ("name", "remedy"), [("a.lfp", "PlenoptiCam"), ("a.LFR", "LFToolbox"), ("a.heic", "heif-convert"), ("a.CR2", "darktable")]
)
def test_what_other_programs_convert_is_refused_with_their_name(tmp_path: Path, name: str, remedy: str) -> None:
    (tmp_path / name).write_bytes(b"anything")
    for path in (tmp_path, tmp_path / name):
        with pytest.raises(UserError) as caught:
            layouts.describe(path, AUTO)
        assert remedy in caught.value.remedy


@pytest.mark.parametrize("cut", [0, 10, 30, 90, 2000])
def test_a_damaged_mpo_is_refused(tmp_path: Path, cut: int) -> None:
    data = bytearray(mpo(LEFT, RIGHT))
    data[cut : cut + 40] = b"\xff" * 40
    (tmp_path / "x.mpo").write_bytes(data[:-cut] if cut == 2000 else data)
    try:
        assert layouts.describe(tmp_path / "x.mpo", AUTO).cols == 2
    except UserError as error:
        assert error.remedy
