"""Scenes of one or two pictures: stereo pairs, pictures with depth, photographs of phones, wiggles,
and what none of them is.
"""

import io
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene import layouts, video
from lfpipe.scene.analysis import analyse_scene
from lfpipe.scene.layouts import single
from lfpipe.scene.orientation import orient
from lfpipe.scene.packer import playlist
from lfpipe.scene.packing import warped_disparity, warped_view
from tests.scene import heic, made
from tests.scene.writers import Make, files, film, one, together
from tests.support.depth_photos import dynamic_depth, gdepth
from tests.support.films import write_stamped

AUTO = config.Scene()
LEFT, RIGHT = made.views(1, 3, 192, 256, 6.0, -3.0)[0, ::2]
PICTURE = made.views(1, 1, 96, 128, 1.0, -1.0)[0, 0]
DISPARITY = made.middle_disparity(96, 128, 1.0, -1.0)
DEPTH = np.repeat(((DISPARITY + 1) * 127).astype(np.uint8)[..., None], 3, axis=2)
FAR_WHITE = np.asarray((1 - DISPARITY) * 127, np.uint8)
# brighter below, where a floor is nearer
FLOOR = np.repeat(np.linspace(20, 230, 96).astype(np.uint8)[:, None], 128, axis=1)


def jpeg(picture: np.ndarray) -> bytes:
    return bytes(
        cv2.imencode(
            ".jpg",
            picture if picture.ndim == 2 else picture[..., ::-1],
            [cv2.IMWRITE_JPEG_QUALITY, 97],
        )[1]
    )


def mpo(first: np.ndarray, second: np.ndarray) -> bytes:
    """Two JPEGs in one file, as cameras write it."""
    file = io.BytesIO()
    Image.fromarray(first).save(
        file, "MPO", save_all=True, append_images=[Image.fromarray(second)], quality=97
    )
    return file.getvalue()


def two_streams(path: Path, *streams: list[np.ndarray]) -> Path:
    """A video of several streams, as 3D cameras write it."""
    av = pytest.importorskip("av")
    with av.open(str(path), "w") as container:
        for pictures in streams:
            stream = container.add_stream("mjpeg", rate=12)
            stream.height, stream.width = pictures[0].shape[:2]
            stream.pix_fmt = "yuvj420p"
            stream.options = {"qscale": "2"}
        for moment in zip(*streams, strict=True):
            for stream, picture in zip(container.streams, moment, strict=True):
                container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, "rgb24")))
        for stream in container.streams:
            container.mux(stream.encode())
    return path


BESIDE = np.hstack([LEFT, RIGHT])
OTHER = made.texture(192, 256, 3)
PAIRS: dict[str, Make] = {
    "left, right": files(room_left_png=LEFT, room_right_png=RIGHT),
    "L, R": files(L_jpg=LEFT, R_jpg=RIGHT),
    "Middlebury": files(
        im2_png=LEFT, im6_png=RIGHT, disp2_png=OTHER, disp6_png=OTHER, im3_png=OTHER
    ),
    "with a map": files(a_r_left_png=LEFT, a_r_right_png=RIGHT, a_depth_png=OTHER),
    "side by side": one("x_sbs.png", BESIDE),
    "half side by side": one("x_half-sbs.png", BESIDE, (256, 192)),
    "over and under": one("x_ou.png", np.vstack([LEFT, RIGHT])),
    "half over and under": one("x_hou.png", np.vstack([LEFT, RIGHT]), (256, 192)),
    "crossed": one("x_crosseyed.png", np.hstack([RIGHT, LEFT])),
    "jps": one("x.jps", jpeg(np.hstack([RIGHT, LEFT]))),
    "mpo": one("x.mpo", mpo(LEFT, RIGHT)),
    "spatial photo": lambda f: heic.write(f / "x.heic", [LEFT, RIGHT], (b"ster", 1, 2)),
    "spatial photo, right first": lambda f: heic.write(
        f / "x.heic", [RIGHT, LEFT], (b"ster", 2, 1)
    ),
    "spatial photo in its folder": together(
        lambda f: heic.write(f / "IMG_0001.HEIC", [LEFT, RIGHT], (b"ster", 1, 2))
    ),
}
WITH_DEPTH: dict[str, Make] = {
    "beside": one("x_rgbd.png", np.hstack([PICTURE, DEPTH])),
    "depth first": one("x_rgbd.png", np.hstack([DEPTH, PICTURE])),
    "below": one("x_rgbd.png", np.vstack([PICTURE, DEPTH])),
    "two files": files(x_png=PICTURE, x_depth_png=DEPTH[..., 0]),
    "named by content": files(rgb_png=PICTURE, depth_png=DEPTH[..., 0]),
    "named before": files(photo_png=PICTURE, depth_photo_png=DEPTH[..., 0]),
    "named by a network": files(
        **{"photo_png": PICTURE, "photo-dpt_beit_large_512_png": DEPTH[..., 0]}
    ),
    "HEIC": lambda f: heic.write(f / "a.heic", [PICTURE], depth=DEPTH[..., 0].copy()),
}


@pytest.mark.parametrize("form", PAIRS)
def test_the_left_eye_comes_first(tmp_path: Path, form: str) -> None:
    source = layouts.describe(PAIRS[form](tmp_path), AUTO)
    assert (source.layout, source.rows, source.cols) == ("stereo", 1, 2)
    order = orient(source, AUTO)
    assert not order.undecided
    first = source.read(0, *order.turn.file_index(0, 0, 1, 2))
    assert first.shape == LEFT.shape
    assert np.abs(first.astype(int) - LEFT).mean() < 0.6 * np.abs(first.astype(int) - RIGHT).mean()
    if form == "Middlebury":
        assert source.notes == ("2 of 5 files used; the others are disp2.png, disp6.png, im3.png",)


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("{}_left.png", "{}_right.png"),
        ("left/{}.png", "right/{}.png"),
        ("image_2/{:06d}_10.png", "image_3/{:06d}_10.png"),
        ("leftImg8bit/a_{}_leftImg8bit.png", "rightImg8bit/a_{}_rightImg8bit.png"),
    ],
)
def test_several_pairs_are_a_playlist_of_their_left_pictures(
    tmp_path: Path, left: str, right: str
) -> None:
    for number in range(3):
        made.write(tmp_path / left.format(number), np.roll(LEFT, 9 * number, 1))
        made.write(tmp_path / right.format(number), np.roll(RIGHT, 9 * number, 1))
    source = layouts.describe(tmp_path, AUTO)
    assert source.layout == "stereo" and any("all 3 pairs" in note for note in source.notes)
    scenes, others = playlist([tmp_path], AUTO)
    assert others == 0 and scenes == [tmp_path / left.format(number) for number in range(3)]
    for number, path in enumerate(scenes):
        source = layouts.describe(path, AUTO)
        assert (source.layout, source.cols, source.path) == ("stereo", 2, path)
        for col, eye in enumerate((LEFT, RIGHT)):
            assert np.array_equal(source.read(0, 0, col), np.roll(eye, 9 * number, 1))
    assert layouts.describe(tmp_path / right.format(0), AUTO).layout == "picture"
    alone = layouts.describe(scenes[0], config.Scene(layout="picture"))
    assert np.array_equal(alone.read(0, 0, 0), LEFT)


OVER = np.vstack([LEFT, RIGHT])
HALF = np.hstack([LEFT[:, ::2], RIGHT[:, ::2]])
# by name, one frame, and black frames before it
FILMS = {
    "x_TB.mp4": (OVER, 0),
    "x_BT.mp4": (OVER[np.r_[192:384, 0:192]], 0),
    "x-top-bottom.avi": (OVER, 2),
    "x_3dv.avi": (OVER, 0),
    "x_half-ou.mkv": (np.vstack([LEFT[::2], RIGHT[::2]]), 0),
    "x.H-TAB.mkv": (np.vstack([LEFT[::2], RIGHT[::2]]), 0),
    "x_HSBS.mp4": (HALF, 0),
    "x Half-SBS.mp4": (HALF, 3),
    "x_LR.mp4": (BESIDE, 0),
    "x_SBS.mp4": (BESIDE, 9),
    "x_RL.mp4": (np.hstack([RIGHT, LEFT]), 0),
    "x.mp4": (BESIDE, 5),
    "y.mp4": (OVER, 5),
}


@pytest.mark.parametrize("name", FILMS)
def test_a_stereo_video_follows_the_rules_of_a_picture(tmp_path: Path, name: str) -> None:
    frame, black = FILMS[name]
    frames = [np.zeros_like(frame)] * black + [frame // 8] * (black > 0) + [frame] * 12
    found = analyse_scene(film(frames, name)(tmp_path), AUTO)
    source = found.source
    assert (source.layout, source.rows, source.cols) == ("stereo", 1, 2)
    assert (source.frames, source.height_px, source.width_px) == (len(frames), 192, 256)
    left = source.read(len(frames) - 1, *found.orientation.turn.file_index(0, 0, 1, 2))
    off = [np.abs(left.astype(int) - eye).mean() for eye in (LEFT, RIGHT)]
    assert off[0] < off[1] or found.orientation.undecided
    # as of the picture
    picture = made.write(tmp_path / f"{Path(name).stem}.png", frame)
    still = analyse_scene(picture, AUTO)
    assert still.source.layout == "stereo"
    assert bool(still.orientation.undecided) == bool(found.orientation.undecided)
    assert still.turn == found.turn


@pytest.mark.parametrize("name", ["DSCF0042.AVI", "a.mkv", "a.mov"])
@pytest.mark.parametrize("pair", [True, False])
def test_two_streams_are_a_pair_or_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, pair: bool
) -> None:
    path = two_streams(tmp_path / name, [LEFT] * 4, [RIGHT if pair else OTHER] * 4)
    if pair:
        source = layouts.describe(path, AUTO)
        assert (source.layout, source.rows, source.cols, source.frames) == ("stereo", 1, 2, 4)
        for col, eye in enumerate((LEFT, RIGHT)):
            assert np.abs(source.read(1, 0, col).astype(int) - eye).mean() < 8
        monkeypatch.setattr(video, "find_spec", lambda name: None)
        monkeypatch.setattr(single, "find_spec", lambda name: None)
        single._arrangement.cache_clear()
    with pytest.raises(UserError, match="the second video stream") as caught:
        layouts.describe(path, AUTO)
    assert ("another package" in caught.value.message) == pair


@pytest.mark.parametrize("form", WITH_DEPTH)
def test_near_moves_to_the_left_as_the_camera_moves_to_the_right(tmp_path: Path, form: str) -> None:
    source = layouts.describe(WITH_DEPTH[form](tmp_path), AUTO)
    assert (source.layout, source.rows, source.cols) == ("rgbd", 5, 9)
    seen = source.read(0, 2, 4)
    assert np.abs(seen.astype(int) - PICTURE).mean() <= 2 * (form == "HEIC")
    moved = source.read(0, 2, 6).astype(int)
    near = DISPARITY == 1
    shift = round(2 * 0.5 * 0.008 * 128)
    inner = near & np.roll(near, 5, axis=1) & np.roll(near, -5, axis=1)
    y, x = np.nonzero(np.roll(inner, -shift, axis=1))
    assert np.abs(moved[y, x] - np.roll(PICTURE, -shift, axis=1)[y, x]).mean() < 3
    if form == "two files":
        assert "whether white is near" in source.doubt and "invert_depth" in source.doubt


def test_what_was_hidden_is_filled_from_behind() -> None:
    far = np.full((40, 60), 50, np.uint8)
    near = np.zeros((40, 60), bool)
    near[10:30, 20:40] = True
    picture = np.where(near, 200, far).astype(np.uint8)
    disparity = np.where(near, 2.0, -1.0).astype(np.float32)
    view = warped_view(picture, disparity, warped_disparity(disparity, 0, 3), 0, 3)
    assert (view == 200).sum() == pytest.approx(400, abs=45)
    assert not ((view > 60) & (view < 190)).sum() > 60


KINECT = (np.linspace(4, 1, 96)[:, None] * np.ones(128)).astype(np.float32)  # metres
STRETCHED = ((FLOOR.astype(np.float32) - 20) / 210 * 65535).astype(np.uint16)
HOLES = np.zeros((96, 128), bool)
HOLES[60:70, 30:50] = HOLES[:, :6] = True


@pytest.mark.parametrize(
    ("depth", "doubt"),
    [(FLOOR, False), (255 - FLOOR, True), (STRETCHED, False)]
    # Kinect; TUM; KITTI
    + [
        (np.where(HOLES, 0, KINECT * per_m).astype(np.uint16), False) for per_m in (1000, 5000, 256)
    ],
)
def test_a_depth_map_is_read_as_what_stands_lower_is_nearer(
    depth: np.ndarray, doubt: bool, tmp_path: Path
) -> None:
    source = layouts.describe(files(x_png=PICTURE, x_depth_png=depth)(tmp_path), AUTO)
    disparity = source.truth[2, 4]()
    above, below = float(disparity[2].mean()), float(disparity[-3].mean())
    assert below > above and bool(source.doubt) == doubt
    if depth.min() == 0 and depth is not STRETCHED:
        assert "distances" in source.notes[0]
        # no pit, no peak
        assert np.abs(disparity[62:68, 32:48] - disparity[62:68, 60:76]).max() < 0.2 * (
            below - above
        )


VIDEO = b"\0\0\0\x18ftypmp42" + b"video" * 50
FAR_JPEG, FAR_PNG = jpeg(FAR_WHITE), bytes(cv2.imencode(".png", FAR_WHITE)[1])
ITEMS = [("Depth", FAR_JPEG), ("MotionPhoto", VIDEO)]
PORTRAIT = dynamic_depth(jpeg(PICTURE), ITEMS)
LINEAR = np.asarray(1 / (1 - 0.4 * (1 - DISPARITY)), np.float64)  # of a depth of 1 to 5
LINEAR_PNG = bytes(cv2.imencode(".png", np.rint((LINEAR - 1) / 4 * 255).astype(np.uint8))[1])
RANGE = {"Format": "RangeLinear", "Near": 1, "Far": 5}
INVERSE = {"Format": "RangeInverse", "Near": "0.9", "Far": "4.2"}
PORTRAITS = {
    "kinds": PORTRAIT,
    "elements": dynamic_depth(jpeg(PICTURE), ITEMS, apart=True),
    "other prefixes": dynamic_depth(jpeg(PICTURE), ITEMS, prefix="ns1"),
    "extended": dynamic_depth(jpeg(PICTURE), ITEMS, extended=True),
    "addresses": dynamic_depth(jpeg(PICTURE), ITEMS, uris=True, stated=INVERSE),
    "addresses, elements": dynamic_depth(
        jpeg(PICTURE), ITEMS, uris=True, apart=True, stated=INVERSE, extended=True
    ),
    "PNG": dynamic_depth(jpeg(PICTURE), [("Depth", FAR_PNG)]),
    "before other data": PORTRAIT + b"SEFT" * 20,
    "behind other items": dynamic_depth(jpeg(PICTURE), [("GainMap", jpeg(FLOOR)), *ITEMS]),
    "GDepth": gdepth(jpeg(PICTURE), FAR_PNG, INVERSE),
    "GDepth, elements": gdepth(jpeg(PICTURE), FAR_JPEG, INVERSE, apart=True, prefix="d"),
    "GDepth, linear": gdepth(jpeg(PICTURE), LINEAR_PNG, RANGE),
}


@pytest.mark.parametrize("kind", PORTRAITS)
def test_depth_in_a_photograph_is_read_however_it_is_spelt(tmp_path: Path, kind: str) -> None:
    source = layouts.describe(one("PORTRAIT_20260704.jpg", PORTRAITS[kind])(tmp_path), AUTO)
    assert (source.layout, source.rows, source.cols) == ("rgbd", 5, 9)
    assert np.abs(source.read(0, 2, 4).astype(int) - PICTURE).mean() < 3
    assert np.corrcoef(source.truth[2, 4]().ravel(), DISPARITY.ravel())[0, 1] > 0.95


@pytest.mark.parametrize(
    ("value", "frame"), [(1, OVER), (2, BESIDE), (4, np.hstack([RIGHT, LEFT])), (0, BESIDE)]
)
def test_a_box_of_mp4_states_arrangement_and_order(
    tmp_path: Path, value: int, frame: np.ndarray
) -> None:
    pytest.importorskip("av")
    path = write_stamped(tmp_path / "film.mp4", [frame] * 6, range(0, 240, 40))
    path.write_bytes(path.read_bytes() + b"\0\0\0\x0dst3d\0\0\0\0" + bytes([value]))
    found = analyse_scene(path, AUTO)
    assert (found.source.layout, found.source.cols) == ("stereo", 2)
    assert bool(found.orientation.undecided) == (value == 0)
    left = found.source.read(0, *found.orientation.turn.file_index(0, 0, 1, 2)).astype(int)
    off = [np.abs(left - eye).mean() for eye in (LEFT, RIGHT)]
    assert off[0] < off[1] or value == 0
