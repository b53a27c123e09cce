"""Pictures that hold more than one: depth inside a JPEG, wiggles as GIF, raw pictures of lenslets."""

import base64
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.export.clip import write_clip
from lfpipe.scene import layouts
from lfpipe.scene.layouts._embedded_depth import embedded_depth
from lfpipe.scene.layouts._plenoptic import is_honeycomb
from lfpipe.scene.orientation import orient
from tests.hostile_files import with_exif
from tests.scene import made

AUTO = config.Scene()
PICTURE = made.views(1, 1, 96, 128, 1.0, -1.0)[0, 0]
DISPARITY = made.middle_disparity(96, 128, 1.0, -1.0)
FAR_WHITE = np.asarray((1 - DISPARITY) * 127, np.uint8)


def jpeg(picture: np.ndarray) -> bytes:
    return bytes(cv2.imencode(".jpg", picture if picture.ndim == 2 else picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])[1])


def with_segments(data: bytes, *bodies: bytes) -> bytes:
    return data[:2] + b"".join(b"\xff\xe1" + (len(body) + 2).to_bytes(2) + body for body in bodies) + data[2:]


XMP, MORE = b"http://ns.adobe.com/xap/1.0/\0", b"http://ns.adobe.com/xmp/extension/\0" + b"0" * 32


def gdepth(kind: bytes = b"RangeInverse", mime: str = ".png") -> bytes:
    """As Google's camera wrote it: the map in extended XMP, in parts."""
    code = base64.b64encode(cv2.imencode(mime, FAR_WHITE)[1])
    main = XMP + b'<x GDepth:Format="' + kind + b'" GDepth:Near="1.0" GDepth:Far="3.0" GDepth:Mime="image/png"/>'
    whole = b'<x GDepth:Data="' + code + b'"/>'
    parts = [
        MORE + len(whole).to_bytes(4) + at.to_bytes(4) + whole[at : at + 5000] for at in reversed(range(0, len(whole), 5000))
    ]
    return with_segments(jpeg(PICTURE), main, *parts)


def dynamic_depth() -> bytes:
    """Items that follow the picture, as the Android camera writes them."""
    depth, video = jpeg(FAR_WHITE), b"video" * 50
    items = [("Primary", 0), ("Depth", len(depth)), ("MotionPhoto", len(video))]
    listed = "".join(f'<Container:Item Item:Mime="image/jpeg" Item:Semantic="{s}" Item:Length="{n}"/>' for s, n in items)
    return with_segments(jpeg(PICTURE), XMP + listed.encode()) + depth + video


PORTRAITS: dict[str, Callable[[], bytes]] = {
    "GDepth": gdepth,
    "GDepth, linear": lambda: gdepth(b"RangeLinear"),
    "Dynamic Depth": dynamic_depth,
}


@pytest.mark.parametrize("kind", PORTRAITS)
def test_a_portrait_with_depth_becomes_views(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "PORTRAIT_20260704.jpg"
    path.write_bytes(PORTRAITS[kind]())
    source = layouts.describe(path, AUTO)
    assert (source.layout, source.rows, source.cols) == ("rgbd", 5, 9)
    assert np.abs(source.read(0, 2, 4).astype(int) - PICTURE).mean() < 3
    assert np.corrcoef(source.truth[2, 4]().ravel(), DISPARITY.ravel())[0, 1] > 0.95


def test_a_photograph_and_its_depth_are_turned_upright_together(tmp_path: Path) -> None:
    relief = []
    for orientation in (1, 6):
        (tmp_path / f"{orientation}.jpg").write_bytes(with_exif(gdepth(), orientation))
        source = layouts.describe(tmp_path / f"{orientation}.jpg", AUTO)
        relief.append(source.truth[source.rows // 2, source.cols // 2]() / source.width_px)
    assert np.allclose(relief[1], np.rot90(relief[0], -1), atol=1e-4)


@pytest.mark.parametrize("at", [30, 300, 900, 4000, 6500])
def test_a_damaged_portrait_is_refused_or_opens_flat(tmp_path: Path, at: int) -> None:
    for kind, make in PORTRAITS.items():
        whole = make()
        path = tmp_path / f"{kind}.jpg"
        for data in (whole[:at], whole[:at] + b"\0" * 40 + whole[at + 40 :]):
            path.write_bytes(data)
            try:
                layouts.describe(path, AUTO)
            except UserError as error:
                assert error.remedy


def test_a_map_that_is_promised_but_not_there_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(with_segments(jpeg(PICTURE), XMP + b'<x GDepth:Format="RangeInverse"/>'))
    with pytest.raises(UserError, match="has no readable one"):
        embedded_depth(tmp_path / "a.jpg")


@pytest.mark.parametrize("back", [False, True])
def test_a_wiggle_opens_as_a_line_of_views(tmp_path: Path, back: bool) -> None:
    line = made.views(1, 7, 96, 128, 3.0, 0.5)[0]
    frames = [frame[..., ::-1] for frame in ([*line, *line[-2:0:-1]] if back else line)]
    write_clip(tmp_path / "wiggle.gif", iter(frames), 10)
    source = layouts.describe(tmp_path, AUTO)
    assert (source.layout, source.rows, source.cols) == ("gif", 1, 7)
    assert np.abs(source.read(0, 0, 6).astype(int) - line[6]).mean() < 12  # 256 colours
    assert orient(source, AUTO).turn.transpose is False


def test_damaged_and_large_gifs_are_refused(tmp_path: Path) -> None:
    write_clip(tmp_path / "a.gif", iter(made.views(1, 3, 48, 64)[0]), 10)
    whole = (tmp_path / "a.gif").read_bytes()
    large = whole[:6] + b"\xff\xff\xff\xff" + whole[10:]
    for data in (whole[:9], whole[:400], b"GIF89a", large, b"GIF89a" + b"\x2c" * 500):
        (tmp_path / "a.gif").write_bytes(data)
        with pytest.raises(UserError) as caught:
            layouts.describe(tmp_path / "a.gif", AUTO)
        assert caught.value.remedy


def honeycomb(pitch_px: float, turned: bool) -> np.ndarray:
    height, width = 420, 560
    y, x = np.mgrid[:height, :width].astype(np.float64)
    x, y = (y, x) if turned else (x, y)
    row = np.rint(y / (pitch_px * np.sqrt(3) / 2))
    off_y, off_x = y - row * pitch_px * np.sqrt(3) / 2, (x + row % 2 * pitch_px / 2) % pitch_px - pitch_px / 2
    lens = np.exp(-(off_x**2 + off_y**2) / (0.35 * pitch_px) ** 2)
    return np.asarray(lens[..., None] * made.texture(height, width, 4), np.uint8)


@pytest.mark.parametrize(("pitch_px", "turned"), [(10.0, False), (14.3, True)])
def test_a_raw_plenoptic_picture_is_refused(tmp_path: Path, pitch_px: float, turned: bool) -> None:
    made.write(tmp_path / "raw.png", honeycomb(pitch_px, turned))
    with pytest.raises(UserError, match="lenslets") as caught:
        layouts.describe(tmp_path / "raw.png", AUTO)
    assert "PlenoptiCam" in caught.value.remedy
    assert layouts.describe(tmp_path / "raw.png", config.Scene(force=True)).rows == 1


def test_photographs_are_no_honeycomb() -> None:
    faces = made.SAMPLES.parent / "faces" / "no_face"
    pictures = [cv2.imread(str(path)) for path in sorted(faces.glob("*.jpg"))] + [made.texture(300, 400, k) for k in range(3)]
    pictures += [np.full((300, 400, 3), 5, np.uint8), np.zeros((48, 64, 3), np.uint8)]
    pictures += [
        np.tile(np.arange(400) % 20 * 10, (300, 1)).astype(np.uint8),
        np.tile(np.arange(400) / 2, (300, 1)).astype(np.uint8),
    ]
    assert not any(is_honeycomb(picture) for picture in pictures)
