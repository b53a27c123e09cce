"""A Wayland compositor without a screen for tests: sway's headless backend, at any rate."""

import contextlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tests.support.processes import end
from tests.support.world import until

NOBODY = 65534
WAIT_S = 20.0


@contextlib.contextmanager
def sway(width_px: int, height_px: int, rate_hz: float, scale: int = 1) -> Iterator[str]:
    """Runs sway with one output for as long as the block lasts: its name for WAYLAND_DISPLAY. It
    never runs as root.
    """
    program = shutil.which("sway")
    assert program is not None
    # not below tmp_path: a socket's name is at most 107 bytes
    folder = Path(tempfile.mkdtemp(prefix="lfpipe-sway-"))
    config = folder / "config"
    config.write_text(
        f"output HEADLESS-1 mode --custom {width_px}x{height_px}@{rate_hz:g}Hz scale"
        f' {scale}\ndefault_border none\ndefault_floating_border none\nfor_window [title=".*"]'
        " floating enable\n"
    )
    env = {"PATH": os.environ["PATH"], "HOME": str(folder), "XDG_RUNTIME_DIR": str(folder)}
    env |= {"WLR_BACKENDS": "headless", "WLR_RENDERER": "pixman", "WLR_LIBINPUT_NO_DEVICES": "1"}
    user: dict[str, Any] = (
        {"user": NOBODY, "group": NOBODY, "extra_groups": []} if os.geteuid() == 0 else {}
    )
    if user:
        os.chown(folder, NOBODY, NOBODY)
    folder.chmod(0o700)
    quiet = subprocess.DEVNULL
    process = subprocess.Popen(
        [program, "-c", str(config)], env=env, stdin=quiet, stdout=quiet, stderr=quiet, **user
    )
    try:
        socket = folder / "wayland-1"
        until(lambda: socket.exists() or process.poll() is not None, "sway", WAIT_S)
        assert socket.exists(), "sway does not start"
        yield str(socket)
    finally:
        end(process)
        shutil.rmtree(folder, ignore_errors=True)
