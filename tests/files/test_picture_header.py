"""Headers of pictures: the header read before decoding agrees with the decoded picture, or the file is refused."""

import itertools
import random
import struct

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from lfpipe.files.decoding import picture_of
from lfpipe.files.picture_header import MAX_DECODING_BYTES, header_of
from tests.hostile_files import damaged_bytes, jpeg_claiming, png_chunk, png_of, with_exif

JPEG = {"baseline": [], "progressive": [cv2.IMWRITE_JPEG_PROGRESSIVE, 1], "restarts": [cv2.IMWRITE_JPEG_RST_INTERVAL, 1],
        "optimised": [cv2.IMWRITE_JPEG_OPTIMIZE, 1]}  # fmt: skip
TIFF = {f"packing {n}": [cv2.IMWRITE_TIFF_COMPRESSION, n] for n in (1, 5, 8, 32773)}
WEBP = {"lossy": [cv2.IMWRITE_WEBP_QUALITY, 80], "lossless": [cv2.IMWRITE_WEBP_QUALITY, 101]}
ENCODERS = [
    *((".png", name, options) for name, options in {"plain": [], "bits": [cv2.IMWRITE_PNG_BILEVEL, 1]}.items()),
    *((".jpg", name, options) for name, options in JPEG.items()),
    *((".tif", name, options) for name, options in TIFF.items()),
    *((".webp", name, options) for name, options in WEBP.items()),
    (".bmp", "plain", []),
    (".ppm", "binary", []),
    (".ppm", "text", [cv2.IMWRITE_PXM_BINARY, 0]),
]
DEEP = (".png", ".tif", ".ppm")


def picture(width: int, height: int, planes: int, deep: bool, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    shape = (height, width) if planes == 1 else (height, width, planes)
    return rng.integers(0, 65536 if deep else 256, shape, np.uint16 if deep else np.uint8)


def encoded(end: str, options: list[int], pixels: np.ndarray) -> bytes:
    end = ".pgm" if end == ".ppm" and pixels.ndim == 2 else end
    return cv2.imencode(end, pixels, options)[1].tobytes()


KINDS = [
    (end, options, planes, deep)
    for end, name, options in ENCODERS
    for planes, deep in itertools.product((1, 3, 4), (False, True))
    if not (deep and end not in DEEP) and not (planes == 4 and end in (".jpg", ".ppm"))
    if name != "bits" or (planes == 1 and not deep)
]


@settings(max_examples=400)
@given(encoder=st.sampled_from(ENCODERS), seed=st.integers(0, 1 << 32), times=st.integers(1, 3), near_start=st.booleans())
def test_a_damaged_picture_never_decodes_to_what_its_header_did_not_claim(
    encoder: tuple[str, str, list[int]], seed: int, times: int, near_start: bool
) -> None:
    rng = random.Random(seed)
    data = encoded(
        encoder[0],
        encoder[2],
        picture(rng.randrange(1, 40), rng.randrange(1, 40), 1 if encoder[1] == "bits" else rng.choice((1, 3)), False, seed),
    )
    for _ in range(times):
        head = min(len(data), 80) if near_start else len(data)
        data = damaged_bytes(rng, data[:head]) + data[head:]
    header = header_of(data)
    if header is None or header.problem(len(data)):
        assert picture_of(np.frombuffer(data, np.uint8)) is None
        return
    try:
        found = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        return
    assert found is None or found.shape[:2] == (header.height_px, header.width_px)
    assert found is None or (found.dtype == np.uint16) <= (header.max_value > 255)


@settings(max_examples=200)
@given(cut=st.integers(0, 60), flips=st.lists(st.tuples(st.integers(0, 59), st.integers(0, 255)), max_size=4))
def test_damaged_exif_costs_no_picture(cut: int, flips: list[tuple[int, int]]) -> None:
    plain = encoded(".jpg", [], picture(16, 8, 3, False))
    body = bytearray(with_exif(plain, 6, before=2)[6 : -len(plain) + 2])
    for at, value in flips:
        body[at % len(body)] = value
    header = header_of(with_exif(plain, 6, segment=bytes(body[:cut])))
    assert header is not None
    assert (header.width_px, header.height_px) == ((8, 16) if header.orientation >= 5 else (16, 8))


def test_a_quarter_turn_needs_memory_for_both_pictures() -> None:
    data = jpeg_claiming(encoded(".jpg", [], picture(16, 8, 3, False)), 8000, 6000)
    for orientation, problem in ((3, False), (6, True)):
        header = header_of(with_exif(data, orientation))
        assert header is not None and ("decoding needs 288 MB" in header.problem(5_000_000)) == problem


def bmp_claiming(width: int, height: int) -> bytes:
    return b"BM" + struct.pack("<IHHIIiiHHIIiiII", 54, 0, 0, 54, 40, width, height, 1, 24, 1, 0, 0, 0, 0, 0) + b"\0" * 500


def tiff_claiming(width: int, height: int, order: str = "<", tile: tuple[int, int] | None = None) -> bytes:
    tags = [(256, 4, width), (257, 4, height), (258, 3, 8), (259, 3, 5), (262, 3, 2), (273, 4, 8), (277, 3, 3), (279, 4, 100)]
    tags += [(322, 4, tile[0]), (323, 4, tile[1])] if tile else []
    entries = [struct.pack(order + "HHI", tag, kind, 1) + (struct.pack(order + ("I" if kind == 4 else "Hxx"), value))
               for tag, kind, value in tags]  # fmt: skip
    start = b"II*\0" if order == "<" else b"MM\0*"
    return start + struct.pack(order + "IH", 8, len(tags)) + b"".join(entries) + b"\0" * 400


def webp_claiming(width: int, height: int) -> bytes:
    size = b"\0" * 4 + (width - 1).to_bytes(3, "little") + (height - 1).to_bytes(3, "little")
    return b"RIFF" + struct.pack("<I", 400) + b"WEBPVP8X" + struct.pack("<I", 10) + size + b"\0" * 400


SMALL = cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1].tobytes()
PROGRESSIVE = cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
SCAN = PROGRESSIVE[PROGRESSIVE.index(b"\xff\xda") : -2]
CLAIMS = {
    "jpeg of a thousand scans": PROGRESSIVE[:-2] + SCAN * 1000 + b"\xff\xd9",
    "png": png_of(20_000, 20_000, b"\0" * 400),
    "png, 16 bit": png_of(8192, 8192, b"\0" * 400, depth=16),
    "jpeg": jpeg_claiming(SMALL, 20_000, 20_000),
    "jpeg, more than so few bytes can hold": jpeg_claiming(SMALL, 8000, 8000),
    "bmp": bmp_claiming(20_000, 20_000),
    "bmp upside down": bmp_claiming(20_000, -20_000),
    "pnm": b"P6 20000 20000 255\n" + b"\0" * 400,
    "pnm of bits": b"P4 99999 99999\n" + b"\0" * 400,
    "pnm, another size in a comment": b"P6 #\r20000 20000\n10 10 255\n" + b"\0" * 400,
    "tiff": tiff_claiming(20_000, 20_000),
    "tiff, other byte order": tiff_claiming(20_000, 20_000, ">"),
    "tiff of one large tile": tiff_claiming(64, 64, "<", (16384, 16384)),
    "webp": webp_claiming(16_000, 16_000),
    "png, a large chunk": png_of(8, 8)[:33] + struct.pack(">I4s", 934_000_000, b"IDAT") + b"\0" * 400,
    "png, an endless row of chunks": png_of(8, 8)[:33] + png_chunk(b"tEXt", b"") * 200_000,
    "png without an end": png_of(8, 8)[:-12],
    "no width": png_of(0, 5, b"\0" * 400),
}


def test_what_looking_glass_displays_take_is_allowed() -> None:
    for data in (png_of(8192, 8192, b"\0" * 300_000), jpeg_claiming(SMALL, 8192, 8192)):
        header = header_of(data)
        assert header is not None and header.decoded_bytes == 8192 * 8192 * 3 <= MAX_DECODING_BYTES


def test_a_picture_with_gigabytes_behind_it_is_refused() -> None:
    header = header_of(cv2.imencode(".bmp", np.zeros((24, 32, 3), np.uint8))[1].tobytes())
    assert header is not None
    assert not header.problem(10_000)
    assert "at most" in header.problem(1 << 31)
