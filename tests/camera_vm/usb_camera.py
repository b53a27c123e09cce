"""A USB camera in software: the device side of USB/IP on `vhci-hcd`, so that the kernel's own
uvcvideo drives it.

USB/IP messages as in the kernel's Documentation/usb/usbip_protocol.rst, descriptors and requests as
in the USB Device Class Definition for Video Devices 1.0. Frames travel by bulk transfers; the
attributes of `UsbCamera` are its faults.
"""

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import attrs

HCD = Path("/sys/devices/platform/vhci_hcd.0")
HIGH_SPEED = 3
SUBMIT, UNLINK, SUBMITTED, UNLINKED = 1, 2, 3, 4
STALL, RESET = -32, -104  # EPIPE, ECONNRESET
PAYLOAD = 16384  # uvcvideo's largest bulk transfer: 32 packets of 512 bytes
CLOCK = 10_000_000  # frame intervals count 100 ns
YUYV_GUID = b"YUY2\x00\x00\x10\x00\x80\x00\x00\xaa\x00\x38\x9b\x71"
TERMINAL, PROCESSING = 1, 2  # ids of the camera and its processing unit
GET_MIN, GET_MAX, GET_RES, GET_LEN, GET_INFO, SET_CUR = 0x82, 0x83, 0x84, 0x85, 0x86, 0x01


@attrs.frozen
class Frames:
    """One size of a format, MJPG or YUYV, with its rates."""

    fourcc: str
    width_px: int
    height_px: int
    rates_hz: tuple[float, ...]


@attrs.define
class Control:
    """A control of a unit: size in bytes, and its values."""

    size: int
    low: int
    high: int
    value: int
    step: int = 1


AE_MODE, AE_PRIORITY, EXPOSURE = (TERMINAL, 2), (TERMINAL, 3), (TERMINAL, 4)


def default_controls() -> dict[tuple[int, int], Control]:
    """Exposure with its automatic. AE_MODE is a bitmap: manual and aperture priority."""
    return {
        AE_MODE: Control(1, 1, 8, 8, 9),
        AE_PRIORITY: Control(1, 0, 1, 1),
        EXPOSURE: Control(4, 3, 2047, 157),
    }


def _d(form: str, *values: object) -> bytes:
    """A descriptor without its length byte, which is added."""
    body = struct.pack("<" + form, *values)
    return bytes([len(body) + 1]) + body


class UsbCamera:
    """Plugged in from `plug` to `unplug`.

    frame: called for each frame, returns its bytes. Fault: slow_s, of each control.
    """

    def __init__(
        self,
        modes: Sequence[Frames],
        frame: Callable[[Frames, int], bytes],
        name: str = "Software camera",
    ) -> None:
        self._modes = list(modes)
        self.frame = frame
        self._name = name
        self._formats = list(dict.fromkeys(mode.fourcc for mode in modes))
        self.controls = default_controls()
        self.slow_s = 0.0
        self.mode = self._modes[0]
        self.interval = CLOCK // 30
        self.sent = 0
        self._socket: socket.socket | None = None
        self._port = -1

    def plug(self, port: int = 0) -> None:
        """Plugs the camera into a port of the bus."""
        mine, kernels = socket.socketpair()
        self._socket, self._port = mine, port
        self._lock = threading.Lock()
        self._pending = list[tuple[int, int]]()
        self._ready = threading.Event()
        (HCD / "attach").write_text(f"{port} {kernels.fileno()} {0x10001 + port} {HIGH_SPEED}")
        kernels.close()
        self._ended = threading.Event()
        for work in (self._serve, self._send_frames):
            threading.Thread(target=work, args=(mine,), daemon=True).start()

    def unplug(self) -> None:
        with contextlib.suppress(OSError):
            (HCD / "detach").write_text(str(self._port))
        self._ended.set()
        if self._socket is not None:
            self._socket.close()

    # descriptors

    def _modes_of(self, fourcc: str) -> list[Frames]:
        return [mode for mode in self._modes if mode.fourcc == fourcc]

    def _configuration(self) -> bytes:
        units = _d(
            "BBBHBBHHHB3s", 0x24, 2, TERMINAL, 0x0201, 0, 0, 0, 0, 0, 3, bytes([0b1110, 0, 0])
        )
        units += _d("BBBBHBHB", 0x24, 5, PROCESSING, TERMINAL, 0, 2, 0, 0)
        units += _d("BBBHBBB", 0x24, 3, 3, 0x0101, 0, PROCESSING, 0)
        header = _d("BBHHIBB", 0x24, 1, 0x0100, 13 + len(units), 48_000_000, 1, 1)
        formats = b""
        for index, fourcc in enumerate(self._formats, 1):
            modes = self._modes_of(fourcc)
            jpeg = fourcc == "MJPG"
            if jpeg:
                formats += _d("BBBBBBBBBB", 0x24, 6, index, len(modes), 1, 1, 0, 0, 0, 0)
            else:
                formats += _d(
                    "BBBB16sBBBBBB", 0x24, 4, index, len(modes), YUYV_GUID, 16, 1, 0, 0, 0, 0
                )
            for number, mode in enumerate(modes, 1):
                size = 2 * mode.width_px * mode.height_px
                intervals = [round(CLOCK / hz) for hz in mode.rates_hz]
                rate = (16 * size, 16 * size * 30, size, intervals[0], len(intervals), *intervals)
                form = f"BBBBHHIIIIB{len(intervals)}I"
                formats += _d(
                    form, 0x24, 7 if jpeg else 5, number, 0, mode.width_px, mode.height_px, *rate
                )
        count = len(self._formats)
        inputs = _d(
            f"BBBHBBBBBBB{count}B",
            0x24,
            1,
            count,
            13 + count + len(formats),
            0x81,
            0,
            3,
            0,
            0,
            0,
            1,
            *[0] * count,
        )
        body = _d("BBBBBBB", 11, 0, 2, 14, 3, 0, 0)  # both interfaces are one function
        body += _d("BBBBBBBB", 4, 0, 0, 0, 14, 1, 0, 0) + header + units
        body += (
            _d("BBBBBBBB", 4, 1, 0, 1, 14, 2, 0, 0)
            + inputs
            + formats
            + _d("BBBHB", 5, 0x81, 2, 512, 0)
        )
        return _d("BHBBBBB", 2, 9 + len(body), 2, 1, 0, 0x80, 250) + body

    def _descriptor(self, kind: int, index: int) -> bytes | None:
        if kind == 1:
            return _d(
                "BHBBBBHHHBBBB", 1, 0x0200, 0xEF, 2, 1, 64, 0x1209, 0x0001, 0x0100, 0, 1, 0, 1
            )
        if kind == 2:
            return self._configuration()
        if kind == 3:
            text = struct.pack("<H", 0x0409) if index == 0 else self._name.encode("utf-16le")
            return bytes([2 + len(text), 3]) + text
        return None

    # requests

    def _control(self, setup: bytes, data: bytes) -> bytes | None:
        """The answer to a control request; None to stall."""
        kind, request, value, index, _ = struct.unpack("<BBHHH", setup)
        if kind == 0x80 and request == 6:
            return self._descriptor(value >> 8, value & 0xFF)
        if kind & 0x60 == 0x20 and index & 0xFF == 1:
            return self._stream_control(request, value >> 8, data)
        if kind & 0x60 == 0x20:
            return self._unit_control(request, (index >> 8, value >> 8), data)
        return b"\0\0" if kind & 0x80 else b""

    def _stream_control(self, request: int, selector: int, data: bytes) -> bytes:
        if request == GET_INFO:
            return b"\x03"
        if request == GET_LEN:
            return struct.pack("<H", 26)
        if request == SET_CUR:
            _, index, number, interval = struct.unpack_from("<HBBI", data)
            modes = self._modes_of(self._formats[min(max(index, 1), len(self._formats)) - 1])
            self.mode = modes[min(max(number, 1), len(modes)) - 1]
            offered = [round(CLOCK / hz) for hz in self.mode.rates_hz]
            self.interval = min(offered, key=lambda one: abs(one - interval))
        index = self._formats.index(self.mode.fourcc) + 1
        number = self._modes_of(self.mode.fourcc).index(self.mode) + 1
        size = 2 * self.mode.width_px * self.mode.height_px
        return struct.pack(
            "<HBBIHHHHHII", 0, index, number, self.interval, 0, 0, 0, 0, 0, size, PAYLOAD
        )

    def _unit_control(self, request: int, place: tuple[int, int], data: bytes) -> bytes | None:
        time.sleep(self.slow_s)
        control = self.controls.get(place)
        if control is None:
            return None
        if request == SET_CUR:
            control.value = int.from_bytes(data[: control.size], "little")
            return b""
        if request == GET_INFO:
            return b"\x03"
        if request == GET_LEN:
            return struct.pack("<H", control.size)
        answers = {GET_MIN: control.low, GET_MAX: control.high, GET_RES: control.step}
        return answers.get(request, control.value).to_bytes(control.size, "little")

    # the bus

    def _serve(self, link: socket.socket) -> None:
        def read(count: int) -> bytes:
            data = b""
            while len(data) < count:
                data += (part := link.recv(count - len(data)))
                if not part:
                    raise ConnectionError
            return data

        with contextlib.suppress(OSError):
            while True:
                command, seq, _, incoming, endpoint = struct.unpack(">5I", read(20))
                rest = read(28)
                if command == UNLINK:
                    (unlinked,) = struct.unpack_from(">I", rest)
                    with self._lock:
                        waiting = [one for one in self._pending if one[0] == unlinked]
                        self._pending = [one for one in self._pending if one[0] != unlinked]
                    self._answer(
                        link,
                        struct.pack(">5Ii24x", UNLINKED, seq, 0, 0, 0, RESET if waiting else 0),
                    )
                    continue
                length = struct.unpack_from(">i", rest, 4)[0]
                data = b"" if incoming else read(length)
                if endpoint:
                    with self._lock:
                        self._pending.append((seq, length))
                    self._ready.set()
                    continue
                threading.Thread(
                    target=self._answer_control,
                    args=(link, seq, incoming, rest[20:], data),
                    daemon=True,
                ).start()

    def _answer_control(
        self, link: socket.socket, seq: int, incoming: int, setup: bytes, data: bytes
    ) -> None:
        answer = self._control(setup, data)
        if answer is None:
            self._submitted(link, seq, b"", STALL)
        else:
            wanted = int.from_bytes(setup[6:8], "little")
            self._submitted(
                link, seq, answer[:wanted] if incoming else b"", 0, None if incoming else len(data)
            )

    def _submitted(
        self, link: socket.socket, seq: int, data: bytes, status: int = 0, length: int | None = None
    ) -> None:
        count = len(data) if length is None else length
        self._answer(
            link, struct.pack(">5Iiiiii8x", SUBMITTED, seq, 0, 0, 0, status, count, 0, 0, 0) + data
        )

    def _answer(self, link: socket.socket, message: bytes) -> None:
        with contextlib.suppress(OSError), self._lock:
            link.sendall(message)

    def _take(self) -> tuple[int, int] | None:
        """The next transfer that the driver waits for; None once the camera is unplugged."""
        while not self._ended.is_set():
            with self._lock:
                if self._pending:
                    return self._pending.pop(0)
                self._ready.clear()
            self._ready.wait(0.2)
        return None

    def _send_frames(self, link: socket.socket) -> None:
        due = time.monotonic()
        parity = 0
        while (transfer := self._take()) is not None:
            due = max(due + self.interval / CLOCK, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))
            data = self.frame(self.mode, self.sent)
            parity = parity ^ 1
            self.sent = self.sent + 1
            while transfer is not None:
                room = transfer[1] - 2
                last = len(data) <= room
                self._submitted(
                    link, transfer[0], bytes([2, 0x80 | parity | 2 * last]) + data[:room]
                )
                data = data[room:]
                transfer = None if last else self._take()
