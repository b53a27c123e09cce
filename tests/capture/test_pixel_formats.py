"""Every pixel format: the same picture comes out of each, whatever the driver's padding; JPEGs are
passed on unchanged.
"""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from lfpipe.capture.v4l2_device import DECODED, JPEGS, FrameDecoder, Mode
from tests.capture.fake_camera import FakeCamera, source
from tests.capture.made_files import SIZE, jpeg, seen

WIDTH, HEIGHT = 16, 8
COLOUR = np.array([40, 120, 200], np.uint8)  # BGR


def rows(fourcc: str) -> list[bytes]:
    """A frame of COLOUR (of grey: of 120), one entry per row; 4:2:0 chroma rows after those of
    luma.
    """
    flat = cv2.cvtColor(np.tile(COLOUR, (2, 2, 1)), cv2.COLOR_BGR2YUV_I420)
    y, u, v = flat.reshape(-1)[[0, 4, 5]].tolist()
    b, g, r = COLOUR.tolist()
    packed: dict[str, tuple[int, list[tuple[int, ...]]]] = {  # pixels and bytes of lines
        "BGR3": (1, [(b, g, r)]),
        "RGB3": (1, [(r, g, b)]),
        "BGR4": (1, [(b, g, r, 0)]),
        "XR24": (1, [(b, g, r, 0)]),
        "GREY": (1, [(120,)]),
        "YUYV": (2, [(y, u, y, v)]),
        "UYVY": (2, [(u, y, v, y)]),
        "YVYU": (2, [(y, v, y, u)]),
        "BA81": (2, [(b, g), (g, r)]),
        "GBRG": (2, [(g, b), (r, g)]),
        "GRBG": (2, [(g, r), (b, g)]),
        "RGGB": (2, [(r, g), (g, b)]),
    }
    planar: dict[str, list[tuple[int, ...]]] = {
        "NV12": [(u, v)],
        "NV21": [(v, u)],
        "YU12": [(u,), (v,)],
        "YV12": [(v,), (u,)],
    }
    if fourcc in packed:
        pixels, lines = packed[fourcc]
        return [bytes(line) * (WIDTH // pixels) for line in lines] * (HEIGHT // len(lines))
    chroma = [bytes(line) * (WIDTH // 2) for line in planar[fourcc] for _ in range(HEIGHT // 2)]
    return [bytes([y]) * WIDTH] * HEIGHT + chroma


@pytest.mark.parametrize("padding", [4])
@pytest.mark.parametrize("size", [(WIDTH, HEIGHT), (32, 16)])
@pytest.mark.parametrize("fourcc", [each for each in DECODED if each not in JPEGS])
def test_every_format_gives_the_same_picture(
    fourcc: str, size: tuple[int, int], padding: int
) -> None:
    lines = rows(fourcc)
    stride = len(lines[0]) + padding
    # their chroma rows, and the padding of those, are half as long
    small = fourcc in ("YU12", "YV12")
    data = b"".join(
        line + b"\xee" * (padding // 2 if small and index >= HEIGHT else padding)
        for index, line in enumerate(lines)
    )
    decoder = FrameDecoder(Mode(fourcc, WIDTH, HEIGHT, stride, 30.0))
    out = np.zeros((size[1], size[0], 3), np.uint8)
    whole, packet = decoder.decode(np.frombuffer(data, np.uint8), out)
    assert whole and packet is None
    wanted = np.full(3, 120, np.uint8) if fourcc == "GREY" else COLOUR
    inner = out[2:-2, 2:-2]  # demosaicing guesses at the edge
    assert np.abs(inner.astype(int) - wanted).max() <= 3, inner[0, 0]
    for cut in (1, stride):
        short = np.frombuffer(data, np.uint8)[: decoder.frame_bytes - cut]
        assert not decoder.decode(short, out)[0]


def photo(seed: int = 0) -> NDArray[np.uint8]:
    noise = np.random.default_rng(seed).integers(0, 256, (240, 320, 3), dtype=np.uint8)
    return np.asarray(
        cv2.imencode(".jpg", cv2.GaussianBlur(noise, (0, 0), 2))[1], np.uint8
    ).reshape(-1)


def damaged(kind: str, data: NDArray[np.uint8]) -> NDArray[np.uint8]:
    middle = data.size // 2
    if kind == "hole":
        return np.concatenate([data[:middle], data[middle + 700 :]])
    if kind == "zeros":
        return np.concatenate([data[:middle], np.zeros(900, np.uint8), data[middle + 900 :]])
    return data[: {"half": middle, "cut": -400, "start": 300}[kind]]


@pytest.mark.parametrize("kind", ["hole", "zeros", "half", "cut", "start"])
def test_a_damaged_jpeg_is_no_frame_and_prints_nothing(
    kind: str, capfd: pytest.CaptureFixture[str]
) -> None:
    """libjpeg fills what is missing with grey and shifted blocks: eyes would be off by 18 px in the
    median.
    """
    decoder = FrameDecoder(Mode("MJPG", 320, 240, 0, 30.0))
    out = np.zeros((240, 320, 3), np.uint8)
    for seed in range(3):
        assert not decoder.decode(damaged(kind, photo(seed)), out)[0]
        assert decoder.decode(photo(seed), out)[0], "the next one is whole again"
    assert capfd.readouterr().err == ""
    decoder.close()


@pytest.mark.parametrize("size", [SIZE, (32, 24)])
def test_a_cameras_jpegs_come_out_as_they_went_in_and_damaged_ones_are_passed_over(
    size: tuple[int, int],
) -> None:
    """Frames of another size are scaled, and their packets stay.

    Some drivers fill their buffer up, some leave out the end.
    """
    padded = jpeg(2) + bytes(100)
    damaged = (b"", b"\0" * 500, jpeg(3)[:40])
    device = FakeCamera(
        Mode("MJPG", *SIZE, 0, 30.0), [jpeg(0), jpeg(1), padded, *damaged, jpeg(4)[:-2]]
    )
    camera = source(device, width_px=size[0], height_px=size[1])
    out = np.zeros((size[1], size[0], 3), np.uint8)
    assert camera.info.jpeg
    for packet, number in ((jpeg(1), 1), (padded, 2), (jpeg(4), 6)):
        frame = camera.read(out)
        assert (
            frame is not None
            and frame.packet is not None
            and frame.packet.tobytes() == packet
            and frame.source_seq == number - 1
        )
        assert np.array_equal(out, cv2.resize(seen(packet), size, interpolation=cv2.INTER_LINEAR))
