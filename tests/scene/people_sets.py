"""Sets of pictures as people have them, drawn small: what each should open as, or why not.

`tests/scene/test_people_sets.py` tests them, and `python -m profiling.scene_layouts` lists them.
"""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene.examination import examine_scene
from tests.scene import made

Pictures = NDArray[np.uint8]
Make = Callable[[Path], Path]


@attrs.frozen(kw_only=True)
class PeopleSet:
    """One set and what it should open as."""

    kind: str
    make: Make  # writes it into an empty folder and returns the path to open
    opens: str = ""  # layout and grid, "" for what should be refused
    sure: bool | None = None  # whether the reading is sure; None: either may be
    text: str = ""  # words of the refusal, of the doubt or of a note
    scene: config.Scene = attrs.field(factory=config.Scene)


def verdict(case: PeopleSet, path: Path) -> tuple[str, str]:
    """("right", "WRONG" or, for what is refused or opened against expectation, "REFUSED" or
    "OPENED"; what happened).
    """
    try:
        examined = examine_scene(path, case.scene)
    except UserError as error:
        what = f"{error.message} ({error.remedy})".replace(str(path), "PATH")
        if case.opens:
            return "REFUSED", what
        return ("right" if case.text in what else "WRONG"), what
    order = examined.orientation
    rows, cols = order.turn.grid(examined.source.rows, examined.source.cols)
    opened = f"{examined.source.layout} {rows}x{cols}"
    what = "; ".join(
        [opened, "sure" if order.sure else f"undecided: {order.undecided}", *examined.source.notes]
    )
    if not case.opens:
        return "OPENED", what
    right = opened == case.opens and case.sure in (None, order.sure) and case.text in what
    return ("right" if right else "WRONG"), what


def walk(grid: Pictures) -> list[Pictures]:
    """The views of a grid row by row."""
    return [view for row in grid for view in row]


def gif(frames: Iterable[Pictures], name: str = "walk.gif") -> Make:
    def make(folder: Path) -> Path:
        pictures = [Image.fromarray(f).quantize(255, dither=Image.Dither.NONE) for f in frames]
        pictures[0].save(folder / name, save_all=True, append_images=pictures[1:], duration=80)
        return folder / name

    return make


def film(frames: list[Pictures], name: str = "walk.mp4") -> Make:
    return lambda folder: made.write_film(folder / name, frames, "mp4v")


def numbered(frames: Sequence[NDArray[Any]], name: str = "frame_{:03d}.png") -> Make:
    def make(folder: Path) -> Path:
        for number, frame in enumerate(frames):
            made.write(folder / name.format(number), frame)
        return folder

    return make


def files(**pictures: NDArray[np.generic]) -> Make:
    """Pictures in a folder; `__` stands for a slash and the last `_` for the dot."""

    def make(folder: Path) -> Path:
        for key, picture in pictures.items():
            made.write(folder / ".".join(key.replace("__", "/").rsplit("_", 1)), picture)
        return folder

    return make


def together(*makes: Callable[[Path], object]) -> Make:
    def make_all(folder: Path) -> Path:
        for make in makes:
            make(folder)
        return folder

    return make_all


def below(name: str, make: Callable[[Path], object]) -> Make:
    def inner(folder: Path) -> Path:
        (folder / name).mkdir(parents=True, exist_ok=True)
        make(folder / name)
        return folder

    return inner


def one(name: str, picture: NDArray[np.generic]) -> Make:
    def make(folder: Path) -> Path:
        made.write(folder / name, picture)
        return folder / name

    return make


def array(values: NDArray[np.generic], name: str = "scene.npy") -> Make:
    def make(folder: Path) -> Path:
        np.save(folder / name, values)
        return folder / name

    return make


def layered(
    x: float, y: float, height: int = 120, width: int = 160, near_px: float = 2.0
) -> Pictures:
    """A view from (x, y) in steps of the camera: a wall, a shape before it, and a nearer one."""
    yy, xx = np.mgrid[:height, :width].astype(np.float32)
    out = np.zeros((height, width, 3), np.uint8)
    for far_share, seed, disc in (
        (-0.5, 1, None),
        (0.25, 2, (0.3, 0.35, 0.2)),
        (1.0, 3, (0.62, 0.6, 0.22)),
    ):
        px = near_px * far_share
        at_x = xx + np.float32(px * x)
        at_y = yy + np.float32(px * y)
        painted = made.texture(2 * height, 2 * width, seed)
        seen = cv2.remap(painted, at_x + width // 2, at_y + height // 2, cv2.INTER_LINEAR)
        if disc is None:
            out = np.asarray(seen, np.uint8)
        else:
            away = np.hypot(at_x - disc[0] * width, at_y - disc[1] * height)
            inside = away < disc[2] * 1.3 * height
            out[inside] = seen[inside]
    return out


def circle(count: int, radius: float = 3.0, upright: float | None = None) -> list[Pictures]:
    """A camera that walks on a circle or ellipse, always looking the same way."""
    angles = 2 * np.pi * np.arange(count) / count
    return [layered(radius * np.cos(a), (upright or radius) * np.sin(a)) for a in angles]


def drive(count: int, eye: float = 0.0) -> list[Pictures]:
    """A camera that drives forward: everything grows and passes."""
    views = []
    for number in range(count):
        view = layered(eye, 0.0, near_px=5.0)
        zoom = cv2.getRotationMatrix2D((80, 60), 0, 1 + 0.12 * number)
        views.append(np.asarray(cv2.warpAffine(view, zoom, (160, 120)), np.uint8))
    return views


def floor(count: int, height: int = 150, width: int = 240) -> list[Pictures]:
    """A floor that recedes, seen by a camera that slides sideways."""
    painted = made.texture(2 * height, 4 * width, 5)
    yy, xx = np.mgrid[:height, :width].astype(np.float32)
    nearness = yy / height
    return [
        np.asarray(
            cv2.remap(
                painted,
                xx + width + np.float32(8 * (k - count / 2)) * nearness,
                yy + 20,
                cv2.INTER_LINEAR,
            ),
            np.uint8,
        )
        for k in range(count)
    ]


def anaglyph(pair: Pictures, down: int = 0) -> Pictures:
    left, right = pair
    right = np.roll(right, down, 0)[..., 1]
    return np.dstack([left[..., 1], right, right])


GRID = made.views(5, 5, 96, 128)
WIDE_PAIR = made.views(1, 2, 192, 256, 6.0, -3.0)[0]
LINE12 = made.views(1, 12, 96, 128)
PHOTO = made.texture(96, 128, 7)
FLOOR_DEPTH = np.repeat(np.linspace(20, 230, 96).astype(np.uint8)[:, None], 128, axis=1)
MILLIMETRES = (4000 - 3000 * np.linspace(0, 1, 96)[:, None] * np.ones(128)).astype(np.uint16)
ALBUM = [made.texture(120, 160, seed) for seed in range(9)]


def far_pair(shift: int, width: int = 900, height: int = 300) -> list[Pictures]:
    """A pair whose views are far apart: the wall moves by less than the shape before it."""
    wall = made.texture(height, 2 * width, 1)
    near = made.texture(height, 2 * width, 3)
    yy, xx = np.mgrid[:height, :width]
    views = []
    for side in (-1, 1):
        view = wall[:, width // 2 + side * shift // 2 :][:, :width].copy()
        centre = width * 0.55 - side * shift * 0.6
        inside = np.hypot(xx - centre, yy - height * 0.55) < height * 0.3
        view[inside] = near[:, width // 2 + int(side * shift * 0.6) :][:, :width][inside]
        views.append(view)
    return views


def quilt(rows: int, cols: int, down: bool, step_px: float = 0.5) -> Pictures:
    line = made.views(1, rows * cols, 150, 200, step_px, -0.6 * step_px)
    tiles = line[0].reshape(rows, cols, 150, 200, 3)
    return np.asarray(made.mosaic(tiles if down else tiles[::-1]), np.uint8)


def recorded(depth_name: str = "{:05d}.png", image: str = "image", ends: str = "jpg") -> Make:
    """Pictures of a depth camera: colour and depth in folders of their own."""
    pictures = [np.roll(PHOTO, 3 * k, 1) for k in range(6)]
    return together(
        below(image, numbered(pictures, "{:05d}." + ends)),
        below("depth", numbered([MILLIMETRES] * 6, depth_name)),
    )


def recorded_together(image: str, ends: str = "png") -> Make:
    """Pictures of a depth camera: colour and depth, numbered in one folder."""
    pictures = [np.roll(PHOTO, 3 * k, 1) for k in range(6)]
    return together(
        numbered(pictures, image + "_{:04d}." + ends),
        numbered([MILLIMETRES] * 6, "depth_{:04d}.png"),
    )


def tum(folder: Path) -> Path:
    """TUM's RGB-D sets: names are times, colour and depth at slightly other ones."""
    for k in range(6):
        made.write(folder / "rgb" / f"{1305031102.175304 + k / 30:.6f}.png", np.roll(PHOTO, k, 1))
        made.write(folder / "depth" / f"{1305031102.160407 + k / 30:.6f}.png", MILLIMETRES)
    (folder / "groundtruth.txt").write_text("x")
    return folder


def sequence(left: str, right: str) -> Make:
    """Pairs over time in two folders."""
    return together(
        below(left, numbered(drive(8), "{:06d}.png")),
        below(right, numbered(drive(8, 1.0), "{:06d}.png")),
    )


def with_maps(kind: str) -> Make:
    """Views, and maps of the same names in a folder."""
    maps = [np.asarray(view[..., :1].repeat(3, 2) // 64 * 64, np.uint8) for view in LINE12[0]]
    return together(
        below("rgb", numbered(list(LINE12[0]), "{:04d}.png")),
        below(kind, numbered(maps, "{:04d}.png")),
    )


def maps_beside(kind: str) -> Make:
    maps = [np.asarray(view // 64 * 64, np.uint8) for view in LINE12[0]]
    return together(
        numbered(list(LINE12[0]), "img_{:04d}.png"), numbered(maps, kind + "_{:04d}.png")
    )


def with_copy(count: int, again: int, last: bool) -> Make:
    """A numbered grid of which one picture is saved twice, under its neighbour's number or the
    last.
    """
    frames = walk(GRID)[:count]
    frames.insert(len(frames) if last else again, frames[again])
    return numbered(frames, "IMG_{:04d}.png")


def refuses(kind: str, make: Make, text: str, **scene: object) -> PeopleSet:
    return PeopleSet(kind=kind, make=make, text=text, scene=config.Scene(**scene))  # type: ignore[arg-type]


def opens(
    kind: str,
    make: Make,
    opened: str,
    sure: bool | None = None,
    text: str = "",
    **scene: object,
) -> PeopleSet:
    return PeopleSet(
        kind=kind,
        make=make,
        opens=opened,
        sure=sure,
        text=text,
        scene=config.Scene(**scene),  # type: ignore[arg-type]
    )


SMALL = made.views(5, 5, 60, 80)
TEN = made.views(10, 10, 60, 80)
MOVED = "near and far"
CIRCLE = "on a circle"
DIFFERENT = "these are different pictures, not one scene from several places"
NOTHING = "nothing moves between these pictures"
FAR = "the views are too far apart"

SETS: dict[str, list[PeopleSet]] = {
    "grids in one file": [
        opens("GIF of 5x5", gif(walk(GRID)), "gif 5x5"),
        opens("GIF of 3x3", gif(walk(made.views(3, 3, 96, 128))), "gif 3x3"),
        opens("GIF of 10x10", gif(walk(TEN)), "gif 10x10"),
        opens("GIF of 4x5, scene.grid", gif(walk(GRID[:4])), "gif 4x5", grid="4x5"),
        refuses("GIF of 25, scene.grid=4x6", gif(walk(GRID)), "25 views", grid="4x6"),
        opens("GIF of a line", gif(LINE12[0]), "gif 1x12"),
        opens("MP4 of 5x5", film(walk(GRID)), "gif 5x5"),
        opens("MP4 of 3x3", film(walk(made.views(3, 3, 96, 128))), "gif 3x3"),
        opens("MP4 of 10x10", film(walk(TEN)), "gif 10x10"),
        opens("MP4 of 5x5, scene.grid", film(walk(GRID)), "gif 5x5", grid="5x5"),
        opens("frames of 5x5", numbered(walk(GRID)), "numbered 5x5"),
        opens("frames of 3x3", numbered(walk(made.views(3, 3, 96, 128))), "numbered 3x3"),
        opens("frames of 10x10", numbered(walk(TEN)), "numbered 10x10"),
        refuses("GIF of a circle", gif(circle(16)), CIRCLE),
        refuses("MP4 of a circle", film(circle(16)), CIRCLE),
        refuses("frames of a circle of 12", numbered(circle(12)), CIRCLE),
        refuses("frames of a circle of 24", numbered(circle(24)), CIRCLE),
        refuses("frames of a wide circle of 9", numbered(circle(9, 5.0)), CIRCLE),
        refuses("frames of a circle of 8", numbered(circle(8)), CIRCLE),
        refuses("frames of an ellipse of 20", numbered(circle(20, 4.0, 1.8)), CIRCLE),
        opens("frames of half a circle", numbered(circle(24, 3.0, 0.4)[:12]), "numbered 1x12"),
        opens(
            "mosaic of small tiles",
            one("grid.png", made.mosaic(made.views(16, 16, 40, 40, 0.5, -0.3))),
            "mosaic 16x16",
        ),
        opens(
            "mosaic of 860 px, 9 tiles",
            one("a.png", cv2.resize(made.mosaic(made.views(9, 9, 96, 96)), (860, 860))),
            "mosaic 9x9",
            grid="9x9",
        ),
    ],
    "folders as recorded": [
        opens("image and depth", recorded(), "rgbd 5x9"),
        opens("rgb and depth", recorded(image="rgb", ends="png"), "rgbd 5x9"),
        opens("color and depth", recorded(image="color"), "rgbd 5x9", text="00001"),
        opens("times of TUM", tum, "rgbd 5x9"),
        opens("one folder down", below("scene01", recorded(image="color")), "rgbd 5x9"),
        opens("images and depth", recorded(image="images"), "rgbd 5x9"),
        opens(
            "rgb_0000.png, depth_0000.png",
            recorded_together("rgb"),
            "rgbd 5x9",
            sure=False,
            text="depth_0001.png",
        ),
        opens(
            "rgb_0000.png, depth_0000.png alone",
            files(rgb_0000_png=PHOTO, depth_0000_png=FLOOR_DEPTH),
            "rgbd 5x9",
            sure=True,
        ),
        opens("color_0000.jpg, depth_0000.png", recorded_together("color", "jpg"), "rgbd 5x9"),
        opens(
            "rgb_0000.png, depth_0000.png, as views",
            together(
                numbered(list(LINE12[0]), "rgb_{:04d}.png"),
                numbered([MILLIMETRES] * 12, "depth_{:04d}.png"),
            ),
            "numbered 1x12",
            layout="numbered",
        ),
        opens(
            "view_0000.png, depth_0000.png",
            together(
                numbered(list(LINE12[0]), "view_{:04d}.png"),
                numbered([MILLIMETRES] * 12, "depth_{:04d}.png"),
            ),
            "numbered 1x12",
        ),
        opens(
            "color, depth, pose",
            together(
                recorded("{:d}.png", "color"),
                below("pose", lambda folder: (folder / "0.txt").write_text("1 0 0")),
            ),
            "rgbd 5x9",
        ),
        opens("image_0, image_1", sequence("image_0", "image_1"), "stereo 1x2", text="000001"),
        opens("image_02, image_03", sequence("image_02", "image_03"), "stereo 1x2"),
        opens("cam0, cam1", sequence("cam0", "cam1"), "stereo 1x2"),
        opens("cam0/data, cam1/data", sequence("cam0/data", "cam1/data"), "stereo 1x2"),
        opens("left_images, right_images", sequence("left_images", "right_images"), "stereo 1x2"),
        opens("left, right", sequence("left", "right"), "stereo 1x2", sure=True, text="000001"),
        opens(
            "left and right among others",
            together(
                files(room_left_png=WIDE_PAIR[0], room_right_png=WIDE_PAIR[1]),
                numbered(ALBUM[:4], "calib_{:02d}.png"),
            ),
            "stereo 1x2",
            sure=True,
        ),
        *(
            opens(f"{kind}/", with_maps(kind), "numbered 1x12")
            for kind in ("class", "seg", "gt", "label", "normal", "flow")
        ),
        *(
            opens(f"{kind}_0000.png", maps_beside(kind), "numbered 1x12")
            for kind in ("class", "seg", "gt", "label", "normal", "flow")
        ),
        opens(
            "rgb.png, depth.png, mask.png",
            files(rgb_png=PHOTO, depth_png=FLOOR_DEPTH, mask_png=FLOOR_DEPTH),
            "rgbd 5x9",
        ),
        opens(
            "rgb.png, depth.png, preview.png",
            files(rgb_png=PHOTO, depth_png=FLOOR_DEPTH, preview_png=PHOTO[::-1]),
            "rgbd 5x9",
        ),
        opens(
            "dog.jpg, dog_depth.png, cat.jpg",
            files(dog_jpg=PHOTO, dog_depth_png=FLOOR_DEPTH, cat_jpg=PHOTO[::-1]),
            "rgbd 5x9",
            text="cat.jpg",
        ),
    ],
    "arrays": [
        opens("(U, V, H, W, C)", array(np.array(SMALL)), "array 5x5"),
        opens("(H, W, U, V, C)", array(SMALL.transpose(2, 3, 0, 1, 4)), "array 5x5"),
        opens("(H, W, U, V)", array(SMALL.transpose(2, 3, 0, 1, 4)[..., 1]), "array 5x5"),
        refuses("views of 5x5 px", array(GRID[:, :, :5, :5]), "views have 5x5 px"),
        refuses(
            "views of 5x5 px, 9x9", array(np.zeros((9, 9, 5, 5, 3), np.uint8)), "views have 5x5 px"
        ),
        opens("line of (1, 101, ...)", array(made.views(1, 60, 48, 64, 1.0, -0.5)), "array 1x60"),
    ],
    "sure or not": [
        opens("quilt from the top", one("a.png", quilt(6, 8, True)), "mosaic 1x48", sure=False),
        opens("quilt, no name", one("a.png", quilt(8, 4, False, 0.05)), "mosaic 1x32", sure=False),
        opens(
            "pair, nothing moves",
            files(x_left_png=WIDE_PAIR[0], x_right_png=WIDE_PAIR[0]),
            "stereo 1x1",
            sure=False,
            text=NOTHING,
        ),
        opens(
            "GIF, nothing moves",
            gif([np.maximum(PHOTO, k) for k in range(30, 37)]),
            "gif 1x1",
            sure=False,
            text=NOTHING,
        ),
        opens(
            "frames, noise only",
            numbered(
                [
                    np.asarray(
                        np.clip(PHOTO + np.random.default_rng(k).normal(0, 3, PHOTO.shape), 0, 255),
                        np.uint8,
                    )
                    for k in range(9)
                ]
            ),
            "numbered 1x1",
            sure=False,
            text=NOTHING,
        ),
        opens(
            "X.left-right.png", one("X.left-right.png", np.hstack(WIDE_PAIR)), "stereo 1x2", True
        ),
        opens(
            "X.top-bottom.png", one("X.top-bottom.png", np.vstack(WIDE_PAIR)), "stereo 1x2", True
        ),
        *(
            opens(
                f"pair, {px} px apart",
                files(x_left_png=far_pair(px)[0], x_right_png=far_pair(px)[1]),
                "stereo 1x2",
                False,
                FAR,
            )
            for px in (160, 240, 320)
        ),
    ],
    "refusals": [
        opens("a floor that recedes", numbered(floor(9)), "numbered 1x9"),
        opens("a floor, 25", numbered(floor(25)), "numbered 1x25"),
        opens("a picture twice", with_copy(25, 7, False), "numbered 5x5", text="same picture"),
        opens(
            "a picture again at the end", with_copy(25, 7, True), "numbered 5x5", text="same pic"
        ),
        refuses(
            "anaglyph, 1 px down",
            one("a.png", anaglyph(made.views(1, 2, 192, 256, 16.0, -8.0)[0], down=1)),
            "anaglyph",
        ),
        refuses(
            "anaglyph.png, small",
            one("x anaglyph.png", anaglyph(made.views(1, 2, 96, 128, 1.6, -0.8)[0])),
            "anaglyph",
        ),
        refuses("album of 9", numbered(ALBUM, "IMG_{:04d}.png"), DIFFERENT),
        refuses("album of 5", numbered(ALBUM[:5], "DSC{:05d}.jpg"), DIFFERENT),
        refuses("album of 2", numbered(ALBUM[:2], "DSC{:05d}.jpg"), DIFFERENT),
    ],
    "remedies": [
        refuses(
            "a folder with one array",
            lambda f: array(np.array(SMALL))(f).parent,
            "PATH/scene.npy",
        ),
    ],
}
