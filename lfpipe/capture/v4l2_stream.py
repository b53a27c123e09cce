"""Frames of a V4L2 device through mapped buffers: the newest one, with the driver's stamp, number and flags."""

import contextlib
import errno
import mmap
import select
import time

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.capture import v4l2_abi as abi
from lfpipe.capture.v4l2_device import S, V4L2Device

BUFFERS = 4  # one being decoded, one being filled, two spare; older frames are skipped, so spare buffers add no latency
RETRY_S = 0.02
FINAL = (errno.EBUSY, errno.ENODEV, errno.ENXIO, errno.ENOMEM, errno.ENOSPC, errno.EPERM)  # a second attempt would fail, too


@attrs.frozen
class RawFrame:
    """data: uint8 (n,), valid until the next read. sequence: the driver's count of frames; gaps are lost frames. stamp_ns: the
    driver's stamp, from an unknown clock. start_of_exposure: the stamp marks that, else the end of the frame. damaged: the driver
    marked the frame as broken.
    """

    data: NDArray[np.uint8]
    sequence: int
    stamp_ns: int
    start_of_exposure: bool
    damaged: bool


class V4L2Stream:
    """Streams until `close`. device: configured; the caller closes it afterwards. Raises the driver's OSError."""

    def __init__(self, device: V4L2Device) -> None:
        self._device = device
        self._maps: list[mmap.mmap] = []
        self._taken: int | None = None  # index of the buffer in the caller's hands
        try:
            count = min(int(self._call(abi.REQBUFS, self._buffers(BUFFERS)).count), 32)  # VIDEO_MAX_FRAME
            if not count:
                raise OSError(errno.ENOMEM, "the driver has no buffers")
            for index in range(count):
                buffer = device.ioctl(abi.QUERYBUF, self._buffer(index))
                self._maps.append(mmap.mmap(device.fd, buffer.length, offset=buffer.offset))
                self._call(abi.QBUF, self._buffer(index))
            self._call(abi.STREAMON, abi.Number(abi.VIDEO_CAPTURE))
        except OSError:
            self.close()
            raise
        self._poll = select.poll()
        self._poll.register(device.fd, select.POLLIN)

    @staticmethod
    def _buffer(index: int = 0) -> abi.Buffer:
        return abi.Buffer(index=index, type=abi.VIDEO_CAPTURE, memory=abi.MEMORY_MMAP)

    @staticmethod
    def _buffers(count: int) -> abi.RequestBuffers:
        return abi.RequestBuffers(count=count, type=abi.VIDEO_CAPTURE, memory=abi.MEMORY_MMAP)

    def _call(self, request: int, argument: S) -> S:
        """The device's answer; tries once more after a temporary failure."""
        try:
            return self._device.ioctl(request, argument)
        except OSError as error:
            if error.errno in FINAL:
                raise
        time.sleep(RETRY_S)
        return self._device.ioctl(request, argument)

    def read(self, timeout_s: float) -> RawFrame:
        """The newest frame. Raises TimeoutError without one, OSError."""
        if self._taken is not None:
            index, self._taken = self._taken, None
            self._call(abi.QBUF, self._buffer(index))
        until = time.monotonic() + timeout_s
        while True:
            left_s = until - time.monotonic()
            events = self._poll.poll(max(0.0, left_s) * 1e3)
            newest = self._dequeue_newest() if events else None
            if newest is not None:
                return self._frame(newest)
            if left_s <= 0:
                raise TimeoutError(f"no frame for {timeout_s:.1f} s")

    def _dequeue_newest(self) -> abi.Buffer | None:
        newest: abi.Buffer | None = None
        while True:
            buffer = self._buffer()
            try:
                self._device.ioctl(abi.DQBUF, buffer)
            except OSError as error:
                if error.errno == errno.EAGAIN:
                    return newest
                raise
            if newest is not None:
                self._call(abi.QBUF, self._buffer(newest.index))
            newest = buffer
            self._taken = buffer.index

    def _frame(self, buffer: abi.Buffer) -> RawFrame:
        memory, flags = self._maps[buffer.index], int(buffer.flags)
        data = np.frombuffer(memory, np.uint8, min(int(buffer.bytesused), len(memory)))
        stamp_ns = int(buffer.timestamp.seconds) * 1_000_000_000 + int(buffer.timestamp.microseconds) * 1000
        start = flags & abi.STAMP_SOURCE_MASK == abi.STAMP_SOURCE_SOE
        return RawFrame(data, int(buffer.sequence), stamp_ns, start, bool(flags & abi.BUF_FLAG_ERROR))

    def close(self) -> None:
        """Stops the stream and frees the buffers, as far as the driver still answers."""
        with contextlib.suppress(OSError):
            self._device.ioctl(abi.STREAMOFF, abi.Number(abi.VIDEO_CAPTURE))
        for memory in self._maps:
            with contextlib.suppress(BufferError):  # a frame is still in use: the map is freed with it
                memory.close()
        with contextlib.suppress(OSError):
            self._device.ioctl(abi.REQBUFS, self._buffers(0))
