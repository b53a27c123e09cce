"""Fixtures of several packages: a private world for whole sessions, a clip of a face, a real X
server.
"""

import gc
import logging
import os
import shutil
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import hypothesis
import numpy as np
import psutil
import pytest

from lfpipe import log
from lfpipe.host import PORTABLE
from lfpipe.track import models
from tests.support.films import write_film
from tests.support.world import World, write_scene
from tests.support.xvfb_screen import Screen, look_at, x_server

pytest_plugins = ["tests.support.watchdog"]
# These tests start hundreds of processes: without stored bytecode each compiles everything again,
# which takes minutes.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
cv2.setNumThreads(1)  # a worker has one core; threads of a pool would wait on another's
# The same examples in every run: a change fails for what it does. A fifth of them by default, all
# at night with `--hypothesis-profile=same`; `explore` looks for others. No test has a deadline: how
# long an example takes depends on what else the machine does.
hypothesis.settings.register_profile(
    "explore", deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow]
)
hypothesis.settings.register_profile(
    "same", hypothesis.settings.get_profile("explore"), derandomize=True, database=None
)
hypothesis.settings.register_profile(
    "quick", hypothesis.settings.get_profile("same"), max_examples=20
)
# for copies with a fault, which only have to fail
UNSHRUNK = (hypothesis.Phase.explicit, hypothesis.Phase.generate)
hypothesis.settings.register_profile(
    "unshrunk", hypothesis.settings.get_profile("same"), phases=UNSHRUNK
)
hypothesis.settings.load_profile("quick")
# A runner in the background, or under nohup, has these ignored and hands that down.
signal.signal(signal.SIGINT, signal.default_int_handler)
for _name in ("SIGHUP", "SIGQUIT"):
    if hasattr(signal, _name):
        signal.signal(getattr(signal, _name), signal.SIG_DFL)


@pytest.fixture(autouse=True)
def _log_as_before(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A command in the test's own process sets up the log: it does not outlast the test."""
    monkeypatch.setenv(log.VARIABLE, "")
    root = logging.getLogger("lfpipe")
    level, handlers, propagate = root.level, list(root.handlers), root.propagate
    root.setLevel(logging.NOTSET)
    yield
    root.setLevel(level)
    root.handlers[:] = handlers
    root.propagate = propagate


@pytest.fixture(autouse=True)
def _policy_stays() -> Iterator[None]:
    """A library of codecs may give this process a real-time policy: busy children would then stop
    the machine.
    """
    if not hasattr(os, "sched_getscheduler"):
        yield
        return
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    yield
    if os.sched_getscheduler(0) != before[0]:
        os.sched_setscheduler(0, *before)
        pytest.fail("the test gave its process another scheduling policy")


def pytest_xdist_auto_num_workers() -> int:
    """One worker more than there are physical cores: tests wait for the processes they start."""
    return (psutil.cpu_count(logical=False) or 1) + 1


SESSIONS = {"world", "live", "screen", "xvfb"}  # fixtures of real sessions and windows


@pytest.hookimpl(tryfirst=True)  # before `-m` chooses
def pytest_collection_modifyitems(items: list[pytest.Function]) -> None:
    """A test with a session is `live`, unless it is the one of its kind that
    every run plays through (`everyday`) or runs at night alone; so does a test with a browser. What
    only Linux's own host has is skipped on the portable one.
    """
    for item in items:
        # an argument of a test may have the name of a fixture
        given = item.callspec.params if hasattr(item, "callspec") else {}
        fixtures = set(item.fixturenames) - set(given)
        if "browser" in fixtures:
            item.add_marker(pytest.mark.nightly)
        if SESSIONS & fixtures and not any(
            map(item.get_closest_marker, ("everyday", "alone", "nightly", "camera_vm"))
        ):
            item.add_marker(pytest.mark.live)
    for item in items if PORTABLE else ():
        for mark in item.iter_markers("native"):
            item.add_marker(pytest.mark.skip(reason=f"of Linux's own host alone: {mark.args[0]}"))


def pytest_collection_finish() -> None:
    """The garbage collector, which stages and their memory call, passes over what was imported."""
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def face_networks() -> None:
    """Fetches the networks once if the package mediapipe has no wheel, as the first `lfpipe up`
    would.
    """
    if models.missing_models():
        models.fetch_models(print)


@pytest.fixture(scope="session", autouse=True)
def _no_recent_scenes(tmp_path_factory: pytest.TempPathFactory) -> None:
    """The user's list of recent scenes stays untouched."""
    os.environ["XDG_STATE_HOME"] = str(tmp_path_factory.mktemp("state"))


@pytest.fixture(scope="session")
def as_nobody() -> list[str]:
    """What a command begins with, so that permissions count for it as they do for everybody."""
    if os.getuid():
        return []
    if shutil.which("setpriv") is None:
        pytest.skip(
            "setpriv is not installed (apt-get install util-linux), and permissions do not apply to"
            " root"
        )
    # Another user's id could not reach most of a suite that runs as root: its interpreter is in
    # root's own folder.
    return ["setpriv", "--bounding-set=-all", "--inh-caps=-all"]


@pytest.fixture
def world(tmp_path: Path) -> Iterator[World]:
    with World(tmp_path) as made:
        yield made


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory, scene: Path) -> Iterator[World]:
    """A world with a running session, for all tests of a module that leave it unchanged.

    Pictures reach light after 100 ms.
    """
    shown = (
        "render.anaglyph=colour",
        "render.method=nearest",
        "render.alpha_px=12",
        "render.device_latency_ms=100",
    )
    with World(tmp_path_factory.mktemp("live")) as made:
        made.shows(scene, *(f"--set={text}" for text in shown))
        yield made


@pytest.fixture(scope="session")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A small scene, whose pack is in the cache of every world from now on: to pack it takes
    as long as all else at the start of a session. A copy under another name has its pack, too.
    """
    with World(tmp_path_factory.mktemp("scenes")) as world, pytest.MonkeyPatch.context() as patch:
        grid = write_scene(world.root / "grid")
        world.done("scene", "pack", grid)
        patch.setattr(World, "packs", world.root / "cache")
        yield grid


@pytest.fixture(scope="session")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """60 frames of the demo's face as a video file."""
    from lfpipe import config
    from lfpipe.capture.open_source import open_source

    source = open_source("demo", config.Camera())
    frames = np.empty((60, 480, 640, 3), np.uint8)
    for frame in frames:
        source.read(frame)
    source.close()
    return write_film(tmp_path_factory.mktemp("clips") / "face.avi", frames)


@pytest.fixture(scope="session")
def xvfb(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Screen]:
    if shutil.which("Xvfb") is None:
        pytest.skip("Xvfb is not installed (apt-get install xvfb)")
    folder = tmp_path_factory.mktemp("xvfb")
    command = ["Xvfb", "-screen", "0", "1280x800x24", "-fbdir", str(folder), "-nocursor"]
    with x_server(command, folder) as name:
        if name == ":":
            pytest.skip("Xvfb does not start here")
        yield Screen(name, folder / "Xvfb_screen0")


@pytest.fixture
def screen(xvfb: Screen, monkeypatch: pytest.MonkeyPatch) -> Screen:
    look_at(xvfb.name, monkeypatch)
    return xvfb
