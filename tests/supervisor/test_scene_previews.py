"""ScenePreviews: pictures of scenes by the packer, without a session."""

import base64
import os
import select
import signal
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from lfpipe.config import Scene
from lfpipe.supervisor.scene_loads import ScenePreviews
from lfpipe.transport.control import MAX_BYTES, encode
from tests.scene import made


def views(folder: Path, value: int) -> str:
    """A scene of 2x2 views of one grey."""
    return str(made.write_grid(folder, np.full((2, 2, 48, 64, 3), value, np.uint8)))


def finish(previews: ScenePreviews) -> None:
    """Waits until all scenes are read."""
    while previews._reader is not None:
        select.select(previews.fds, [], [], 0.05)
        previews.read()


def test_scene_previews_read_every_scene_in_turn(tmp_path: Path) -> None:
    messages: list[dict[str, Any]] = []
    previews = ScenePreviews(messages.append)
    scenes = [views(tmp_path / "dark", 60), str(tmp_path / "gone"), views(tmp_path / "light", 200)]
    settings = Scene(cache_dir=str(tmp_path / "cache"))
    previews.begin(scenes, settings)
    finish(previews)
    assert [message["scene"] for message in messages] == scenes
    assert {message["cmd"] for message in messages} == {"preview"}
    dark, gone, light = (base64.b64decode(message["data"]) for message in messages)
    assert gone == b""
    for data, value in ((dark, 60), (light, 200)):
        picture = np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR))
        assert abs(picture.mean() - value) < 1 and picture.shape[:2] == (240, 320)

    messages.clear()
    previews.begin(scenes, settings)
    assert previews._reader is not None
    os.kill(previews._reader._process.pid, signal.SIGKILL)
    finish(previews)
    assert [message["scene"] for message in messages] == scenes[1:]


def test_scene_previews_of_another_page_end_those_before(tmp_path: Path) -> None:
    messages: list[dict[str, Any]] = []
    previews = ScenePreviews(messages.append)
    previews.begin([str(tmp_path)], Scene())
    process = previews._reader._process  # type: ignore[union-attr]
    previews.begin([], Scene())
    assert not previews.fds and process.exit_code is not None
    previews.read()
    assert messages == []


def test_scene_previews_of_noise_fit_a_message(tmp_path: Path) -> None:
    noise = np.random.default_rng(1).integers(0, 256, (2, 2, 480, 640, 3), np.uint8)
    messages: list[dict[str, Any]] = []
    previews = ScenePreviews(messages.append)
    previews.begin(
        [str(made.write_grid(tmp_path / "noise", noise))], Scene(cache_dir=str(tmp_path / "cache"))
    )
    finish(previews)
    assert 10_000 < len(encode(messages[0])) < MAX_BYTES
