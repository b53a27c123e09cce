"""Refusals of scenes: what causes each, what it says, and the remedy carried out, which opens the
scene.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import attrs
import cv2
import h5py
import numpy as np
import pytest

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene.examination import examine_scene
from lfpipe.scene.files import MAX_FILES
from tests.scene import made

AUTO = config.Scene()
GRID = made.views(3, 4, 48, 64)
PAIR = made.views(1, 2, 192, 256, 6.0, -3.0)[0]
HCI = "input_Cam{n:03d}.png"
TEXT = "lf/{r:02d}_{c:02d}.png"
Make = Callable[[Path], Path]
Cure = Callable[[Path], tuple[Path, config.Scene]]


@attrs.frozen
class Refused:
    """make writes a scene into an empty folder and returns the path that is given, with the
    settings; text: words of the message; cure does what the remedy says.
    """

    make: Make
    text: str
    cure: Cure | None = None
    given: config.Scene = AUTO


def grid(name: str, *without: str, views: np.ndarray = GRID) -> Make:
    return lambda here: made.without(made.write_grid(here / "s", views, name), *without)


def one(name: str, picture: np.ndarray = GRID[0, 0]) -> Make:
    return lambda here: made.write(here / "s" / name, picture)


def data(name: str, body: bytes = b"x", into: Make | None = None) -> Make:
    """A file; of a scene, given with it."""

    def make(here: Path) -> Path:
        folder = into(here) if into else here / "s"
        folder.mkdir(exist_ok=True)
        (folder / name).write_bytes(body)
        return folder if into else folder / name

    return make


def folder_of(make: Make) -> Make:
    return lambda here: make(here).parent


def both(*makes: Make) -> Make:
    return lambda here: [make(here) for make in makes] and here / "s"  # type: ignore[return-value]


def hci(*more: Callable[[Path], object]) -> Make:
    def make(here: Path) -> Path:
        folder = made.write_grid(here / "s", GRID, HCI)
        (folder / "parameters.cfg").write_text("[extrinsics]\nnum_cams_x = 4\nnum_cams_y = 3\n")
        for change in more:
            change(folder)
        return folder

    return make


def text(attributes: str = "1 //dH\n2 //focalLength\n", depth: bytes = b"") -> Make:
    def make(here: Path) -> Path:
        made.write_grid(here / "s", GRID, TEXT)
        (here / "s" / "attributes.dat").write_text(attributes)
        if depth:
            (here / "s" / "depth.bin").write_bytes(depth)
        return here / "s"

    return make


def h5(name: str = "lf.h5", key: str = "LF", values: np.ndarray = GRID) -> Make:
    def make(here: Path) -> Path:
        (here / "s").mkdir(exist_ok=True)
        with h5py.File(here / "s" / name, "w") as file:
            file[key] = values
        return here / "s"

    return make


def again(**words: Any) -> Cure:
    return lambda path: (path, config.Scene(**words))


def inside(name: str) -> Cure:
    return lambda path: (path / name, AUTO)


def without(*names: str) -> Cure:
    return lambda path: (made.without(path, *names), AUTO)


def anew(make: Make) -> Cure:
    """The scene written once more, or by another program."""

    def cure(path: Path) -> tuple[Path, config.Scene]:
        (path.parent / "anew").mkdir()
        return make(path.parent / "anew"), AUTO

    return cure


LEFT, RIGHT = PAIR
AS_PAIR = anew(both(one("x_left.png", LEFT), one("x_right.png", RIGHT)))
AS_VIEWS = anew(grid("view_{n:03d}.jpg"))
AS_DEPTH = anew(
    both(
        one("x.png"), one("x_depth.png", (60 + 60 * made.middle_disparity(48, 64)).astype(np.uint8))
    )
)
XMP = b"http://ns.adobe.com/xap/1.0/\0" + b'<x GDepth:Format="RangeInverse"/>'
SMALL_JPEG = cv2.imencode(".jpg", GRID[0, 0])[1].tobytes()
PROMISED = SMALL_JPEG[:2] + b"\xff\xe1" + (len(XMP) + 2).to_bytes(2) + XMP + SMALL_JPEG[2:]


def too_many_files(here: Path) -> Path:
    for number in range(MAX_FILES + 1):
        (here / f"v_{number}.png").touch()
    return here


REFUSALS = {
    "no such scene": Refused(lambda here: here / "nowhere", "no such scene"),
    "more files than a light field has": Refused(
        too_many_files,
        "more than 20000 files; no",
    ),
    "a view of other bits": Refused(
        hci(lambda f: made.write(f / "input_Cam003.png", GRID[0, 0].astype(np.uint16) * 257)),
        "16-bit, but input_Cam006.png",
    ),
    "beyond the grid of HCI": Refused(
        grid(HCI), "input_Cam011.png is outside", again(grid="3x4"), config.Scene(grid="3x3")
    ),
    "h5: another name": Refused(h5(key="views"), "no array LF (it contains:", anew(h5())),
    "h5: wrong axes": Refused(h5(values=GRID[0]), "LF has 4 axes of sizes (4,", anew(h5())),
    "hci-text: no attributes": Refused(
        lambda here: text()(here) / "lf",
        "no attributes.dat next to a",
        lambda path: (path.parent, AUTO),
        config.Scene(layout="hci-text"),
    ),
    "two files for a view": Refused(
        both(grid("v_{r}_{c}.png"), one("v_01_01.png")),
        "v_01_01.png and v_1_1.png are",
        without("v_1_1.png"),
    ),
    "a running number": Refused(
        grid("v{n:02d}.png"),
        "the names contain one running",
        again(layout="numbered"),
        config.Scene(layout="rows-cols"),
    ),
    "a grid that does not divide": Refused(
        grid("v{n:02d}.png"), "12 views do not make 5x5", again(), config.Scene(grid="5x5")
    ),
    "another grid than the names": Refused(
        grid("v_{r}_{c}.png"),
        "the names give a grid of 3x4,",
        again(),
        config.Scene(grid="4x4"),
    ),
    "another grid than the layout": Refused(
        text(), "the layout hci-text has 3x4 views,", again(), config.Scene(grid="4x4")
    ),
    "unnumbered pictures": Refused(
        both(*(one(f"{name}.png") for name in ("beach", "dog", "house"))),
        "no layout of a light field",
        inside("beach.png"),
    ),
    "folders of two scenes": Refused(
        both(grid("garden/v_{r}_{c}.png"), grid("hall/v_{r}_{c}.png")),
        "pictures stand in 2 folders:",
        inside("garden"),
    ),
    "numbered folders of two scenes": Refused(
        both(grid("set1/{r}_{c}.png"), grid("set2/{r}_{c}.png")),
        "pictures stand in 2 folders:",
        inside("set1"),
    ),
    "unknown files": Refused(
        both(one("a.png"), *(data(f"{n}.xyz") for n in range(9))),
        "9 of 10 files are of a kind",
        inside("a.png"),
    ),
    "tiles that do not divide": Refused(
        one("m.png", made.mosaic(GRID)),
        "256x144 px in 30 rows and 40 columns make",
        again(grid="3x4"),
        config.Scene(grid="30x40"),
    ),
    "no tiles": Refused(
        one("x.png"),
        "no tiles were recognised in 64x48",
        again(grid="3x4", layout="mosaic"),
        config.Scene(layout="mosaic"),
    ),
    "halves that do not match": Refused(
        one("x.png", made.texture(96, 256, 5)),
        "its halves are no stereo",
        AS_PAIR,
        config.Scene(layout="stereo"),
    ),
    "an anaglyph": Refused(
        one("x.png", np.dstack([LEFT[..., 0], RIGHT[..., 0], RIGHT[..., 0]])),
        "a red/cyan anaglyph: each",
        again(force=True),
    ),
    "lenslets": Refused(
        one("x.png", made.honeycomb(10.0)), "a raw picture of a plenoptic", again(force=True)
    ),
    "no depth": Refused(
        one("x_rgbd.png"), "neither half is a grey depth", AS_DEPTH, config.Scene(layout="rgbd")
    ),
    "depth that is promised only": Refused(
        data("x.jpg", PROMISED), "claims to contain a depth", AS_DEPTH
    ),
    "depth in false colours": Refused(
        both(one("x.png"), one("x_depth.png", GRID[2, 2])), "depth map has false colours", AS_DEPTH
    ),
    "depth in floats": Refused(
        both(one("x.png"), one("x_depth.tiff", made.middle_disparity(48, 64))),
        "not a readable picture",
        AS_DEPTH,
    ),
    "depth of another shape": Refused(
        both(one("x.png"), one("x_depth.png", GRID[2, 2, :, :30, 0])),
        "the depth map has 30x48 px",
        AS_DEPTH,
    ),
    "depth of one value": Refused(
        both(one("x.png"), one("x_depth.png", GRID[2, 2, ..., 0] * 0)),
        "the depth map has one value",
        AS_DEPTH,
    ),
    "HEIC": Refused(data("a.heic"), "a.heic: ", AS_VIEWS),
    "Lytro's raw picture": Refused(folder_of(data("a.LFR")), "a raw picture of a Lytro", AS_VIEWS),
    "no picture at all": Refused(folder_of(data("notes.txt")), "no layout of a light field"),
    "no layout": Refused(
        grid("v_{r}_{c}.png"), "scene.layout: 'qilt' is not a", again(), config.Scene(layout="qilt")
    ),
    "no grid": Refused(
        grid("v_{r}_{c}.png"), "'9' is not ROWSxCOLS", again(grid="3x4"), config.Scene(grid="9")
    ),
    "a grid beyond all": Refused(
        grid("v_{r}_{c}.png"),
        "9999x1000 views; at most 10000 along a",
        again(grid="3x4"),
        config.Scene(grid="9999x1000"),
    ),
    "npz: no views": Refused(
        lambda here: made.write_npz(here / "a.npz", other=GRID, more=GRID), "no array 'views'"
    ),
}


@pytest.mark.parametrize("name", REFUSALS)
def test_the_remedy_opens_the_scene(tmp_path: Path, name: str) -> None:
    row = REFUSALS[name]
    path = row.make(tmp_path)
    with pytest.raises(UserError) as refused:
        examine_scene(path, row.given)
    assert row.text in refused.value.message and refused.value.remedy
    if row.cure is not None:
        source = examine_scene(*row.cure(path)).source
        for row_col in {(0, 0), (source.rows - 1, source.cols - 1)} - source.missing:
            assert source.read(0, *row_col).size
