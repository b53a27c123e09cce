"""`--display file:OUT` as a person uses it."""

from pathlib import Path

import cv2

from tests.world import World


def test_a_file_that_is_shown_to_a_file_plays_once_with_its_expected_size(world: World, scene: Path, clip: Path) -> None:
    done = world.run("up", scene, "--camera", f"file:{clip}", "--display", "file:out.mkv", "--session", world.name)
    assert done.returncode == 0, done.stderr
    assert "out.mkv: about" in done.stderr and "MB per minute" in done.stderr and ".mp4 is smaller" in done.stderr
    frames = cv2.VideoCapture(str(world.root / "out.mkv")).get(cv2.CAP_PROP_FRAME_COUNT)
    assert 60 <= frames <= 240, "60 frames at 30 Hz, shown at 60 Hz"
