"""What a picture file says beats its ending and its custom; what it holds besides is named."""

import contextlib
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import open_header, read_picture
from lfpipe.scene import layouts
from lfpipe.scene.packer import playlist
from lfpipe.scene.video import Video
from tests.scene import made
from tests.scene.test_pictures import jpeg
from tests.scene.writers import one
from tests.support.films import write_av1
from tests.support.stereo_files import (
    DISPARITY,
    THUMBNAIL,
    described,
    indexed,
)

AUTO = config.Scene()
LEFT, MIDDLE, RIGHT = made.views(1, 3, 192, 256, 6.0, -3.0)[0]
SMALL = cv2.resize(LEFT, (64, 48))
VIEWS = made.views(3, 3, 48, 64)


def order(path: Path) -> list[str]:
    """Which of the views above each view of a scene is, in canonical order."""
    source = layouts.describe(path, AUTO)
    turn = source.turn
    assert turn is not None and source.certain
    known = {"left": LEFT, "middle": MIDDLE, "right": RIGHT}
    found = []
    for col in range(source.cols):
        view = source.read(0, *turn.file_index(0, col, 1, source.cols)).astype(int)
        found.append(min(known, key=lambda name: np.abs(view - known[name]).mean()))
    return found


INDEXED = {
    "two": ([LEFT, RIGHT], [DISPARITY] * 2, None),
    "previews between": (
        [LEFT, SMALL, RIGHT, SMALL],
        [DISPARITY, THUMBNAIL, DISPARITY, THUMBNAIL],
        None,
    ),
    "numbered from the left": ([RIGHT, LEFT], [DISPARITY] * 2, [2, 1]),
}


@pytest.mark.parametrize("name", ["P1030933.JPG", "x.mpo", "x.jfif", "without"])
@pytest.mark.parametrize("kind", INDEXED)
def test_the_index_of_a_jpeg_decides_whatever_its_ending(
    tmp_path: Path, kind: str, name: str
) -> None:
    pictures, kinds, numbers = INDEXED[kind]
    path = one(name, indexed([jpeg(picture) for picture in pictures], kinds, numbers))(tmp_path)
    assert order(path) == ["left", "right"]
    notes = " ".join(layouts.describe(path, AUTO).notes)
    assert ("2 more pictures" in notes) == (len(pictures) == 4)


def test_a_card_of_pairs_and_their_flat_twins_is_a_playlist_of_pairs(tmp_path: Path) -> None:
    pair = indexed([jpeg(LEFT), jpeg(RIGHT)], [DISPARITY] * 2)
    for number in range(3):
        one(f"HNI_{number:04d}.MPO", pair)(tmp_path)
        one(f"HNI_{number:04d}.JPG", jpeg(LEFT))(tmp_path)
    with pytest.raises(UserError, match="3 files hold a stereo pair each") as refused:
        layouts.describe(tmp_path, AUTO)
    assert str(tmp_path / "HNI_0000.MPO") in refused.value.remedy
    shown = [tmp_path / f"HNI_{number:04d}.MPO" for number in range(3)]
    assert playlist([tmp_path], AUTO) == (shown, 3)


BESIDE, ABOVE, INTERLEAVED, LEFT_FIRST, HALF_WIDTH = 2, 3, 1, 4, 2


@pytest.mark.parametrize("name", ["shelf.jps", "shelf.jpg"])
def test_the_descriptor_of_a_stereo_jpeg_beats_custom(tmp_path: Path, name: str) -> None:
    def shown(picture: np.ndarray, layout: int, flags: int, kind: int = 1) -> Path:
        folder = tmp_path / f"{len(list(tmp_path.iterdir()))}"
        folder.mkdir()
        return one(name, described(jpeg(picture), layout, flags, kind))(folder)

    assert order(shown(np.hstack([LEFT, RIGHT]), BESIDE, LEFT_FIRST)) == ["left", "right"]
    assert order(shown(np.hstack([RIGHT, LEFT]), BESIDE, 0)) == ["left", "right"]
    assert order(shown(np.vstack([LEFT, RIGHT]), ABOVE, LEFT_FIRST)) == ["left", "right"]
    half = np.hstack([cv2.resize(view, (128, 192)) for view in (LEFT, RIGHT)])
    squeezed = shown(half, BESIDE, LEFT_FIRST | HALF_WIDTH)
    assert order(squeezed) == ["left", "right"]
    assert layouts.describe(squeezed, AUTO).width_px == 256
    assert layouts.describe(shown(LEFT, BESIDE, 0, kind=0), AUTO).cols == 1
    with pytest.raises(UserError, match="interleaved"):
        layouts.describe(shown(LEFT, INTERLEAVED, LEFT_FIRST), AUTO)


@pytest.mark.parametrize("deep", [False, True])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_turned_tiff_files_open_upright(tmp_path: Path, orientation: int, deep: bool) -> None:
    stored = LEFT.astype(np.uint16) * 257 if deep else LEFT
    cv2.imwrite(str(tmp_path / "a.tif"), stored[..., ::-1])
    data = bytearray((tmp_path / "a.tif").read_bytes())
    mark = "<" if data[:2] == b"II" else ">"
    at = struct.unpack_from(mark + "I", data, 4)[0]
    count = struct.unpack_from(mark + "H", data, at)[0]
    entries = [bytes(data[at + 2 + 12 * k : at + 14 + 12 * k]) for k in range(count)]
    entries = [entry for entry in entries if struct.unpack_from(mark + "H", entry)[0] != 274]
    entries.append(struct.pack(mark + "HHIHH", 274, 3, 1, orientation, 0))
    entries.sort(key=lambda entry: struct.unpack_from(mark + "H", entry)[0])
    struct.pack_into(mark + "I", data, 4, len(data))
    table = struct.pack(mark + "H", len(entries)) + b"".join(entries) + bytes(4)
    (tmp_path / "a.tif").write_bytes(bytes(data) + table)
    turned = {
        1: stored,
        2: stored[:, ::-1],
        3: stored[::-1, ::-1],
        4: stored[::-1],
        5: stored.swapaxes(0, 1),
        6: np.rot90(stored, -1),
        7: stored.swapaxes(0, 1)[::-1, ::-1],
        8: np.rot90(stored),
    }
    pixels, _ = read_picture(tmp_path / "a.tif")
    assert np.array_equal(pixels, turned[orientation])
    header = open_header(tmp_path / "a.tif")
    assert (header.height_px, header.width_px) == pixels.shape[:2]


def test_transparent_parts_are_grey_and_said(tmp_path: Path) -> None:
    hidden = np.dstack([VIEWS[0, 0], np.zeros((48, 64), np.uint8)])
    hidden[:, :32, 3] = 255
    for mode, ending in (("RGBA", "png"), ("RGBA", "webp"), ("RGBA", "tif"), ("LA", "png")):
        Image.fromarray(hidden).convert(mode).save(tmp_path / f"a.{ending}", lossless=True)
        pixels, _ = read_picture(tmp_path / f"a.{ending}")
        assert (pixels[:, 32:] == 128).all() and pixels[:, :32].std() > 5
    palette = Image.fromarray(VIEWS[0, 0]).quantize(4)
    palette.save(tmp_path / "a.png", transparency=bytes(4))
    assert (read_picture(tmp_path / "a.png")[0] == 128).all()
    (tmp_path / "views").mkdir()
    for row, col in np.ndindex(3, 3):
        view = np.dstack([VIEWS[row, col], np.full((48, 64), 250, np.uint8)])
        Image.fromarray(view).save(tmp_path / "views" / f"view_{row:02d}_{col:02d}.png")
    notes = " ".join(layouts.describe(tmp_path / "views", AUTO).notes)
    assert "over grey: view_00_00.png" in notes and "5 more" in notes


def test_a_codec_that_opencv_lacks_is_read_by_pyav_or_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("av")
    line = made.views(1, 6, 96, 128, 3.0, 0.5)[0]
    path = write_av1(tmp_path / "slide.mp4", line)
    video = Video(path)
    assert (video.frames, video.width_px, video.height_px) == (6, 128, 96)
    for frame in (3, 0, 5):
        assert np.abs(video.rgb(frame).astype(int) - line[frame]).mean() < 12
    whole = path.read_bytes()
    for at in range(0, len(whole), len(whole) // 40):
        path.write_bytes(whole[:at] + bytes(40) + whole[at + 40 :])
        with contextlib.suppress(UserError):
            Video(path).rgb(0)
    path.write_bytes(whole)
    monkeypatch.setattr("lfpipe.scene.video.find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"\(codec (av01|AV01)\)") as refused:
        Video(path)
    assert "H.264" in refused.value.remedy and " av, " in refused.value.remedy
