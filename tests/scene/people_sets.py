"""Sets of pictures as people have them, drawn small: what each should open as, or why not.

`tests/scene/test_people_sets.py` tests them, and `python -m profiling.scene_layouts` lists them.
"""

import unicodedata
from collections.abc import Callable
from pathlib import Path
from typing import Any

import attrs
import cv2
import h5py
import numpy as np

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene.analysis import analyse_scene
from lfpipe.scene.lightfield import HARDLY_FIT
from lfpipe.scene.source import MAX_FILES
from tests.scene import heic, made
from tests.scene.test_pictures import jpeg, two_streams
from tests.scene.writers import (
    HCI,
    Make,
    Pictures,
    array,
    below,
    files,
    film,
    gif,
    grid,
    h5,
    numbered,
    one,
    together,
    walk,
)
from tests.support.depth_photos import dynamic_depth
from tests.support.stereo_files import PANORAMA, THUMBNAIL, UNDEFINED, indexed

Cure = Callable[[Path], tuple[Path, config.Scene]]


@attrs.frozen(kw_only=True)
class PeopleSet:
    """One set and what it should open as."""

    kind: str
    make: Make  # writes it into an empty folder and returns the path to open
    opens: str = ""  # layout and grid, "" for what should be refused
    sure: bool | None = None  # whether the reading is sure; None: either may be
    text: str = ""  # words of the refusal, of the doubt or of a note
    scene: config.Scene = attrs.field(factory=config.Scene)
    cure: Cure | None = None  # of what is refused: the remedy carried out
    again: bool = False  # one more of a kind: only the profile opens it


def verdict(case: PeopleSet, path: Path) -> tuple[str, str]:
    """("right", "WRONG" or, for what is refused or opened against expectation, "REFUSED" or
    "OPENED"; what happened).
    """
    try:
        found = analyse_scene(path, case.scene)
    except UserError as error:
        what = f"{error.message} (remedy: {error.remedy})".replace(str(path), "PATH")
        if case.opens:
            return "REFUSED", what
        return ("right" if case.text in what else "WRONG"), what
    order = found.orientation
    rows, cols = order.turn.grid(found.source.rows, found.source.cols)
    opened = f"{found.source.layout} {rows}x{cols}"
    size = f"{found.source.width_px}x{found.source.height_px} px"
    sure = "sure" if order.sure else f"undecided: {order.undecided}"
    what = "; ".join([opened, size, sure, *found.source.notes]) + "."
    if not case.opens:
        return "OPENED", what
    right = opened == case.opens and case.sure in (None, order.sure) and case.text in what
    return ("right" if right else "WRONG"), what


def layered(x: float, y: float, near_px: float = 2.0) -> Pictures:
    """A view from (x, y) in steps of the camera."""
    return made.view(x, y, 120, 160, near_px, -near_px / 2)


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
LEFT, RIGHT = WIDE_PAIR
LINE12 = made.views(1, 12, 96, 128)
PHOTO = made.texture(96, 128, 7)
FLOOR_DEPTH = np.repeat(np.linspace(20, 230, 96).astype(np.uint8)[:, None], 128, axis=1)
MILLIMETRES = (4000 - 3000 * np.linspace(0, 1, 96)[:, None] * np.ones(128)).astype(np.uint16)
ALBUM = [made.texture(120, 160, seed) for seed in range(9)]


def far_pair(shift: int) -> Pictures:
    """A pair whose views are far apart: the wall moves by less than the shape before it."""
    return np.asarray(made.views(1, 2, 300, 900, 1.2 * shift, float(shift))[0])


def quilt(rows: int, cols: int, step_px: float) -> Pictures:
    line = made.views(1, rows * cols, 150, 200, step_px, -0.6 * step_px)
    tiles = line[0].reshape(rows, cols, 150, 200, 3)
    return np.asarray(made.mosaic(tiles[::-1]), np.uint8)


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


METRES = (MILLIMETRES / 1000).astype(np.float32)
HOLES = np.random.default_rng(3).random(METRES.shape) < 0.3


def holed(values: np.ndarray, hole: float) -> np.ndarray:
    """A map in which a third of the values means that there is none."""
    return np.where(HOLES, hole, values).astype(values.dtype)


def with_map(name: str, values: np.ndarray) -> Make:
    """A picture and its map, in a format of numbers."""

    def make(folder: Path) -> Path:
        made.write(folder / "x.png", PHOTO)
        path = folder / name
        if path.suffix == ".npy":
            np.save(path, values)
        elif path.suffix == ".npz":
            np.savez(path, depth=values)
        elif path.suffix == ".pfm":
            head = f"Pf\n{values.shape[1]} {values.shape[0]}\n-1\n".encode()
            path.write_bytes(head + values[::-1].astype("<f4").tobytes())
        elif path.suffix == ".h5":
            with h5py.File(path, "w") as file:
                file["depth"] = values
        else:
            cv2.imwrite(str(path), values)
        return folder

    return make


def sequence(left: str, right: str, name: str = "{:06d}.png") -> Make:
    """Pairs over time in two folders."""
    return together(
        below(left, numbered(drive(8), name)),
        below(right, numbered(drive(8, 1.0), name)),
    )


def text_in(*folders: str) -> Make:
    """A file without a picture in each of these folders."""
    return together(*(below(folder, one("data.csv", b"1, 0, 0")) for folder in folders))


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


def refuses(
    kind: str, make: Make, text: str, cure: Cure | None = None, **scene: object
) -> PeopleSet:
    given = config.Scene(**scene)  # type: ignore[arg-type]
    return PeopleSet(kind=kind, make=make, text=text, scene=given, cure=cure)


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


def again(**words: Any) -> Cure:
    """The same path, with settings."""
    return lambda path: (path, config.Scene(**words))


def inside(name: str) -> Cure:
    return lambda path: (path / name, config.Scene())


def without(*names: str) -> Cure:
    return lambda path: (made.without(path, *names), config.Scene())


def more(*sets: PeopleSet) -> list[PeopleSet]:
    """More sets of a kind."""
    return [attrs.evolve(one, again=True) for one in sets]


def anew(make: Make) -> Cure:
    """The scene written once more, or by another program."""

    def cure(path: Path) -> tuple[Path, config.Scene]:
        (path.parent / "anew").mkdir()
        return make(path.parent / "anew"), config.Scene()

    return cure


def burst(group: tuple[bytes, int, int] | None) -> Make:
    return lambda folder: heic.write(folder / "burst.heic", [PHOTO] * 3, group)


def cut_heic(keep: float) -> Make:
    def make(folder: Path) -> Path:
        path = heic.write(folder / "a.heic", [LEFT, RIGHT], (b"ster", 1, 2))
        path.write_bytes(path.read_bytes()[: int(keep * path.stat().st_size)])
        return path

    return make


def second_stream(folder: Path) -> Path:
    path = two_streams(folder / "a.mov", [LEFT] * 4)
    path.write_bytes(path.read_bytes() + b"hdlr" + bytes(8) + b"vide")
    return path


def without_views(folder: Path) -> Path:
    np.savez(folder / "a.npz", other=TWELVE, more=TWELVE)
    return folder / "a.npz"


def too_many_files(folder: Path) -> Path:
    for number in range(MAX_FILES + 1):
        (folder / f"v_{number}.png").touch()
    return folder


def far_apart(px: int) -> PeopleSet:
    left, right = far_pair(px)
    pair = files(x_left_png=left, x_right_png=right)
    return opens(f"pair, {px} px apart", pair, "stereo 1x2", False, FAR)


SMALL = made.views(5, 5, 60, 80)
TEN = made.views(10, 10, 60, 80)
TWELVE = made.views(3, 4, 48, 64)
VIEW = TWELVE[0, 0]
AS_PAIR = anew(files(x_left_png=LEFT, x_right_png=RIGHT))
AS_VIEWS = anew(grid(TWELVE, "view_{n:03d}.jpg"))
AS_DEPTH = anew(
    files(x_png=VIEW, x_depth_png=(60 + 60 * made.middle_disparity(48, 64)).astype(np.uint8))
)
PROMISED = dynamic_depth(jpeg(VIEW), [("Depth", b"")])
PARAMETERS = "[extrinsics]\nnum_cams_x = 4\nnum_cams_y = 3\n"
BY_TWO_NUMBERS = grid(TWELVE, "v_{r}_{c}.png")
BY_ONE_NUMBER = grid(TWELVE, "v{n:02d}.png")
NINE = np.broadcast_to(VIEW, (9, 9, *VIEW.shape))
CROSS = [f"v_{r}_{c}.png" for r in range(9) for c in range(9) if r != 4 and c != 4]
LEFT_PART = [f"v_{r}_{c}.png" for r in range(9) for c in range(4, 9) if (r, c) != (0, 8)]
LINE45 = made.views(1, 45, 91, 102, 0.5, -0.3)[0]
LARGE_TILES = np.array(
    [[cv2.resize(LINE45[5 * (8 - r) + c], (409, 227)) for c in range(5)] for r in range(9)]
)
FRAMED = made.views(4, 6, 90, 120).copy()
FRAMED[:, :, :12], FRAMED[:, :, -9:], FRAMED[:, :, :, :15], FRAMED[:, :, :, -15:] = 0, 0, 0, 0
MORE = "1 more picture in x.jpg"
TILES45 = one("45_01.png", quilt(9, 5, 0.5))
ODD_PLACES = "row 1 column 2, row 2 column 1"
ODD_VIEWS: tuple[tuple[str, str, str, str, list[Make]], ...] = (
    (
        "hci",
        HCI,
        "input_Cam006.png",
        "input_Cam009.png",
        [one("parameters.cfg", b"[extrinsics]\nnum_cams_x = 4\nnum_cams_y = 4\n")],
    ),
    ("rows-cols", "{r:03d}_{c:03d}.png", "001_002.png", "002_001.png", []),
    (
        "stanford",
        "out_{r:02d}_{c:02d}_{r}_{c}_.png",
        "out_01_02_1_2_.png",
        "out_02_01_2_1_.png",
        [],
    ),
)
NOTHING = "nothing moves between these pictures"
FAR = "the views are too far apart"

SETS: dict[str, list[PeopleSet]] = {
    "grids in one file": [
        opens("GIF of 5x5", gif(walk(GRID)), "gif 5x5"),
        *more(
            opens("GIF of 3x3", gif(walk(made.views(3, 3, 96, 128))), "gif 3x3"),
            opens("GIF of 10x10", gif(walk(TEN)), "gif 10x10"),
            opens("GIF of 4x5, scene.grid", gif(walk(GRID[:4])), "gif 4x5", grid="4x5"),
            opens("GIF of a line", gif(LINE12[0]), "gif 1x12"),
        ),
        refuses("GIF of 25, scene.grid=4x6", gif(walk(GRID)), "25 views", grid="4x6"),
        opens("MP4 of 3x3", film(walk(made.views(3, 3, 96, 128))), "gif 3x3"),
        *more(
            opens("MP4 of 5x5", film(walk(GRID)), "gif 5x5"),
            opens("MP4 of 10x10", film(walk(TEN)), "gif 10x10"),
        ),
        opens("MP4 of 5x5, scene.grid", film(walk(GRID)), "gif 5x5", grid="5x5"),
        opens("frames of 10x10", numbered(walk(TEN)), "numbered 10x10"),
        *more(
            opens("frames of 5x5", numbered(walk(GRID)), "numbered 5x5"),
            opens("frames of 3x3", numbered(walk(made.views(3, 3, 96, 128))), "numbered 3x3"),
        ),
        opens("GIF of a circle", gif(circle(16)), "gif 16x1", sure=False),
        refuses("MP4 of a line", film(LINE12[0]), "its frames form no grid", again(layout="gif")),
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
        ),
    ],
    "folders as recorded": [
        opens("image and depth", recorded(), "rgbd 5x9", sure=False, text="frames of one camera"),
        *more(opens("rgb and depth", recorded(image="rgb", ends="png"), "rgbd 5x9", sure=False)),
        opens(
            "rgb and depth, as views",
            together(
                below("rgb", numbered(list(LINE12[0]))),
                below("depth", numbered([MILLIMETRES] * 12)),
            ),
            "numbered 1x12",
            layout="numbered",
        ),
        opens("color and depth", recorded(image="color"), "rgbd 5x9", text="00001"),
        opens("times of TUM", tum, "rgbd 5x9", sure=False, text="frames of one camera"),
        opens("two folders down", below("a", below("b", grid(TWELVE))), "rows-cols 3x4", sure=True),
        *more(opens("images and depth", recorded(image="images"), "rgbd 5x9")),
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
        *more(
            opens("color_0000.jpg, depth_0000.png", recorded_together("color", "jpg"), "rgbd 5x9")
        ),
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
        *more(
            opens("image_02, image_03", sequence("image_02", "image_03"), "stereo 1x2"),
            opens("cam0, cam1", sequence("cam0", "cam1"), "stereo 1x2"),
        ),
        opens(
            "left, right, imu",
            together(sequence("left", "right"), text_in("imu", "")),
            "stereo 1x2",
            text="2 of 16 files used",
        ),
        opens(
            "rows, calib and results",
            together(
                grid(TWELVE, "row_{r}/cam_{c}.jpg"),
                text_in("results", "results/a", "row_1"),
                below("calib", numbered(ALBUM[:3])),
            ),
            "rows-cols 3x4",
            text="not used: calib/",
        ),
        refuses(
            "numbered folders of scenes, and text",
            together(*(below(f"s{k}", grid(TWELVE, "v_{r}_{c}.png")) for k in (1, 2)), text_in("")),
            "(remedy: give one of them, PATH/s1;",
        ),
        opens("left_images, right_images", sequence("left_images", "right_images"), "stereo 1x2"),
        opens("left, right", sequence("left", "right"), "stereo 1x2", sure=True, text="000001"),
        opens(
            "left and right among others",
            together(
                files(room_left_png=LEFT, room_right_png=RIGHT),
                numbered(ALBUM[:4], "calib_{:02d}.png"),
            ),
            "stereo 1x2",
            sure=True,
        ),
        opens("class/", with_maps("class"), "numbered 1x12"),
        opens("gt_0000.png", maps_beside("gt"), "numbered 1x12"),
        *more(
            *(
                opens(f"{kind}/", with_maps(kind), "numbered 1x12")
                for kind in ("seg", "gt", "label", "normal", "flow")
            ),
            *(
                opens(f"{kind}_0000.png", maps_beside(kind), "numbered 1x12")
                for kind in ("class", "seg", "label", "normal", "flow")
            ),
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
    "maps of depth": [
        *(
            opens(name, with_map(name, values), "rgbd 5x9", sure=True, text=text)
            for name, values, text in (
                ("x_depth.npy", METRES, "as in distances"),
                ("x_depth.npz", METRES, "as in distances"),
                ("x_depth.pfm", METRES, "as in distances"),
                ("x_depth.tiff", METRES, "as in distances"),
                ("x_depth.h5", METRES, "as in distances"),
                ("x_disp.npy", 60 / METRES, "white is near"),
                ("xDisparity.png", (60 / METRES * 256).astype(np.uint16), "white is near"),
            )
        ),
        *(
            opens(f"{name}, {hole} is no value", with_map(name, holed(values, hole)), "rgbd 5x9")
            for name, values, hole in (
                ("x_depth.npy", METRES, np.nan),
                ("x_depth.npy", METRES, np.inf),
                ("x_depth.npy", METRES, -1),
                ("x_depth.png", MILLIMETRES, 0),
                ("x_depth.png", MILLIMETRES, 65535),
                ("x_depth.png", FLOOR_DEPTH, 0),
            )
        ),
        opens(
            "float, as networks write it",
            with_map("x_depth.npy", 1000 / METRES),
            "rgbd 5x9",
            sure=False,
            text="near is large",
        ),
        opens(
            "raw",
            together(files(x_png=PHOTO), one("x_depth.raw", b"x")),
            "picture 1x1",
            text="not read: x_depth.raw",
        ),
        refuses(
            "OpenEXR", together(files(x_png=PHOTO), one("x_depth.exr", b"x")), "OpenEXR", AS_DEPTH
        ),
    ],
    "words of names": [
        *(
            opens(
                f"{word}.jpg",
                together(
                    one(f"{word}.jpg", jpeg(PHOTO)), files(**{f"{word}_depth_png": MILLIMETRES})
                ),
                "rgbd 5x9",
                sure=True,
            )
            for word in ("Segovia", "Maskenball", "difference", "Dispensary", "normandy")
        ),
        *(
            opens(left, files(**{left: LEFT, right: RIGHT}), "stereo 1x2", sure=True)
            for left, right in (
                ("leftImg8bit_png", "rightImg8bit_png"),
                ("roomLeft_png", "roomRight_png"),
                ("img_L_png", "img_R_png"),
            )
        ),
        *(
            opens(
                name,
                together(numbered([PHOTO] * 4, name), numbered([MILLIMETRES] * 4, depth)),
                "rgbd 5x9",
                sure=False,
            )
            for name, depth in (
                ("frame-{:06d}.color.png", "frame-{:06d}.depth.png"),
                ("{:04d}_rgb.png", "{:04d}_depth.png"),
                ("colorFrame{:03d}.png", "depthFrame{:03d}.png"),
                ("a_{:03d}_color.png", "a_{:03d}_depth.png"),
            )
        ),
    ],
    "pairs of benchmarks": [
        *(
            opens(
                f"{left}, {right}",
                together(
                    sequence(left, right, "{:06d}_10.png"),
                    below(maps, numbered([MILLIMETRES] * 8, "{:06d}_10.png")),
                ),
                "stereo 1x2",
                text=f"not used: {maps}/",
            )
            for left, right, maps in (
                ("image_2", "image_3", "disp_occ_0"),
                ("colored_0", "colored_1", "disp_noc"),
                ("image_left", "image_right", "depth_left"),
                ("leftImg8bit", "rightImg8bit", "disparity"),
                ("final_left", "final_right", "occlusions"),
            )
        ),
    ],
    "arrays": [
        opens("(U, V, H, W, C)", array(np.array(SMALL)), "array 5x5"),
        opens("(U, V, H, W)", array(SMALL[..., 1]), "array 5x5"),
        refuses("(H, W, U, V, C)", array(SMALL.transpose(2, 3, 0, 1, 4)), "views have 5x5 px"),
        refuses("views of 5x5 px", array(GRID[:, :, :5, :5]), "views have 5x5 px"),
        refuses(
            "views of 5x5 px, 9x9", array(np.zeros((9, 9, 5, 5, 3), np.uint8)), "views have 5x5 px"
        ),
        opens("line of (1, 101, ...)", array(made.views(1, 60, 48, 64, 1.0, -0.5)), "array 1x60"),
    ],
    "sure or not": [
        opens("quilt, no name", one("a.png", quilt(8, 4, 0.05)), "mosaic 1x32", sure=False),
        opens(
            "pair, nothing moves",
            files(x_left_png=WIDE_PAIR[0], x_right_png=WIDE_PAIR[0]),
            "stereo 1x1",
            sure=False,
            text=NOTHING,
        ),
        opens(
            "GIF, nothing moves",
            gif([np.maximum(PHOTO, k) for k in range(30, 100, 10)]),
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
        far_apart(240),
        *more(far_apart(160), far_apart(320)),
    ],
    "notes": [
        opens("a floor that recedes", numbered(floor(9)), "numbered 1x9"),
        *more(opens("a floor, 25", numbered(floor(25)), "numbered 1x25")),
        opens("a picture twice", with_copy(25, 7, False), "numbered 1x26", sure=False),
        opens("a picture again at the end", with_copy(25, 7, True), "numbered 1x26", sure=False),
        *(
            opens(f"anaglyph, {kind}", one(name, picture), "picture 1x1", text="red/cyan anaglyph")
            for kind, name, picture in (
                ("wide", "a.png", anaglyph(WIDE_PAIR)),
                ("by name", "x anaglyph.png", PHOTO),
                (
                    "1 px down",
                    "a.png",
                    anaglyph(made.views(1, 2, 192, 256, 16.0, -8.0)[0], down=1),
                ),
            )
        ),
        *(
            opens(f"album of {len(album)}", numbered(album, name), opened, text=HARDLY_FIT)
            for album, name, opened in (
                (ALBUM, "IMG_{:04d}.png", "numbered 3x3"),
                (ALBUM[:5], "DSC{:05d}.jpg", "numbered 1x5"),
                (ALBUM[:2], "DSC{:05d}.jpg", "numbered 1x2"),
            )
        ),
    ],
    "remedies": [
        refuses("a folder with one array", together(array(np.array(SMALL))), "PATH/scene.npy"),
    ],
    "names": [
        *(
            opens(name, together(make, grid(TWELVE[:0], README_txt="x", __MACOSX_db="x")), opened)
            for name, make, opened in (
                ("rows in folders", grid(TWELVE, "row_{r:02d}/img_{c:02d}.png"), "rows-cols 3x4"),
                ("rows by bare numbers", grid(TWELVE, "{r}/{c}.png"), "rows-cols 3x4"),
                ("one folder down", below("views", grid(TWELVE)), "rows-cols 3x4"),
                ("line breaks", grid(TWELVE, "v\n{r}\n{c}.png"), "rows-cols 3x4"),
                (
                    "running",
                    numbered(TWELVE.reshape(-1, *TWELVE.shape[2:]), "toys{:03d}.png"),
                    "numbered 3x4",
                ),
                (
                    "copies",
                    numbered(TWELVE.reshape(-1, *TWELVE.shape[2:]), "a ({}).png"),
                    "numbered 3x4",
                ),
            )
        ),
        opens(
            "an odd picture among the views",
            together(
                BY_ONE_NUMBER,
                # all views in one, by its size
                files(v12_png=made.texture(80, 200, 1), juntos_jpg=made.texture(80, 200, 1)),
            ),
            "numbered 3x4",
            text="12 of 14 files used; the others are juntos.jpg, v12.png (200x80 px)",
        ),
        opens(
            "views in two formats",
            together(grid(TWELVE, "v_{r}_{c}.jpg"), grid(TWELVE, "v_{r}_{c}.png")),
            "rows-cols 3x4",
            text="12 of 24 files used; the others are v_0_0.png",
        ),
        opens(
            "left/1.png, right/1.png",
            files(left__1_png=LEFT, right__1_png=RIGHT),
            "stereo 1x2",
        ),
        opens(
            "rgb and depth of each view",
            together(below("rgb", grid(TWELVE)), below("depth", grid(TWELVE[..., 1]))),
            "rows-cols 3x4",
            text="12 of 24 files used; the others are depth/view_00_00.png",
        ),
        opens(
            "rows in folders, and a preview",
            together(grid(TWELVE, "row_{r}/{c}.png"), one("preview.png", TWELVE[1, 1])),
            "rows-cols 3x4",
            text="not used: preview.png",
        ),
        *(
            refuses(f"gaps: {kind}", grid(NINE, "v_{r}_{c}.png", *gone), "the names span 9x9 views")
            for kind, gone in (("a cross", CROSS), ("a part", LEFT_PART))
        ),
        *(
            refuses(
                f"scenes in {', '.join(names)}",
                together(*(below(name, grid(TWELVE)) for name in names)),
                f"folders: {', '.join(names)} (remedy: give one of them, PATH/{names[0]};",
            )
            for names in (
                ("flowers", "knights"),
                ("a", "scene 1", "scene 2"),
                ("images", "images_4", "images_8"),
            )
        ),
    ],
    "one picture or two": [
        *(
            opens(
                f"a picture beside {below_it}",
                files(**{"photo_jpg": PHOTO, below_it + "_jpg": PHOTO[:48, :64]}),
                "picture 1x1",
                text="128x96 px; sure.",
            )
            for below_it in ("old__edited__photo 2", "old__photo 2", "thumbs__photo")
        ),
        opens("tiles that no pair has", one("x.png", made.mosaic(GRID[:4, :4])), "mosaic 4x4"),
        opens("a wide picture", one("x.png", made.texture(192, 512, 5)), "picture 1x1"),
        opens(
            "an album of pairs",
            files(
                **{
                    f"{number}_{eye}_png": np.roll(view, roll, 0)
                    for number, roll in (("001", 0), ("002", 40), ("010", 80))
                    for eye, view in zip("LR", WIDE_PAIR, strict=True)
                }
            ),
            "stereo 1x2",
            text="2 of 6 files used; the others are 002_L.png, 002_R.png, 010_L.png, 010_R.png",
        ),
        refuses(
            "car.jpg, car.png", files(car_jpg=PHOTO, car_png=FLOOR_DEPTH), "one picture by its"
        ),
        opens(
            "a photograph of a phone with depth",
            files(
                x_jpg=made.texture(1500, 2000, 1), x_depth_png=cv2.resize(FLOOR_DEPTH, (640, 480))
            ),
            "rgbd 5x9",
            text="for speed",
        ),
        opens("a photograph in HEIC", lambda f: heic.write(f / "a.heic", [PHOTO]), "picture 1x1"),
        opens(
            "what heif-convert writes of a spatial photo",
            files(**{"a-1_jpg": LEFT, "a-2_jpg": RIGHT}),
            "numbered 1x2",
        ),
        *(
            refuses(
                f"a collection in HEIC, {kind}",
                burst(group),
                "a collection of 3 pictures",
                AS_VIEWS,
            )
            for kind, group in (("no group", None), ("alternatives", (b"altr", 1, 2)))
        ),
    ],
    "tiles": [
        opens(
            "a plain background", one("a.png", made.mosaic(FRAMED)), "mosaic 4x6", text="120x90 px"
        ),
        opens(
            "a quilt whose tiles do not divide it",
            one("45_01.jpg", np.pad(made.mosaic(LARGE_TILES), ((0, 1), (0, 1), (0, 0)))),
            "mosaic 1x45",
            text="409x227 px",
        ),
        opens(
            "two pictures that are no video",
            files(
                example01_png=made.mosaic(TWELVE),
                example02_png=made.mosaic(TWELVE[:, :, ::-1, ::-1]),
            ),
            "mosaic-video 3x4",
            text="example01.png",
        ),
    ],
    "refused with a cure": [
        refuses("no such scene", lambda folder: folder / "nowhere", "no such scene"),
        refuses(
            "more files than a light field has", too_many_files, "files; no light field has so many"
        ),
        refuses(
            "a view of other bits",
            together(
                grid(TWELVE, HCI, parameters_cfg=PARAMETERS),
                one("input_Cam003.png", VIEW.astype(np.uint16) * 257),
            ),
            "16-bit, but input_Cam000.png",
        ),
        refuses(
            "beyond the grid of HCI",
            grid(TWELVE, HCI),
            "input_Cam011.png is outside",
            again(grid="3x4"),
            grid="3x3",
        ),
        refuses(
            "h5: another name",
            h5(TWELVE, key="views"),
            "no array LF (it contains:",
            anew(h5(TWELVE)),
        ),
        refuses("h5: wrong axes", h5(TWELVE[0]), "views have 3x64 px", anew(h5(TWELVE))),
        refuses("h5: fewer axes", h5(VIEW), "LF has 3 axes of sizes (48,", anew(h5(TWELVE))),
        opens(
            "two files for a view",
            together(BY_TWO_NUMBERS, one("v_01_01.png", VIEW)),
            "rows-cols 3x4",
            text="12 of 13 files used; the others are v_1_1.png",
        ),
        refuses(
            "a running number",
            BY_ONE_NUMBER,
            "the names contain one running",
            again(layout="numbered"),
            layout="rows-cols",
        ),
        refuses(
            "a grid that does not divide",
            BY_ONE_NUMBER,
            "12 views do not fill 5x5",
            again(),
            grid="5x5",
        ),
        refuses(
            "another grid than the names",
            BY_TWO_NUMBERS,
            "12 views do not fill 4x4",
            again(),
            grid="4x4",
        ),
        refuses(
            "another grid than the layout",
            array(TWELVE),
            "the layout array has 3x4 views,",
            again(),
            grid="4x4",
        ),
        refuses(
            "unnumbered pictures",
            files(beach_png=VIEW, dog_png=VIEW, house_png=VIEW),
            "no layout of a light field",
            inside("beach.png"),
        ),
        refuses(
            "numbered folders of two scenes",
            together(grid(TWELVE, "set1/{r}_{c}.png"), grid(TWELVE, "set2/{r}_{c}.png")),
            "pictures are in 2 folders:",
            inside("set1"),
        ),
        opens(
            "unknown files",
            together(one("a.png", VIEW), *(one(f"{n}.xyz", b"x") for n in range(9))),
            "picture 1x1",
            text="not read: 0.xyz, 1.xyz",
        ),
        refuses(
            "tiles that do not divide",
            one("m.png", made.mosaic(TWELVE)),
            "256x144 px in 30 rows and 40 columns make",
            again(grid="3x4"),
            grid="30x40",
        ),
        refuses(
            "no tiles",
            one("x.png", VIEW),
            "no tiles were recognised in 64x48",
            again(grid="3x4", layout="mosaic"),
            layout="mosaic",
        ),
        refuses(
            "halves that do not match",
            one("x.png", made.texture(96, 256, 5)),
            "its halves are not a stereo",
            AS_PAIR,
            layout="stereo",
        ),
        refuses(
            "no depth",
            one("x_rgbd.png", VIEW),
            "neither half is a grey depth",
            AS_DEPTH,
            layout="rgbd",
        ),
        opens(
            "depth that is promised only",
            one("x.jpg", PROMISED),
            "picture 1x1",
            text="export the depth map as x_depth.png",
        ),
        refuses(
            "depth in false colours",
            files(x_png=VIEW, x_depth_png=TWELVE[2, 2]),
            "depth map has false colours",
            AS_DEPTH,
        ),
        refuses(
            "depth of another shape",
            files(x_png=VIEW, x_depth_png=TWELVE[2, 2, :, :30, 0]),
            "the depth map has 30x48 px",
            AS_DEPTH,
        ),
        refuses(
            "depth of one value",
            files(x_png=VIEW, x_depth_png=VIEW[..., 0] * 0),
            "the depth map has one value",
            AS_DEPTH,
        ),
        refuses("HEIC that is none", one("a.heic", b"x"), "PATH: not a readable picture", AS_VIEWS),
        refuses("Lytro's raw picture", together(one("a.LFR", b"x")), "lfpipe reads PNG", AS_VIEWS),
        refuses(
            "no picture at all",
            together(one("notes.txt", b"x")),
            "no layout of a light field was recognised (notes.txt)",
        ),
        refuses(
            "no layout", BY_TWO_NUMBERS, "scene.layout: 'qilt' is not a", again(), layout="qilt"
        ),
        refuses("no grid", BY_TWO_NUMBERS, "'9' is not ROWSxCOLS", again(grid="3x4"), grid="9"),
        refuses(
            "a grid beyond all",
            BY_TWO_NUMBERS,
            "9999x1000 views; at most 10000 along a",
            again(grid="3x4"),
            grid="9999x1000",
        ),
        refuses(
            "npz: no views",
            without_views,
            "no array 'views'",
        ),
    ],
    "what files say": [
        *(
            opens(
                f"an index of pictures, {kind}",
                one("x.jpg", indexed([jpeg(LEFT), jpeg(second)], kinds)),
                opened,
                text=text,
            )
            for kind, kinds, second, opened, text in (
                ("of no kind", [UNDEFINED] * 2, RIGHT, "stereo 1x2", ""),
                ("unlike", [UNDEFINED] * 2, made.texture(192, 256, 3), "picture 1x1", MORE),
                ("of a panorama", [PANORAMA] * 2, RIGHT, "picture 1x1", MORE),
                ("a thumbnail", [UNDEFINED, THUMBNAIL], RIGHT[::4, ::4], "picture 1x1", MORE),
            )
        ),
        *(
            opens(
                f"JPEGs that end with {ending!r}",
                together(
                    *(
                        one(f"view_{r}_{c}{ending}", jpeg(TWELVE[r, c]))
                        for r, c in np.ndindex(3, 3)
                    ),
                    one("notes", b"no picture"),
                ),
                "rows-cols 3x3",
            )
            for ending in ("", ".jfif", ".jpe", ".insp", ".JPEG_large", ".0001")
        ),
        *(
            refuses(f"{word} as {name}", one(name, data + bytes(40)), word, AS_VIEWS)
            for name, data, word in (
                ("a.tga", b"\0\0\2", "lfpipe reads PNG"),
                ("a.jpg", b"\xff\x0a", "JPEG XL"),
                ("a.png", b"<!DOCTYPE html>", "web page"),
                ("a.tif", b"%PDF-1.4", "PDF"),
                ("a.webp", b"\0\0\0\x18ftypmp42", "a video"),
            )
        ),
        *(
            refuses(
                f"{odd} has 16 bits",
                together(grid(TWELVE), one(odd, TWELVE[0, 0].astype(np.uint16) * 257)),
                f"{odd}: has 16-bit",
                AS_VIEWS,
            )
            for odd in ("view_00_00.png", "view_01_01.png")
        ),
        opens(
            "accents written in two ways",
            together(
                *(
                    one(
                        unicodedata.normalize("NFD" if r == 1 else "NFC", f"é_{r}_{c}.png"),
                        TWELVE[r, c],
                    )
                    for r, c in np.ndindex(3, 3)
                )
            ),
            "rows-cols 3x3",
        ),
        *(
            opens(f"a quilt of nothing, {name}", one(f"x_{name}.png", LEFT), "picture 1x1")
            for name in ("qs0x0a0", "qs0x9", "qs5x0a0.75")
        ),
        *(
            refuses(
                f"halves of {width}x{height} px",
                one("x.jps", jpeg(cv2.resize(LEFT, (width, height)))),
                "too small to show anything",
                AS_PAIR,
            )
            for width, height in ((1, 48), (48, 1), (1, 1), (23, 48))
        ),
        refuses("HEIC cut at 60%", cut_heic(0.6), "PATH: not a readable", AS_PAIR),
        *more(
            *(
                refuses(f"HEIC cut at {keep:.0%}", cut_heic(keep), "PATH: not a readable", AS_PAIR)
                for keep in (0.2, 0.98)
            )
        ),
        refuses(
            "a stream that is declared and not there", second_stream, "the second video stream"
        ),
        refuses(
            "a video of two pictures beside each other",
            film([made.mosaic(np.array([[LEFT, made.texture(192, 256, 3)]]))] * 5),
            "form no grid",
            again(grid="1x2"),
        ),
        *(
            opens(
                f"{layout}, one view missing and one of another size",
                together(grid(made.views(4, 4, 64, 80), name, gone), one(odd, VIEW), *beside),
                f"{layout} 4x4",
                text=text,
            )
            for layout, name, gone, odd, beside in ODD_VIEWS
            for text in ("2 of 4x4 views missing, copied from others: " + ODD_PLACES, "(64x48 px)")
        ),
        opens("45 tiles as a quilt 9x5", TILES45, "quilt 1x45", layout="quilt", grid="9x5"),
        *more(
            opens("45 tiles as a quilt ", TILES45, "quilt 1x45", layout="quilt"),
            opens("45 tiles as a mosaic ", TILES45, "mosaic 9x5", layout="mosaic"),
            opens("45 tiles as a mosaic 9x5", TILES45, "mosaic 9x5", layout="mosaic", grid="9x5"),
        ),
    ],
}
