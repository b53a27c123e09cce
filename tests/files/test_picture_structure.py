"""Pictures that claim much work for few bytes are refused by what they claim, before a decoder
runs.
"""

import io
import struct
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from lfpipe.errors import UserError
from lfpipe.files.picture_structure import MAX_PARTS, MAX_PICTURES, MAX_SCANS, examine
from lfpipe.files.pictures import open_header, read_picture
from tests.support.hostile_files import png_chunk, png_of

NOISE = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)
PROGRESSIVE = cv2.imencode(".jpg", NOISE, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()


def scans(count: int) -> bytes:
    scan = PROGRESSIVE[PROGRESSIVE.rfind(b"\xff\xda") : -2]
    whole = PROGRESSIVE.count(b"\xff\xda")
    return PROGRESSIVE[:-2] + scan * (count - whole) + b"\xff\xd9"


def segments(count: int) -> bytes:
    return PROGRESSIVE[:2] + b"\xff\xe5\0\2" * count + PROGRESSIVE[2:]


def chunks(count: int) -> bytes:
    return png_of(8, 8, before=png_chunk(b"pPAd", b"") * count)


def directories(count: int, big: bool = False, loop: bool = False) -> bytes:
    """A TIFF of so many pictures of 16x16 px; loop: the last is followed by the first."""
    values = [(256, 16), (257, 16), (258, 8), (259, 1), (262, 1), (273, 16), (278, 16), (279, 256)]
    form = "<HHQQ" if big else "<HHII"
    entries = b"".join(struct.pack(form, tag, 4, 1, value) for tag, value in values)
    number, following = ("<Q", "<Q") if big else ("<H", "<I")
    first = 16 + 256
    length = struct.calcsize(number) + len(entries) + struct.calcsize(following)
    tables = b"".join(
        struct.pack(number, len(values))
        + entries
        + struct.pack(following, first + at * length if at < count else first * loop)
        for at in range(1, count + 1)
    )
    head = struct.pack("<2sHHHQ", b"II", 43, 8, 0, first)
    return (head if big else struct.pack("<2sHIQ", b"II", 42, first, 0)) + bytes(256) + tables


def frames(count: int) -> bytes:
    file = io.BytesIO()
    Image.new("L", (16, 16)).save(file, "GIF")
    data = file.getvalue()
    at = data.index(b",\0\0\0\0")
    return data[:at] + data[at:-1] * count + b";"


MAKERS = {
    "scans": (scans, MAX_SCANS),
    "segments": (segments, MAX_PARTS),
    "chunks": (chunks, MAX_PARTS),
    "directories": (directories, MAX_PICTURES),
    "directories of a big TIFF": (lambda count: directories(count, big=True), MAX_PICTURES),
    "frames": (frames, MAX_PICTURES),
}


@pytest.mark.parametrize("what", MAKERS)
def test_what_claims_too_many_parts_is_refused_at_once_by_name(tmp_path: Path, what: str) -> None:
    make, most = MAKERS[what]
    path = tmp_path / "x.png"
    path.write_bytes(make(20))
    open_header(path)
    path.write_bytes(make(2 * most))
    begin_s = time.process_time()
    with pytest.raises(UserError, match=rf"x\.png: more than {most} ") as refused:
        read_picture(path)
    assert refused.value.remedy
    assert time.process_time() - begin_s < 2


def test_directories_in_a_circle_and_tags_that_share_bytes_end(tmp_path: Path) -> None:
    path = tmp_path / "x.tif"
    path.write_bytes(directories(3, loop=True))
    with pytest.raises(UserError, match="pictures in one file"):
        open_header(path)
    tag = struct.pack("<HHII", 700, 7, 1000, 300)
    path.write_bytes(struct.pack("<2sHIH", b"II", 42, 8, 99) + tag * 99 + bytes(9000))
    with pytest.raises(UserError, match="bytes in tags"):
        open_header(path)


@pytest.mark.parametrize("cut", [0.2, 0.5, 0.9, 0.999])
@pytest.mark.parametrize("progressive", [0, 1])
def test_the_end_of_a_jpeg_is_that_of_its_structure(cut: float, progressive: int) -> None:
    data = cv2.imencode(".jpg", NOISE, [cv2.IMWRITE_JPEG_PROGRESSIVE, progressive])[1].tobytes()
    thumbnail = (
        data[:2] + b"\xff\xe1\x10\0" + data[: 0x1000 - 2].ljust(0x1000 - 2, b"\0") + data[2:]
    )
    for whole in (data, thumbnail):
        found = examine(io.BytesIO(whole + data))
        assert found.whole and found.end == len(whole)
        coded = whole.rfind(b"\xff\xda", 0, len(whole) - 2) if not progressive else len(whole) // 2
        part = whole[: coded + int(cut * (len(whole) - coded))]
        assert not examine(io.BytesIO(part)).whole
        assert not examine(io.BytesIO(part + data)).whole


def encoded(kind: str, **options: object) -> bytes:
    file = io.BytesIO()
    Image.fromarray(NOISE).save(file, kind, **options)
    return file.getvalue()


def with_thumbnail(kind: str) -> bytes:
    """A picture whose metadata holds a whole JPEG."""
    return encoded(kind, exif=b"Exif\0\0II*\0\x08\0\0\0\0\0\0\0\0\0" + encoded("JPEG"))


WHOLE = {
    "BMP": encoded("BMP"),
    "PPM": encoded("PPM"),
    "PPM of 16 bits with a comment": b"P5 # made\n64 48 65535\n" + NOISE.tobytes()[: 64 * 48 * 2],
    "TIFF": encoded("TIFF"),
    "TIFF, compressed": encoded("TIFF", compression="tiff_lzw"),
    "TIFF, by OpenCV": cv2.imencode(".tiff", NOISE)[1].tobytes(),
    "WebP": encoded("WEBP"),
    "WebP with a thumbnail": with_thumbnail("WEBP"),
    "AVIF": encoded("AVIF"),
    "AVIF with a thumbnail": with_thumbnail("AVIF"),
}
BEHIND = {
    "a JPEG": encoded("JPEG"),
    "a PNG": encoded("PNG"),
    "a video": b"\0\0\0\x18ftypmp42" + NOISE.tobytes(),
}


@pytest.mark.parametrize("behind", [*BEHIND, "the same once more"])
@pytest.mark.parametrize("kind", WHOLE)
def test_a_cut_picture_is_refused_whatever_follows_it(
    tmp_path: Path, kind: str, behind: str
) -> None:
    """A whole one is opened, and what is behind it is named where its format tells its end."""
    data = WHOLE[kind]
    other = BEHIND.get(behind, data)
    path = tmp_path / "x.png"
    path.write_bytes(data)
    alone, _ = read_picture(path)
    path.write_bytes(data + other)
    np.testing.assert_array_equal(read_picture(path)[0], alone)
    assert bool(open_header(path).beside) is not kind.startswith("TIFF")
    for left in (0.5, 0.9, 0.99):
        path.write_bytes(data[: int(left * len(data))] + other)
        with pytest.raises(UserError, match=r"x\.png"):
            read_picture(path)


def test_a_limit_that_a_decoder_reached_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "x.png"
    path.write_bytes(png_of(64, 64))
    monkeypatch.setattr(cv2, "imread", lambda *_: None)
    with pytest.raises(UserError, match="damaged"):
        read_picture(path)

    def too_little(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr("lfpipe.files.pictures.np.empty", too_little)
    with pytest.raises(UserError, match=r"x\.png: decoding 64x64 px of PNG needs more memory"):
        read_picture(path)
