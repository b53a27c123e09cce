"""A whole session in the guest: it opens its camera once, its deadlines hold on a slow machine, faults reach the user."""

import ctypes
import os
import re
import struct
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.camera_vm, pytest.mark.timeout(420)]
IN_OPEN, HEADER = 0x20, struct.Struct("iIII")  # inotify.h
SETTINGS = ("camera.width_px=320", "camera.height_px=180", "camera.rate_hz=10")


class Opens:
    """Counts how often a file is opened, from now on."""

    def __init__(self, path: Path) -> None:
        libc = ctypes.CDLL(None, use_errno=True)
        self._fd = libc.inotify_init1(os.O_NONBLOCK)
        assert self._fd >= 0 and libc.inotify_add_watch(self._fd, os.fsencode(path), IN_OPEN) >= 0, ctypes.get_errno()

    def count(self) -> int:
        """So far; ends the counting."""
        try:
            data = os.read(self._fd, 1 << 16)
        except BlockingIOError:
            data = b""
        finally:
            os.close(self._fd)
        return sum(bool(mask & IN_OPEN) for _, mask, _, length in HEADER.iter_unpack(data) if length == 0)


def up() -> subprocess.CompletedProcess[str]:
    sets = [word for setting in SETTINGS for word in ("--set", setting)]
    command = (sys.executable, "-m", "lfpipe", "up", "--no-picture", "--duration", "12", *sets)
    return subprocess.run(command, capture_output=True, text=True, env={"COLUMNS": "80", "HOME": "/root"}, check=False)


def test_a_session_runs_and_opens_the_camera_once(vivid: Path) -> None:
    opens = Opens(vivid)
    done = up()
    told = done.stdout + done.stderr
    assert done.returncode == 0, told
    rate = re.search(r"capture \w+ +([\d.]+)", told)
    assert rate and float(rate[1]) > 5, told
    restarts = [line.split()[-1] for line in told.splitlines() if re.match(r"(capture|track) ", line)]
    assert restarts == ["0", "0"], told
    assert opens.count() == 1, told
