"""X servers for tests, and the picture of a server without a screen, read from its framebuffer
file.
"""

import contextlib
import os
import shutil
import struct
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path

import attrs
import numpy as np
import pytest

from tests.support.processes import end

needs_xdotool = pytest.mark.skipif(
    shutil.which("xdotool") is None, reason="apt-get install xdotool"
)


@attrs.frozen
class Screen:
    """name: for DISPLAY; buffer: the file in which the server keeps its picture, in the format of
    xwd.
    """

    name: str
    buffer: Path

    def pixels(self) -> np.ndarray:
        """What the screen shows now: uint32 (height, width), in the byte order of the server."""
        data = self.buffer.read_bytes()
        header = struct.unpack_from(">25I", data)
        size, width, height, bits, line, colours = (header[k] for k in (0, 4, 5, 11, 12, 19))
        assert bits == 32
        order = "<u4" if header[7] == 0 else ">u4"
        rows = np.frombuffer(data, order, height * line // 4, size + 12 * colours)
        return rows.reshape(height, line // 4)[:, :width]

    def picture(self) -> np.ndarray:
        """What a screen of 24 bits shows now: uint8 (height, width, 3) BGR."""
        pixels = np.ascontiguousarray(self.pixels(), "<u4")
        return pixels.view(np.uint8).reshape(*pixels.shape, 4)[..., :3]

    def shown(self) -> np.ndarray:
        """The part of the screen that is not black."""
        picture = self.picture()
        rows = np.nonzero(picture.any(axis=(1, 2)))[0]
        cols = np.nonzero(picture.any(axis=(0, 2)))[0]
        return (
            picture[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
            if len(rows)
            else picture[:0, :0]
        )


def look_at(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows of this process open on the X server of that name."""
    for variable in ("WAYLAND_DISPLAY", "SDL_VIDEODRIVER", "SDL_FRAMEBUFFER_ACCELERATION"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setenv("DISPLAY", name)


@contextlib.contextmanager
def x_server(command: Sequence[str], folder: Path) -> Iterator[str]:
    """A server for as long as the block lasts: its name for DISPLAY, ":" where it does not start.
    folder: what it works in.
    """
    read, write = os.pipe()
    # else it starts over with the last window's end
    whole = [*command, "-displayfd", str(write), "-noreset", "-nolisten", "tcp"]
    server = subprocess.Popen(
        whole, pass_fds=[write], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    os.close(write)
    try:
        with os.fdopen(read) as told:
            # it chooses a free number and tells it when it is ready
            yield f":{told.readline().strip()}"
    finally:
        end(server)


def outline(title: str, name: str) -> tuple[int, int, int, int] | None:
    """x, y, width, height of the window of that title on the server of that name; None while there
    is none.
    """
    done = subprocess.run(
        ["xwininfo", "-display", name, "-name", title], capture_output=True, text=True
    )
    words = dict(
        line.split(":", 1)
        for line in done.stdout.splitlines()
        if line.startswith("  ") and ":" in line
    )
    told = {key.strip(): value for key, value in words.items()}
    names = ("Absolute upper-left X", "Absolute upper-left Y", "Width", "Height")
    x, y, width, height = (int(told.get(key, -1)) for key in names)
    return (x, y, width, height) if width > 0 else None
