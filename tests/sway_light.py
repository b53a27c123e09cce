"""What a Wayland compositor shows, repaint by repaint: a client of wlr-screencopy on the protocol's own bytes."""

import mmap
import os
import socket
import struct
from collections.abc import Iterator

import numpy as np

DISPLAY, REGISTRY, SYNC = range(1, 4)
SHM, OUTPUT, COPIES = "wl_shm", "wl_output", "zwlr_screencopy_manager_v1"


def _text(words: str) -> bytes:
    data = words.encode() + b"\0"
    return struct.pack("I", len(data)) + data + b"\0" * (-len(data) % 4)


class SwayLight:
    """Opens a connection of its own. name: for WAYLAND_DISPLAY, an absolute path."""

    def __init__(self, name: str) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.connect(name)
        self._data = b""
        self._next = SYNC + 1  # each new object's number is one more than the last one's
        self._send(DISPLAY, 1, struct.pack("I", REGISTRY))
        self._send(DISPLAY, 0, struct.pack("I", SYNC))  # answered after the globals
        self._bound: dict[str, int] = {}
        while (event := self._event())[0] != SYNC:
            sender, opcode, body = event
            if sender == REGISTRY and opcode == 0:
                number, length = struct.unpack_from("II", body)
                interface = body[8 : 8 + length - 1].decode()
                if interface in (SHM, OUTPUT, COPIES) and interface not in self._bound:
                    self._bound[interface] = self._new()
                    made = _text(interface) + struct.pack("II", 1, self._bound[interface])
                    self._send(REGISTRY, 0, struct.pack("I", number) + made)
        assert len(self._bound) == 3, "the compositor has no wlr-screencopy"
        self._memory: mmap.mmap | None = None
        self._buffer = 0

    def pictures(self, step_px: int) -> Iterator[tuple[float, np.ndarray]]:
        """Yields (time of the repaint on CLOCK_MONOTONIC in s, green of every step_px-th pixel, uint8 (rows, columns, 1))."""
        while True:
            frame = self._new()
            self._send(self._bound[COPIES], 0, struct.pack("IiI", frame, 0, self._bound[OUTPUT]))
            width = height = stride = 0
            while True:
                sender, opcode, body = self._event()
                if sender != frame:
                    continue
                assert opcode != 3, "the compositor cannot copy its output"
                if opcode == 0:
                    form, width, height, stride = struct.unpack("4I", body)
                    self._prepare(form, width, height, stride)
                    self._send(frame, 0, struct.pack("I", self._buffer))
                if opcode == 2:
                    high, low, fraction_ns = struct.unpack("3I", body)
                    break
            assert self._memory is not None
            rows = np.frombuffer(self._memory, np.uint8).reshape(height, stride)
            yield (high << 32 | low) + fraction_ns / 1e9, rows[step_px // 2 :: step_px, 1 : 4 * width : 4 * step_px, None].copy()
            self._send(frame, 1, b"")

    def close(self) -> None:
        self._socket.close()

    def _prepare(self, form: int, width: int, height: int, stride: int) -> None:
        if self._memory is not None:
            return
        size = stride * height
        file = os.memfd_create("screen")
        os.ftruncate(file, size)
        self._memory = mmap.mmap(file, size)
        pool, self._buffer = self._new(), self._new()
        body = struct.pack("Ii", pool, size)
        socket.send_fds(self._socket, [struct.pack("II", self._bound[SHM], (8 + len(body)) << 16) + body], [file])
        os.close(file)
        self._send(pool, 0, struct.pack("I4iI", self._buffer, 0, width, height, stride, form))

    def _new(self) -> int:
        self._next += 1
        return self._next - 1

    def _send(self, target: int, opcode: int, body: bytes) -> None:
        self._socket.sendall(struct.pack("II", target, (8 + len(body)) << 16 | opcode) + body)

    def _event(self) -> tuple[int, int, bytes]:
        while True:
            if len(self._data) >= 8:
                sender, word = struct.unpack_from("II", self._data)
                if len(self._data) >= word >> 16:
                    body, self._data = self._data[8 : word >> 16], self._data[word >> 16 :]
                    if sender == DISPLAY and word & 0xFFFF == 0:
                        raise ConnectionError(body[12:].decode(errors="replace"))
                    return sender, word & 0xFFFF, body
                    continue
            data = self._socket.recv(65536)
            if not data:
                raise ConnectionError("the compositor has ended")
            self._data += data
