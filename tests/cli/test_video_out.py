"""`--display file:OUT` as a person uses it."""

from pathlib import Path

import cv2

from tests.world import World


def test_a_file_that_is_shown_to_a_file_plays_once(world: World, scene: Path, clip: Path) -> None:
    done = world.run("up", scene, "--camera", f"file:{clip}", "--display", "file:out.mkv", "--session", world.name)
    assert done.returncode == 0 and "out.mkv" in done.stdout, done.stderr
    frames = cv2.VideoCapture(str(world.root / "out.mkv")).get(cv2.CAP_PROP_FRAME_COUNT)
    assert 60 <= frames <= 240, "60 frames at 30 Hz, shown at 60 Hz"
