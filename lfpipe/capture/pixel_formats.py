"""Pixel formats of cameras: the supported ones, the choice of a mode, and the conversion to BGR."""

import os
import sys
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.capture.v4l2_device import FrameSizes, Mode
from lfpipe.files.decoding import fit_area, fitted, is_jpeg, picture_of

JPEGS = ("MJPG", "JPEG")
INTERLEAVED = {  # channels, conversion
    "YUYV": (2, cv2.COLOR_YUV2BGR_YUYV),
    "UYVY": (2, cv2.COLOR_YUV2BGR_UYVY),
    "YVYU": (2, cv2.COLOR_YUV2BGR_YVYU),
    "RGB3": (3, cv2.COLOR_RGB2BGR),
    "BGR3": (3, None),
    "XR24": (4, cv2.COLOR_BGRA2BGR),
    "BGR4": (4, cv2.COLOR_BGRA2BGR),
    "GREY": (1, cv2.COLOR_GRAY2BGR),
    "BA81": (1, cv2.COLOR_BayerBGGR2BGR),
    "GBRG": (1, cv2.COLOR_BayerGBRG2BGR),
    "GRBG": (1, cv2.COLOR_BayerGRBG2BGR),
    "RGGB": (1, cv2.COLOR_BayerRGGB2BGR),
}
PLANAR = {  # 4:2:0, chroma of half the width and height; the first two with both chroma values interleaved
    "NV12": cv2.COLOR_YUV2BGR_NV12,
    "NV21": cv2.COLOR_YUV2BGR_NV21,
    "YU12": cv2.COLOR_YUV2BGR_I420,
    "YV12": cv2.COLOR_YUV2BGR_YV12,
}
DEEP_GREY_BITS = {"Y10": 10, "Y12": 12, "Y16": 16}  # in 16-bit words, little-endian
DECODED = (*JPEGS, *INTERLEAVED, *PLANAR, *DEEP_GREY_BITS)
# cheapest to decode first; grey last, because the tracker's model was trained on colours
CHEAPEST = (
    *("YUYV", "UYVY", "YVYU", "NV12", "NV21", "YU12", "YV12", "BGR3", "RGB3", "BGR4", "XR24", *JPEGS),
    *("RGGB", "BA81", "GBRG", "GRBG", "GREY", *DEEP_GREY_BITS),
)
GREY = ("GREY", *DEEP_GREY_BITS)
SMALL_PX = 640 * 480  # up to this size uncompressed frames at 30 Hz fit USB 2
JPEG_END = np.array([0xFF, 0xD9], np.uint8)  # end of image


def choose(modes: Sequence[FrameSizes], width_px: int, height_px: int, rate_hz: float) -> FrameSizes | None:
    """The mode to request for frames of that size and rate, None if none can be decoded: first the one with the most detail in a
    frame, then colour, then the one that reaches the rate, then the one that is cheapest to decode.

    A mode without rates counts as fast enough, but uncompressed frames above SMALL_PX only if there is nothing else.
    """
    candidates = [_within(mode, width_px, height_px) for mode in modes if mode.fourcc in DECODED]

    def order(mode: FrameSizes) -> tuple[Any, ...]:
        _, _, fit_w, fit_h = fit_area((mode.width_px, mode.height_px), (width_px, height_px))
        detail_px = min(fit_w * fit_h, mode.width_px * mode.height_px)
        reached = round(min(mode.rates_hz[0] / rate_hz, 1.0), 2) if mode.rates_hz else 1.0
        pixels = mode.width_px * mode.height_px
        slow = not mode.rates_hz and pixels > SMALL_PX and mode.fourcc not in JPEGS
        return -detail_px, mode.fourcc in GREY, slow, -reached, pixels, CHEAPEST.index(mode.fourcc)

    return min(candidates, key=order, default=None)


def _within(mode: FrameSizes, width_px: int, height_px: int) -> FrameSizes:
    """The size nearest to the wanted one in a mode's range of sizes."""
    if mode.largest_px is None:
        return mode
    low_w, low_h, (high_w, high_h) = mode.width_px, mode.height_px, mode.largest_px
    size = min(max(width_px, low_w), high_w), min(max(height_px, low_h), high_h)
    return FrameSizes(mode.fourcc, *size, mode.rates_hz)


def frame_bytes(mode: Mode) -> int:
    """Bytes of a whole uncompressed frame without its last row's padding."""
    rows = mode.height_px * 3 // 2 if mode.fourcc in PLANAR else mode.height_px
    return mode.stride * (rows - 1) + (mode.stride if mode.fourcc in ("YU12", "YV12") else _row_bytes(mode))


def _row_bytes(mode: Mode) -> int:
    if mode.fourcc in PLANAR:
        return mode.width_px
    return mode.width_px * (2 if mode.fourcc in DEEP_GREY_BITS else INTERLEAVED[mode.fourcc][0])


class JpegDecoder:
    """Decodes JPEGs and recognises damaged ones. libjpeg decodes those, too, and reports the damage on stderr alone, so that is
    where this looks; nothing of it reaches the terminal."""

    def __init__(self) -> None:
        self._sink_fd = os.memfd_create("libjpeg")

    def decode(self, data: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]] | None:
        """(the picture, the whole JPEG, a copy of data); None if it is damaged. Some cameras leave out the last two bytes."""
        if not is_jpeg(data):
            return None
        packet = data.copy() if _ends(data) else np.concatenate([data, JPEG_END])
        if sys.stderr is None:  # a program without stderr: nothing to look at, and 2 may be another file
            picture = picture_of(packet)
            return None if picture is None else (picture, packet)
        stderr_fd = os.dup(2)
        os.dup2(self._sink_fd, 2)
        try:
            picture = picture_of(packet)
        finally:
            os.dup2(stderr_fd, 2)
            os.close(stderr_fd)
        if picture is None or (os.lseek(self._sink_fd, 0, os.SEEK_CUR) and self._damage()):
            return None
        return picture, packet

    def _damage(self) -> bool:
        """Whether libjpeg reported damage. Passes on what another thread wrote meanwhile."""
        os.lseek(self._sink_fd, 0, os.SEEK_SET)
        lines = os.read(self._sink_fd, 1 << 16).splitlines(keepends=True)
        os.lseek(self._sink_fd, 0, os.SEEK_SET)
        os.ftruncate(self._sink_fd, 0)
        os.write(2, b"".join(line for line in lines if b"JPEG" not in line and b"JFIF" not in line))
        return any(word in line for line in lines for word in (b"Corrupt JPEG data", b"Premature end of JPEG"))

    def close(self) -> None:
        os.close(self._sink_fd)


def _ends(data: NDArray[np.uint8]) -> bool:
    """Whether a JPEG has its end, maybe with padding behind it."""
    return bool((data[-2:] == JPEG_END).all()) or b"\xff\xd9" in data[-4096:].tobytes().rstrip(b"\0")[-2:]


class FrameDecoder:
    """Decodes the frames of a mode to BGR. Raises ValueError for a format that is not in DECODED, or an impossible stride."""

    def __init__(self, mode: Mode) -> None:
        if mode.fourcc not in DECODED:
            raise ValueError(f"{mode.fourcc} cannot be decoded")
        self.jpeg = mode.fourcc in JPEGS
        if not self.jpeg and mode.stride < _row_bytes(mode):
            raise ValueError(f"{mode.fourcc} of {mode.width_px} px with {mode.stride} bytes per row")
        self._mode, self._shape = mode, (mode.height_px, mode.width_px, 3)
        self._own_size: NDArray[np.uint8] = np.empty(self._shape, np.uint8)
        self._jpegs = JpegDecoder() if self.jpeg else None

    def decode(self, data: NDArray[np.uint8], out: NDArray[np.uint8]) -> tuple[bool, NDArray[np.uint8] | None]:
        """Decodes data, uint8 (n,), into out, uint8 (height, width, 3) BGR, scaled to fit.

        Returns whether the frame was whole, and a copy of the JPEG if it has the mode's own size: the driver gets its buffer back
        before a recorder has written it.
        """
        if self._jpegs is not None:
            decoded = self._jpegs.decode(data)
            if decoded is None:
                return False, None
            picture, packet = decoded
            fitted(picture, out)
            return True, packet if picture.shape == self._shape else None
        if data.size < frame_bytes(self._mode):
            return False, None
        target = out if out.shape == self._shape else self._own_size
        self._convert(data, target)
        fitted(target, out)
        return True, None

    def close(self) -> None:
        if self._jpegs is not None:
            self._jpegs.close()

    def _convert(self, data: NDArray[np.uint8], target: NDArray[np.uint8]) -> None:
        mode = self._mode
        height, width, stride = mode.height_px, mode.width_px, mode.stride
        if (bits := DEEP_GREY_BITS.get(mode.fourcc)) is not None:
            deep: NDArray[np.uint16] = np.ndarray((height, width), "<u2", data.data, strides=(stride, 2))
            grey = np.asarray(deep >> (bits - 8), np.uint8)
            cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR, dst=target)
        elif mode.fourcc in PLANAR:
            cv2.cvtColor(self._planes(data), PLANAR[mode.fourcc], dst=target)
        else:
            channels, conversion = INTERLEAVED[mode.fourcc]
            shape = (height, width, channels) if channels > 1 else (height, width)
            strides = (stride, channels, 1) if channels > 1 else (stride, 1)
            frame: NDArray[np.uint8] = np.ndarray(shape, np.uint8, data.data, strides=strides)
            if conversion is None:
                np.copyto(target, frame)
            else:
                cv2.cvtColor(frame, conversion, dst=target)

    def _planes(self, data: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The planes without padding, stacked: uint8 (height * 3 / 2, width)."""
        mode = self._mode
        height, width, stride = mode.height_px, mode.width_px, mode.stride
        rows = height * 3 // 2
        if stride == width or mode.fourcc in ("NV12", "NV21"):
            return np.ndarray((rows, width), np.uint8, data.data, strides=(stride, 1))
        luma: NDArray[np.uint8] = np.ndarray((height, width), np.uint8, data.data, strides=(stride, 1))
        chroma: NDArray[np.uint8] = np.ndarray((height, width // 2), np.uint8, data.data, height * stride, (stride // 2, 1))
        return np.concatenate([luma.reshape(-1), np.ascontiguousarray(chroma).reshape(-1)]).reshape(rows, width)
