"""The first command of the README, on a machine without a screen, a camera or a scene."""

from pathlib import Path

import cv2
import pytest

from tests.world import World


@pytest.mark.everyday
def test_without_a_screen_the_demo_leaves_a_video_and_a_picture(world: World) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        world.env.pop(name, None)
    world.done("up", "--demo", "--duration", "1.5")
    (video,) = Path(world.root, "lfpipe-demo").glob("demo.m*")
    film = cv2.VideoCapture(str(video))
    assert film.read()[0] and film.get(cv2.CAP_PROP_FRAME_COUNT) >= 10
    assert cv2.imread(str(video.with_suffix(".png"))).std() > 20, "a picture of something"
    assert not world.left()
