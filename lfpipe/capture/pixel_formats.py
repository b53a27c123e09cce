"""Pixel formats of cameras: the supported ones, the choice among them, and the conversion to BGR."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.capture.v4l2_device import Mode
from lfpipe.files.decoding import fitted, is_jpeg, picture_of

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
# cheapest to transport and decode first; grey last, because the tracker's model was trained on colours
SMALL = ("YUYV", "UYVY", "YVYU", "NV12", "NV21", "YU12", "YV12", "MJPG", "JPEG", "BGR3", "RGB3", "BGR4", "XR24")
REST = ("RGGB", "BA81", "GBRG", "GRBG", "GREY", "Y10", "Y12", "Y16")
SMALL_PX = 640 * 480  # up to this size uncompressed frames at 30 Hz fit USB 2


def choose(offered: Sequence[str], width_px: int, height_px: int) -> str:
    """The format to request: raw up to SMALL_PX, which saves decoding JPEGs, else JPEG; "" if none can be decoded.

    offered: by the device; a driver that lists nothing gets a request for the usual format.
    """
    jpeg_first = width_px * height_px > SMALL_PX
    wanted = [*(JPEGS if jpeg_first else ()), *SMALL, *REST]
    return next((each for each in wanted if each in offered), "") if offered else wanted[0]


def frame_bytes(mode: Mode) -> int:
    """Bytes of a whole uncompressed frame without its last row's padding."""
    rows = mode.height_px * 3 // 2 if mode.fourcc in PLANAR else mode.height_px
    return mode.stride * (rows - 1) + (mode.stride if mode.fourcc in ("YU12", "YV12") else _row_bytes(mode))


def _row_bytes(mode: Mode) -> int:
    if mode.fourcc in PLANAR:
        return mode.width_px
    return mode.width_px * (2 if mode.fourcc in DEEP_GREY_BITS else INTERLEAVED[mode.fourcc][0])


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

    def decode(self, data: NDArray[np.uint8], out: NDArray[np.uint8]) -> tuple[bool, NDArray[np.uint8] | None]:
        """Decodes data, uint8 (n,), into out, uint8 (height, width, 3) BGR, scaled to fit.

        Returns whether the frame was whole, and a copy of the JPEG if it has the mode's own size.
        """
        if self.jpeg:
            packet = data.copy()  # a copy: the driver gets its buffer back before a recorder has written it
            picture = picture_of(packet) if is_jpeg(packet) else None
            if picture is None:
                return False, None
            fitted(picture, out)
            return True, packet if picture.shape == self._shape else None
        if data.size < frame_bytes(self._mode):
            return False, None
        target = out if out.shape == self._shape else self._own_size
        self._convert(data, target)
        fitted(target, out)
        return True, None

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
