"""Pixel formats of cameras: the supported ones, the choice of a mode, and the conversion to BGR."""

import os
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.capture.v4l2_device import FrameSizes, Mode
from lfpipe.files.codecs import fit_area, fitted, is_jpeg, picture_of

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
# 4:2:0, chroma of half the width and height; the first two with both chroma values interleaved
PLANAR = {
    "NV12": cv2.COLOR_YUV2BGR_NV12,
    "NV21": cv2.COLOR_YUV2BGR_NV21,
    "YU12": cv2.COLOR_YUV2BGR_I420,
    "YV12": cv2.COLOR_YUV2BGR_YV12,
}
GREYS = ("GREY",)  # without colour
DECODED = (*JPEGS, *INTERLEAVED, *PLANAR)
# cheapest to decode first; grey last, because the tracker's model was trained on colours
PLAIN = ("YUYV", "UYVY", "YVYU", "NV12", "NV21", "YU12", "YV12", "BGR3", "RGB3", "BGR4", "XR24")
CHEAPEST = (*PLAIN, *JPEGS, "RGGB", "BA81", "GBRG", "GRBG", "GREY")
SMALL_PX = 640 * 480  # up to this size uncompressed frames at 30 Hz fit USB 2
JPEG_END = np.array([0xFF, 0xD9], np.uint8)  # end of image


def choose(
    modes: Sequence[FrameSizes], width_px: int, height_px: int, rate_hz: float
) -> FrameSizes | None:
    """The mode to request for frames of that size and rate, None if none can be decoded: first the
    one with the most detail in a frame, then colour, then the one that reaches the rate, then the
    one that is cheapest to decode.

    A mode without rates counts as fast enough, but uncompressed frames above SMALL_PX only if there
    is nothing else.
    """
    candidates = [_within(mode, width_px, height_px) for mode in modes if mode.fourcc in DECODED]

    def order(mode: FrameSizes) -> tuple[Any, ...]:
        _, _, fit_w, fit_h = fit_area((mode.width_px, mode.height_px), (width_px, height_px))
        detail_px = min(fit_w * fit_h, mode.width_px * mode.height_px)
        reached = round(min(mode.rates_hz[0] / rate_hz, 1.0), 2) if mode.rates_hz else 1.0
        pixels = mode.width_px * mode.height_px
        slow = not mode.rates_hz and pixels > SMALL_PX and mode.fourcc not in JPEGS
        return (
            -detail_px,
            mode.fourcc == "GREY",
            slow,
            -reached,
            pixels,
            CHEAPEST.index(mode.fourcc),
        )

    return min(candidates, key=order, default=None)


def _within(mode: FrameSizes, width_px: int, height_px: int) -> FrameSizes:
    """The size nearest to the wanted one in a mode's range of sizes."""
    if mode.largest_px is None:
        return mode
    width, height = np.clip(
        (width_px, height_px), (mode.width_px, mode.height_px), mode.largest_px
    ).tolist()
    return FrameSizes(fourcc=mode.fourcc, width_px=width, height_px=height, rates_hz=mode.rates_hz)


class FrameDecoder:
    """Decodes the frames of a mode, one of DECODED, to BGR. Raises ValueError for an impossible
    stride.

    libjpeg also decodes damaged JPEGs, and reports the damage on stderr alone. This class reads it
    there; none of it reaches the terminal.
    """

    def __init__(self, mode: Mode) -> None:
        self._mode = mode
        self._shape = (mode.height_px, mode.width_px, 3)
        self._own_size: NDArray[np.uint8] = np.empty(self._shape, np.uint8)
        self._sink_fd = -1  # where libjpeg writes to
        if mode.fourcc in JPEGS:
            self._sink_fd = os.memfd_create("libjpeg")
            return
        planar = mode.fourcc in PLANAR
        row_bytes = mode.width_px * (1 if planar else INTERLEAVED[mode.fourcc][0])
        rows = mode.height_px * 3 // 2 if planar else mode.height_px
        if mode.stride < row_bytes:
            raise ValueError(
                f"{mode.fourcc} of {mode.width_px} px with {mode.stride} bytes per row"
            )
        # of a whole frame without its last row's padding
        self.frame_bytes = mode.stride * (rows - 1) + (
            mode.stride if mode.fourcc in ("YU12", "YV12") else row_bytes
        )

    def decode(
        self, data: NDArray[np.uint8], out: NDArray[np.uint8]
    ) -> tuple[bool, NDArray[np.uint8] | None]:
        """Decodes data, uint8 (n,), into out, uint8 (height, width, 3) BGR, scaled to fit.

        Returns whether the frame was whole, and a copy of the JPEG if it has the mode's own size:
        the driver gets its buffer back before a recorder has written it.
        """
        if self._mode.fourcc in JPEGS:
            return self._decode_jpeg(data, out)
        if data.size < self.frame_bytes:
            return False, None
        target = out if out.shape == self._shape else self._own_size
        if self._mode.fourcc in PLANAR:
            cv2.cvtColor(self._planes(data), PLANAR[self._mode.fourcc], dst=target)
        else:
            channels, conversion = INTERLEAVED[self._mode.fourcc]
            shape, strides = (*self._shape[:2], channels), (self._mode.stride, channels, 1)
            frame: NDArray[np.uint8] = np.ndarray(shape, np.uint8, data.data, strides=strides)
            if conversion is None:
                np.copyto(target, frame)
            else:
                cv2.cvtColor(frame, conversion, dst=target)
        fitted(target, out)
        return True, None

    def _decode_jpeg(
        self, data: NDArray[np.uint8], out: NDArray[np.uint8]
    ) -> tuple[bool, NDArray[np.uint8] | None]:
        if not is_jpeg(data):
            return False, None
        # Some cameras leave out the last two bytes, some add padding.
        whole = (data[-2:] == JPEG_END).all() or data[-4096:].tobytes().rstrip(b"\0")[
            -2:
        ] == JPEG_END.tobytes()
        packet = data.copy() if whole else np.concatenate([data, JPEG_END])
        stderr_fd = os.dup(2)
        os.dup2(self._sink_fd, 2)
        try:
            picture = picture_of(packet)
        finally:
            os.dup2(stderr_fd, 2)
            os.close(stderr_fd)
        if picture is None or (os.lseek(self._sink_fd, 0, os.SEEK_CUR) and self._damage()):
            return False, None
        fitted(picture, out)
        return True, packet if picture.shape == self._shape else None

    def _damage(self) -> bool:
        """Whether libjpeg reported damage. Passes on what another thread wrote meanwhile."""
        lines = os.pread(self._sink_fd, 1 << 16, 0).splitlines(keepends=True)
        os.lseek(self._sink_fd, 0, os.SEEK_SET)
        os.ftruncate(self._sink_fd, 0)
        os.write(2, b"".join(line for line in lines if b"JPEG" not in line and b"JFIF" not in line))
        return any(
            word in line
            for line in lines
            for word in (b"Corrupt JPEG data", b"Premature end of JPEG")
        )

    def close(self) -> None:
        if self._sink_fd >= 0:
            os.close(self._sink_fd)

    def _planes(self, data: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The planes without padding, stacked: uint8 (height * 3 / 2, width)."""
        height, width, _ = self._shape
        stride = self._mode.stride
        rows = height * 3 // 2
        if stride == width or self._mode.fourcc in ("NV12", "NV21"):
            return np.ndarray((rows, width), np.uint8, data.data, strides=(stride, 1))
        luma: NDArray[np.uint8] = np.ndarray(
            (height, width), np.uint8, data.data, strides=(stride, 1)
        )
        chroma: NDArray[np.uint8] = np.ndarray(
            (height, width // 2), np.uint8, data.data, height * stride, (stride // 2, 1)
        )
        return np.concatenate([luma.ravel(), chroma.ravel()]).reshape(rows, width)
