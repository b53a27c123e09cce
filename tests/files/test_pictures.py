"""Pictures on disk: the header agrees with what is decoded, or the file is refused."""

import io
import itertools
import random
import struct
import tempfile
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from lfpipe.errors import UserError
from lfpipe.files.pictures import open_header, read_frames, read_picture, small_grey
from tests.support.examples import examples
from tests.support.hostile_files import damaged_bytes, jpeg_claiming, png_of, with_exif

ENCODERS = [
    (".png", []),
    (".png", [cv2.IMWRITE_PNG_BILEVEL, 1]),
    (".jpg", []),
    (".jpg", [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]),
    *((".tif", [cv2.IMWRITE_TIFF_COMPRESSION, n]) for n in (1, 5, 8)),
    (".webp", [cv2.IMWRITE_WEBP_QUALITY, 101]),
    (".bmp", []),
    (".ppm", []),
    (".ppm", [cv2.IMWRITE_PXM_BINARY, 0]),
]
KINDS = [
    (*encoder, planes, deep)
    for encoder, planes, deep in itertools.product(ENCODERS, (1, 3, 4), (False, True))
    if not (deep and encoder[0] not in (".png", ".tif", ".ppm"))
    and not (planes == 4 and encoder[0] in (".jpg", ".ppm"))
    if not (cv2.IMWRITE_PNG_BILEVEL in encoder[1] and (planes > 1 or deep))
]


def picture(width: int, height: int, planes: int, deep: bool = False, seed: int = 0) -> np.ndarray:
    shape = (height, width) if planes == 1 else (height, width, planes)
    kind = np.uint16 if deep else np.uint8
    return np.random.default_rng(seed).integers(0, 65536 if deep else 256, shape, kind)


def encoded(end: str, options: list[int], pixels: np.ndarray) -> bytes:
    end = ".pgm" if end == ".ppm" and pixels.ndim == 2 else end
    return cv2.imencode(end, pixels, options)[1].tobytes()


@pytest.mark.parametrize(("end", "options", "planes", "deep"), KINDS)
@pytest.mark.parametrize(("width", "height"), [(7, 5)])
def test_a_picture_is_read_as_opencv_alone_reads_it(
    tmp_path: Path, end: str, options: list[int], planes: int, deep: bool, width: int, height: int
) -> None:
    data = encoded(end, options, picture(width, height, planes, deep))
    (tmp_path / "p").write_bytes(data)
    header = open_header(tmp_path / "p")
    assert (header.width_px, header.height_px, header.frames) == (width, height, 1)
    pixels, full = read_picture(tmp_path / "p")
    wanted = np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED))
    if planes == 4:  # over grey where it is transparent
        full_scale = 65535 if deep else 255
        share = wanted[..., 3:] / full_scale
        over = wanted[..., :3] * share + (full_scale + 1) // 2 * (1 - share)
        wanted = np.floor(over + 0.5).astype(wanted.dtype)
    wanted = wanted if wanted.ndim == 2 else cv2.cvtColor(wanted, cv2.COLOR_BGR2RGB)
    assert (
        np.array_equal(pixels if pixels.ndim == wanted.ndim else pixels[..., 0], wanted)
        and pixels.dtype == wanted.dtype
    )
    assert full == (65535 if deep else 255)


@pytest.mark.parametrize("kind", ["AVIF", "GIF", "MPO"])
def test_animations_and_files_of_several_pictures(tmp_path: Path, kind: str) -> None:
    frames = [
        cv2.resize(picture(4, 3, 3, seed=k), (64, 48), interpolation=cv2.INTER_CUBIC)
        for k in range(3)
    ]
    images = [Image.fromarray(frame) for frame in frames]
    images[0].save(tmp_path / "p", kind, save_all=True, append_images=images[1:], quality=95)
    header = open_header(tmp_path / "p")
    assert (header.width_px, header.height_px, header.frames) == (64, 48, 3)
    assert header.format == ("JPEG" if kind == "MPO" else kind)
    assert np.abs(read_picture(tmp_path / "p")[0].astype(int) - frames[0]).mean() < 12
    read = read_frames(tmp_path / "p")
    assert len(read) == 3 and all(
        np.abs(a.astype(int) - b).mean() < 12 for a, b in zip(read, frames, strict=True)
    )
    with pytest.raises(UserError, match="too many to decode"):
        read_frames(tmp_path / "p", most_bytes=20_000)


@pytest.mark.parametrize("end", [".jp2", ".hdr", ".pfm", ".ras"])
def test_other_formats_are_refused_whatever_opencv_can_do(tmp_path: Path, end: str) -> None:
    pixels = picture(64, 64, 3)
    (tmp_path / "p.png").write_bytes(
        encoded(end, [], pixels.astype(np.float32) if end in (".hdr", ".pfm") else pixels)
    )
    with pytest.raises(UserError, match="not a readable picture"):
        read_picture(tmp_path / "p.png")


@examples(200, deadline=None)
@given(
    encoder=st.sampled_from(ENCODERS),
    seed=st.integers(0, 1 << 32),
    times=st.integers(1, 3),
    near_start=st.booleans(),
)
def test_a_damaged_picture_is_refused_or_what_its_header_says(
    encoder: tuple[str, list[int]], seed: int, times: int, near_start: bool
) -> None:
    rng = random.Random(seed)
    planes = 1 if cv2.IMWRITE_PNG_BILEVEL in encoder[1] else rng.choice((1, 3))
    data = encoded(*encoder, picture(rng.randrange(1, 40), rng.randrange(1, 40), planes, seed=seed))
    for _ in range(times):
        head = min(len(data), 80) if near_start else len(data)
        data = damaged_bytes(rng, data[:head]) + data[head:]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "p"
        path.write_bytes(data)
        try:
            header = open_header(path)
            pixels, full = read_picture(path)
        except UserError:
            return
    assert pixels.shape[:2] == (header.height_px, header.width_px) and full == header.max_value
    assert pixels.dtype == (np.uint16 if full > 255 else np.uint8)


@pytest.mark.parametrize("planes", [1, 3])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_photograph_is_turned_upright(tmp_path: Path, orientation: int, planes: int) -> None:
    stored = cv2.resize(picture(9, 7, planes), (384, 256), interpolation=cv2.INTER_CUBIC)
    data = with_exif(encoded(".jpg", [], stored), orientation)
    (tmp_path / "p.jpg").write_bytes(data)
    kind = cv2.IMREAD_COLOR if planes == 3 else cv2.IMREAD_GRAYSCALE
    wanted = np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), kind))
    pixels, _ = read_picture(tmp_path / "p.jpg")
    assert np.array_equal(pixels, wanted[..., ::-1] if planes == 3 else wanted)
    header = open_header(tmp_path / "p.jpg")
    assert (
        (header.height_px, header.width_px)
        == wanted.shape[:2]
        == ((384, 256) if orientation > 4 else (256, 384))
    )
    small = small_grey(tmp_path / "p.jpg", 192 * 128)
    half = np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_REDUCED_GRAYSCALE_2))
    assert small.shape == ((192, 128) if orientation > 4 else (128, 192)) and np.array_equal(
        small, half
    )


SMALL = encoded(".jpg", [], np.zeros((8, 8, 3), np.uint8))
CLAIMS = {
    "png": png_of(20_000, 20_000, b"\0" * 400),
    "png, 16 bit": png_of(8192, 8192, b"\0" * 400, depth=16),
    "jpeg": jpeg_claiming(SMALL, 20_000, 20_000),
    "jpeg without an end": encoded(".jpg", [], picture(64, 64, 3))[:-500],
    "bmp": b"BM"
    + struct.pack("<IHHIIiiHHIIiiII", 54, 0, 0, 54, 40, 20_000, 20_000, 1, 24, 1, 0, 0, 0, 0, 0)
    + b"\0" * 500,
    "pnm": b"P6 20000 20000 255\n" + b"\0" * 400,
    "no width": png_of(0, 5, b"\0" * 400),
}


@pytest.mark.parametrize("claim", CLAIMS)
def test_a_claim_beyond_memory_is_refused_undecoded(
    tmp_path: Path, claim: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "p.png").write_bytes(CLAIMS[claim])
    monkeypatch.setattr(cv2, "imread", lambda *_: pytest.fail("it was decoded"))
    with pytest.raises(UserError, match=r"too large: .* MB|not a readable picture"):
        read_picture(tmp_path / "p.png")
    (tmp_path / "q.jpg").write_bytes(jpeg_claiming(SMALL, 8192, 8192))  # a quilt, which is allowed
    assert open_header(tmp_path / "q.jpg").decoded_bytes == 8192 * 8192 * 3


NOISE = picture(64, 48, 3)


def by_pillow(kind: str, **options: object) -> bytes:
    file = io.BytesIO()
    Image.fromarray(NOISE).save(file, kind, **options)
    return file.getvalue()


def with_thumbnail(kind: str) -> bytes:
    """A picture whose metadata holds a whole JPEG."""
    return by_pillow(kind, exif=b"Exif\0\0II*\0\x08\0\0\0\0\0\0\0\0\0" + by_pillow("JPEG"))


WHOLE = {
    "JPEG": by_pillow("JPEG"),
    "JPEG, progressive": by_pillow("JPEG", progressive=True),
    "PNG": by_pillow("PNG"),
    "PNG of 16 bits": cv2.imencode(".png", picture(64, 48, 3, deep=True))[1].tobytes(),
    "BMP": by_pillow("BMP"),
    "PPM": by_pillow("PPM"),
    "PPM of 16 bits with a comment": b"P5 # made\n64 48 65535\n" + NOISE.tobytes()[: 64 * 48 * 2],
    "TIFF": by_pillow("TIFF"),
    "TIFF, compressed": by_pillow("TIFF", compression="tiff_lzw"),
    "TIFF, by OpenCV": cv2.imencode(".tiff", NOISE)[1].tobytes(),
    "WebP": by_pillow("WEBP"),
    "WebP with a thumbnail": with_thumbnail("WEBP"),
    "AVIF": by_pillow("AVIF"),
    "AVIF with a thumbnail": with_thumbnail("AVIF"),
}
BEHIND = {
    "nothing": b"",
    "a JPEG": by_pillow("JPEG"),
    "a video": b"\0\0\0\x18ftypmp42" + NOISE.tobytes(),
}


@pytest.mark.parametrize("kind", WHOLE)
def test_a_cut_picture_is_refused_and_a_whole_one_opens_whatever_follows(
    tmp_path: Path, kind: str
) -> None:
    path = tmp_path / "x.png"
    path.write_bytes(WHOLE[kind])
    alone, _ = read_picture(path)
    for behind in BEHIND.values():
        path.write_bytes(WHOLE[kind] + behind)
        np.testing.assert_array_equal(read_picture(path)[0], alone)
    for left in (0.2, 0.5, 0.9, 0.99):
        path.write_bytes(WHOLE[kind][: int(left * len(WHOLE[kind]))])
        with pytest.raises(UserError, match=r"x\.png"):
            read_picture(path)
