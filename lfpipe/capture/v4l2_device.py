"""One open V4L2 device: its identity, formats, controls, mode, and frames through mapped buffers;
the pixel formats of cameras: the supported ones, the choice of a mode, and the conversion to BGR.
"""

import contextlib
import errno
import fcntl
import mmap
import os
import select
import time
from collections.abc import Iterator, Sequence
from ctypes import Structure
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeVar

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.capture import v4l2_abi as abi
from lfpipe.files.codecs import fit_area, fitted, is_jpeg, picture_of

MAX_LISTED = 256  # entries of one list, in case a driver never ends it
# the end of a list, or a driver without such lists or controls
NOT_THERE = (errno.EINVAL, errno.ENOTTY)

# one being decoded, one being filled, two spare;
# older frames are skipped, so spare buffers add no latency
BUFFERS = 4

S = TypeVar("S", bound=Structure)


@attrs.frozen
class Mode:
    """What a device delivers."""

    fourcc: str
    """See `v4l2_abi.fourcc_text`."""
    width_px: int
    height_px: int
    stride: int
    """Bytes per row, 0 for JPEGs."""
    rate_hz: float
    """0 if unknown."""


@attrs.frozen(kw_only=True)
class FrameSizes:
    """A pixel format with one of its sizes, or with a range of sizes."""

    fourcc: str
    width_px: int
    height_px: int
    rates_hz: tuple[float, ...] = ()
    """Descending, in a range those of the smallest size; empty if unknown."""
    largest_px: tuple[int, int] | None = None
    """(width, height) of the largest size of a range."""

    @property
    def text(self) -> str:
        least = f"{self.width_px}x{self.height_px}"
        return f"{least}..{self.largest_px[0]}x{self.largest_px[1]}" if self.largest_px else least


@attrs.frozen
class ControlRange:
    """A control of integers, in the driver's units."""

    minimum: int
    maximum: int
    step: int


@attrs.frozen(kw_only=True)
class RawFrame:
    """A frame as the driver delivers it."""

    data: NDArray[np.uint8]
    """uint8 (n,), valid until the next read."""
    sequence: int
    """The driver's count of frames; gaps are lost frames."""
    stamp_ns: int
    """The driver's stamp, from an unknown clock."""
    start_of_exposure: bool
    """The stamp marks that, else the end of the frame."""
    damaged: bool
    """The driver marked the frame as broken."""


def _buffer(index: int = 0) -> abi.Buffer:
    return abi.Buffer(index=index, type=abi.VIDEO_CAPTURE, memory=abi.MEMORY_MMAP)


def _buffers(count: int) -> abi.RequestBuffers:
    return abi.RequestBuffers(count=count, type=abi.VIDEO_CAPTURE, memory=abi.MEMORY_MMAP)


class V4L2Device:
    """Owns a descriptor of the device at path. Every call raises the driver's OSError."""

    def __init__(self, path: Path, fd: int | None = None) -> None:
        """fd: of the device, if it is already open."""
        self.path = path
        self.fd = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC) if fd is None else fd
        self._maps: list[mmap.mmap] = []  # while it streams
        self._lent: int | None = None  # index of the buffer in the caller's hands
        try:
            capability = self.ioctl(abi.QUERYCAP, abi.Capability())
        except OSError:
            self.close()
            raise
        self.driver = bytes(capability.driver).decode(errors="replace")
        whole, own = int(capability.capabilities), int(capability.device_caps)
        # of this node, not of its device as a whole
        self._capabilities = own if whole & abi.CAP_DEVICE_CAPS else whole

    def ioctl(self, request: int, argument: S) -> S:
        """argument as the driver changed it."""
        fcntl.ioctl(self.fd, request, argument)
        return argument

    @property
    def captures(self) -> bool:
        """Whether this node delivers pictures to mapped buffers (a camera's second node is for
        metadata).
        """
        return self._capabilities & abi.CAP_CAPTURES == abi.CAP_CAPTURES

    @property
    def multi_planar(self) -> bool:
        """Whether this node delivers pictures through the multi-planar interface alone, as boards
        with a camera port do.
        """
        return not self.captures and bool(self._capabilities & abi.CAP_MULTI_PLANAR)

    @property
    def signal(self) -> bool:
        """False if the present input reports that nothing is connected to it; its frames are then
        noise or one colour.
        """
        try:
            number = self.ioctl(abi.G_INPUT, abi.Number()).value
            return (
                not self.ioctl(abi.ENUMINPUT, abi.Input(index=number)).status
                & abi.INPUT_WITHOUT_SIGNAL
            )
        except OSError:  # a driver without inputs
            return True

    def fourccs(self) -> list[str]:
        """The pixel formats that the device offers, in the driver's order."""
        message = abi.FormatDescription(type=abi.VIDEO_CAPTURE)
        return [abi.fourcc_text(message.pixelformat) for _ in self._listed(abi.ENUM_FMT, message)]

    def sizes(self, fourcc: str) -> list[FrameSizes]:
        """The frame sizes of a pixel format with their rates; a range of sizes is one entry."""
        code = abi.fourcc_code(fourcc)
        sizes: list[FrameSizes] = []
        message = abi.FrameSize(pixelformat=code)
        for _ in self._listed(abi.ENUM_FRAMESIZES, message):
            width_px, height_px, *_ = message.sizes
            largest_px = None
            if message.type != abi.DISCRETE:
                width_px, most_width_px, _, height_px, most_height_px, _ = message.sizes
                largest_px = most_width_px, most_height_px
            sizes.append(
                FrameSizes(
                    fourcc=fourcc,
                    width_px=width_px,
                    height_px=height_px,
                    rates_hz=self._rates(code, width_px, height_px),
                    largest_px=largest_px,
                )
            )
            if largest_px is not None:
                break
        return sizes

    def _rates(self, code: int, width_px: int, height_px: int) -> tuple[float, ...]:
        message = abi.FrameInterval(pixelformat=code, width=width_px, height=height_px)
        rates_hz: set[float] = set()
        for _ in self._listed(abi.ENUM_FRAMEINTERVALS, message):
            if message.interval[0]:
                rates_hz.add(message.interval[1] / message.interval[0])
            if message.type != abi.DISCRETE:
                break
        return tuple(sorted(rates_hz, reverse=True))

    def _listed(self, request: int, message: Structure) -> Iterator[None]:
        """Fills message with one entry after another."""
        for index in range(MAX_LISTED):
            message.index = index
            try:
                self.ioctl(request, message)
            except OSError as error:
                if error.errno in NOT_THERE:
                    return
                raise
            yield

    def configure(self, fourcc: str, width_px: int, height_px: int, rate_hz: float) -> Mode:
        """Requests a mode and returns the one that the driver chose.

        Raises EBUSY while another program streams.
        """
        message = abi.Format(type=abi.VIDEO_CAPTURE)
        pix = message.fmt.pix
        pix.width = width_px
        pix.height = height_px
        pix.pixelformat = abi.fourcc_code(fourcc)
        pix.field = abi.FIELD_NONE
        self.ioctl(abi.S_FMT, message)
        pace = Fraction(1 / rate_hz).limit_denominator(100_000)
        parameters = abi.StreamParameters(
            type=abi.VIDEO_CAPTURE, interval=(pace.numerator, pace.denominator)
        )
        actual_hz = 0.0
        with contextlib.suppress(OSError):  # a driver without rates
            numerator, denominator = self.ioctl(abi.S_PARM, parameters).interval
            actual_hz = denominator / numerator if numerator else 0.0
        rate_hz = actual_hz if actual_hz < 10_000 else 0.0  # nonsense
        return Mode(
            abi.fourcc_text(pix.pixelformat), pix.width, pix.height, pix.bytesperline, rate_hz
        )

    def control_range(self, control: int) -> ControlRange | None:
        """The range of a control; None if the device has no such settable control."""
        message = abi.QueryControl(id=control)
        try:
            self.ioctl(abi.QUERYCTRL, message)
        except OSError as error:
            if error.errno in NOT_THERE:
                return None
            raise
        if message.flags & (abi.CTRL_DISABLED | abi.CTRL_READ_ONLY):
            return None
        return ControlRange(message.minimum, message.maximum, max(1, message.step))

    def control(self, control: int) -> int:
        """The value of a control."""
        return int(self.ioctl(abi.G_CTRL, abi.Control(id=control)).value)

    def set_control(self, control: int, value: int) -> None:
        self.ioctl(abi.S_CTRL, abi.Control(id=control, value=value))

    def duplicate(self) -> "V4L2Device":
        """The same open device on a descriptor of its own, for another thread: some drivers open
        only once.
        """
        return V4L2Device(self.path, os.dup(self.fd))

    def start(self) -> None:
        """Streams in the mode of `configure` until `close`."""
        count = int(self.ioctl(abi.REQBUFS, _buffers(BUFFERS)).count)
        if not count:
            raise OSError(errno.ENOMEM, "the driver has no buffers")
        try:
            for index in range(count):
                buffer = self.ioctl(abi.QUERYBUF, _buffer(index))
                self._maps.append(mmap.mmap(self.fd, buffer.length, offset=buffer.offset))
                self.ioctl(abi.QBUF, _buffer(index))
            self.ioctl(abi.STREAMON, abi.Number(abi.VIDEO_CAPTURE))
        except OSError:  # another mode may be tried, for which it must have no buffers
            self._stop()
            raise
        self._poll = select.poll()
        self._poll.register(self.fd, select.POLLIN)

    def read(self, timeout_s: float) -> RawFrame:
        """The newest frame of the stream. Raises TimeoutError without one."""
        if self._lent is not None:
            index = self._lent
            self._lent = None
            self.ioctl(abi.QBUF, _buffer(index))
        until = time.monotonic() + timeout_s
        newest: abi.Buffer | None = None
        while newest is None:
            left_s = until - time.monotonic()
            if self._poll.poll(max(0.0, left_s) * 1e3):
                newest = self._dequeue_newest()
            if newest is None and left_s <= 0:
                raise TimeoutError(f"no frame for {timeout_s:.1f} s")
        memory = self._maps[newest.index]
        stamp = newest.timestamp
        return RawFrame(
            data=np.frombuffer(memory, np.uint8, min(newest.bytesused, len(memory))),
            sequence=newest.sequence,
            stamp_ns=stamp.seconds * 1_000_000_000 + stamp.microseconds * 1000,
            start_of_exposure=newest.flags & abi.STAMP_SOURCE_MASK == abi.STAMP_SOURCE_SOE,
            damaged=bool(newest.flags & abi.BUF_FLAG_ERROR),
        )

    def _dequeue_newest(self) -> abi.Buffer | None:
        newest: abi.Buffer | None = None
        while True:
            try:
                buffer = self.ioctl(abi.DQBUF, _buffer())
            except OSError as error:
                if error.errno == errno.EAGAIN:
                    return newest
                raise
            if newest is not None:
                self.ioctl(abi.QBUF, _buffer(newest.index))
            newest = buffer
            self._lent = buffer.index

    def close(self) -> None:
        """Stops the stream and frees its buffers, as far as the driver still answers, and closes
        the descriptor.
        """
        if self.fd < 0:
            return
        if self._maps:
            self._stop()
        os.close(self.fd)
        self.fd = -1

    def _stop(self) -> None:
        with contextlib.suppress(OSError):
            self.ioctl(abi.STREAMOFF, abi.Number(abi.VIDEO_CAPTURE))
        for memory in self._maps:
            # a frame is still in use: the map is freed with it
            with contextlib.suppress(BufferError):
                memory.close()
        self._maps.clear()
        with contextlib.suppress(OSError):
            self.ioctl(abi.REQBUFS, _buffers(0))


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
JPEG_END = b"\xff\xd9"  # end of image


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
        whole = data[-4096:].tobytes().rstrip(b"\0").endswith(JPEG_END)
        packet = data.copy() if whole else np.frombuffer(data.tobytes() + JPEG_END, np.uint8)
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
