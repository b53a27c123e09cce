"""The viewer of a running session is exchanged, by its window and by other clients."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from lfpipe.errors import UserError
from tests.support.world import World


def _source(world: World) -> str:
    return str(world.ask(cmd="hello")["options"]["viewer"].get("source", "mouse"))


def test_viewer_is_exchanged_where_it_can_be(world: World, scene: Path) -> None:
    world.shows(scene)
    missing = str(world.root / "missing.mkv")
    for source, why in ((missing, missing), (3, "viewer needs")):
        with pytest.raises(UserError, match=why):
            world.ask(cmd="viewer", source=source)
    assert _source(world) == "demo"
    grey = world.root / "nobody.avi"
    writer = cv2.VideoWriter(str(grey), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (320, 240))
    for _ in range(30):
        writer.write(np.full((240, 320, 3), 90, np.uint8))
    writer.release()
    assert world.ask(cmd="viewer", source=f"file:{grey}?loop=1")["ok"]
    world.wait_for(lambda: not world.monitor()["stages"]["track"]["face"], "no face")
