"""Each remedy of the layouts' messages, carried out on the scene that was refused, opens it."""

from collections.abc import Callable
from pathlib import Path

import attrs
import cv2
import numpy as np
import pytest

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene import layouts
from lfpipe.scene.plausibility import plausible
from lfpipe.scene.source import SceneSource
from tests.scene import made, test_embedded, test_plausibility, test_stereo

AUTO = config.Scene()
GRID = made.views(3, 4, 48, 64)
FRAME, EYES = made.texture(96, 128, 3), made.views(1, 2, 192, 256, 8.0, -4.0)[0]
Make = Callable[[Path], Path]
Cure = Callable[[Path], tuple[Path, config.Scene]]


@attrs.frozen
class Refused:
    """make writes a scene and returns the path that is given; remedy: part of the message; cure carries it out."""

    make: Make
    remedy: str
    cure: Cure
    given: config.Scene = AUTO


def grid(name: str, *without: str, views: np.ndarray = GRID) -> Make:
    def make(folder: Path) -> Path:
        made.write_grid(folder, views, name)
        for each in without:
            (folder / each).unlink()
        return folder

    return make


def one(name: str, picture: np.ndarray = GRID[0, 0]) -> Make:
    return lambda folder: [made.write(folder / name, picture), folder / name][1]


def both(*makes: Make) -> Make:
    return lambda folder: [make(folder) for make in makes] and folder  # type: ignore[return-value]


def again(**words: object) -> Cure:
    return lambda path: (path, config.Scene(**words))  # type: ignore[arg-type]


def inside(name: str) -> Cure:
    return lambda path: (path / name, AUTO)


def without(name: str) -> Cure:
    return lambda path: [(path / name).unlink(), (path, AUTO)][1]


def renamed(old: str, new: str) -> Cure:
    return lambda path: [(path / old).rename(path / new), (path, AUTO)][1]


def converted(path: Path) -> tuple[Path, config.Scene]:
    """What the program that the message names would have left."""
    new = path.parent / "converted"
    made.write_grid(new, GRID, "view_{n:03d}.jpg")
    return new, AUTO


def bytes_of(name: str, data: bytes = b"x") -> Make:
    return lambda folder: [(folder / name).write_bytes(data), folder / name][1]


def pair_of(path: Path) -> tuple[Path, config.Scene]:
    made.write(path.parent / "pair" / "x_left.png", test_stereo.LEFT)
    made.write(path.parent / "pair" / "x_right.png", test_stereo.RIGHT)
    return path.parent / "pair", AUTO


def depth_beside(path: Path) -> tuple[Path, config.Scene]:
    made.write(path.parent / "both" / "x.png", test_embedded.PICTURE)
    made.write(path.parent / "both" / "x_depth.png", test_embedded.FAR_WHITE)
    return path.parent / "both", AUTO


ANAGLYPH = np.dstack([test_stereo.LEFT[..., 0], test_stereo.RIGHT[..., 0], test_stereo.RIGHT[..., 0]])
NOT_THERE = test_embedded.with_segments(test_embedded.jpeg(GRID[0, 0]), test_embedded.XMP + b'<x GDepth:Format="RangeInverse"/>')
REFUSALS = {
    "a running number": Refused(
        grid("v{n:02d}.png"), "use --layout numbered", again(layout="numbered"), config.Scene(layout="rows-cols")
    ),
    "a grid that does not divide": Refused(grid("v{n:02d}.png"), "leave out --grid", again(), config.Scene(grid="5x5")),
    "another grid than the names": Refused(grid("v_{r}_{c}.png"), "leave out --grid", again(), config.Scene(grid="4x4")),
    "two for one view": Refused(
        both(grid("v_{r}_{c}.png"), grid("v_{r:02d}_{c:02d}.png", views=GRID[:1, :1])),
        "move v_00_00.png away",
        without("v_00_00.png"),
    ),
    "unnumbered pictures": Refused(
        both(one("beach.png"), one("dog.png"), one("house.png")), "one picture by its own path", inside("beach.png")
    ),
    "two scenes": Refused(both(grid("garden/v_{r}_{c}.png"), grid("hall/v_{r}_{c}.png")), "give one of them", inside("garden")),
    "a view of HCI missing": Refused(
        grid("input_Cam{n:03d}.png", "input_Cam005.png"),
        "--layout numbered",
        again(layout="numbered", grid="3x4"),
        config.Scene(grid="3x4"),
    ),
    "a view of Stanford missing": Refused(
        grid("out_{r:02d}_{c:02d}_-{r}.5_{c}.5_.png", "out_01_01_-1.5_1.5_.png"), "--layout rows-cols", again(layout="rows-cols")
    ),
    "beyond the grid of HCI": Refused(
        grid("input_Cam{n:03d}.png"), "scene.grid=ROWSxCOLS", again(grid="3x4"), config.Scene(grid="3x3")
    ),
    "tiles that do not divide": Refused(
        one("m.png", made.mosaic(GRID)), "scene.grid=ROWSxCOLS", again(grid="3x4"), config.Scene(grid="5x7")
    ),
    "a quilt of other tiles": Refused(one("q_qs5x7.png", made.mosaic(GRID)), "scene.grid=ROWSxCOLS", again(grid="3x4")),
    "no tiles": Refused(one("x.png"), "scene.grid=ROWSxCOLS", again(grid="3x4", layout="mosaic"), config.Scene(layout="mosaic")),
    "not one picture": Refused(grid("v_{r}_{c}.png"), "give one file", inside("v_1_1.png"), config.Scene(layout="picture")),
    "a mosaic among others": Refused(
        grid("v_{r}_{c}.png"),
        "give one picture",
        lambda p: (p / "v_1_1.png", config.Scene(layout="mosaic", grid="2x2")),
        config.Scene(layout="mosaic"),
    ),
    "an anaglyph": Refused(one("x.png", ANAGLYPH), "scene.force=true shows it flat", again(force=True)),
    "an anaglyph's pair": Refused(one("x.png", ANAGLYPH), "the stereo pair", pair_of),
    "lenslets": Refused(one("x.png", test_embedded.honeycomb(10.0, False)), "scene.force=true shows it flat", again(force=True)),
    "lenslets, decoded": Refused(one("x.png", test_embedded.honeycomb(10.0, False)), "PlenoptiCam", converted),
    "unrelated pictures": Refused(
        grid("v_{r}_{c}.png", views=test_plausibility.UNRELATED[:9].reshape(3, 3, 120, 160)),
        "scene.force=true",
        again(force=True),
    ),
    "no stereo pair": Refused(
        grid("v_{r}_{c}.png"),
        "x_left.png and x_right.png",
        lambda p: (
            renamed("v_0_0.png", "x_left.png")(p) and (renamed("v_0_1.png", "x_right.png")(p)[0], config.Scene(layout="stereo"))
        ),
        config.Scene(layout="stereo"),
    ),
    "halves that do not match": Refused(
        one("x.png", made.texture(96, 256, 5)), "x_left.png and x_right.png", pair_of, config.Scene(layout="stereo")
    ),
    "no depth": Refused(one("x_rgbd.png"), "x.png and x_depth.png", depth_beside, config.Scene(layout="rgbd")),
    "depth that is promised only": Refused(bytes_of("x.jpg", NOT_THERE), "x.png and x_depth.png", depth_beside),
    "GIF that is damaged": Refused(bytes_of("a.gif", b"GIF89a"), "export it again", converted),
    "no film of mosaics": Refused(
        lambda f: [write_film(f / "a.avi"), f / "a.avi"][1], "--grid ROWSxCOLS", again(grid="2x2", force=True)
    ),
    "film of two eyes": Refused(
        lambda f: [write_film(f / "a.avi", np.hstack((EYES[0], EYES[1]))), f / "a.avi"][1], "--grid 1x2", again(grid="1x2")
    ),
    **{
        name: Refused(bytes_of(name), remedy, converted)
        for name, remedy in {
            "a.heic": "heif-convert",
            "a.CR2": "develop",
            "a.lfp": "PlenoptiCam",
            "a.zip": "unpack",
            "a.psd": "PNG or JPEG",
        }.items()
    },
    "HEIC under another name": Refused(bytes_of("IMG_1.jpg", b"\0\0\0\x18ftypheic" + b"\0" * 99), "export it as JPEG", converted),
}


def write_film(path: Path, frame: np.ndarray = FRAME) -> None:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10, frame.shape[1::-1])
    for _ in range(3):
        writer.write(frame)
    writer.release()


def require_cured(folder: Path, refused: Refused, check: Callable[[SceneSource, bool], SceneSource]) -> None:
    """What refused makes is refused with its remedy, and the remedy opens it. check: the checks behind the layout's own."""

    def opened(path: Path, scene: config.Scene) -> None:
        source = check(layouts.describe(path, scene), scene.force)
        for row, col in {(0, 0), (source.rows - 1, source.cols - 1)} - source.missing:
            assert source.read(0, row, col).size

    folder.mkdir()
    path = refused.make(folder)
    with pytest.raises(UserError) as caught:
        opened(path, refused.given)
    assert refused.remedy in caught.value.remedy
    opened(*refused.cure(path))


@pytest.mark.parametrize("kind", REFUSALS)
def test_the_remedy_opens_the_scene(tmp_path: Path, kind: str) -> None:
    require_cured(tmp_path / "scene", REFUSALS[kind], lambda s, force: s if s.certain else plausible(s, force))
