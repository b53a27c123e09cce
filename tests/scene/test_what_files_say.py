"""What a picture file says beats its ending and its custom; what it holds besides is named."""

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import open_header, read_picture
from lfpipe.scene import layouts
from tests.scene import made
from tests.scene.test_pictures import jpeg
from tests.scene.writers import one
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
