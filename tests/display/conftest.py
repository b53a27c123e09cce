"""A real X server without a screen."""

import os
import shutil
import subprocess
from collections.abc import Iterator

import pytest
from xvfb_screen import Screen  # the one beside this file


@pytest.fixture(scope="session")
def xvfb(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Screen]:
    if shutil.which("Xvfb") is None:
        pytest.skip("Xvfb is not installed (apt-get install xvfb)")
    folder = tmp_path_factory.mktemp("xvfb")
    read, write = os.pipe()
    # Without -noreset it starts over whenever the last window closes, and drops who connects meanwhile.
    command = ["Xvfb", "-displayfd", str(write), "-screen", "0", "1280x800x24", "-fbdir", str(folder)]
    command += ["-noreset", "-nocursor", "-nolisten", "tcp"]
    server = subprocess.Popen(command, pass_fds=[write], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    os.close(write)
    try:
        with os.fdopen(read) as told:
            number = told.readline().strip()  # the server chooses a free number and tells it when it is ready
        if not number:
            pytest.skip("Xvfb does not start here")
        yield Screen(f":{number}", folder / "Xvfb_screen0")
    finally:
        server.terminate()
        server.wait()


@pytest.fixture
def screen(xvfb: Screen, monkeypatch: pytest.MonkeyPatch) -> Screen:
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.delenv("SDL_VIDEODRIVER", raising=False)
    monkeypatch.setenv("DISPLAY", xvfb.name)
    return xvfb
