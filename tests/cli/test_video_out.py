"""A file in, a file out: it plays once, its size is reported before and while it grows, and it ends."""

import os
import pty
import re
import threading
from pathlib import Path

import cv2

from tests.world import World


def test_a_file_that_is_shown_to_a_file_plays_once_with_its_size_said(world: World, scene: Path, clip: Path) -> None:
    leader, follower = pty.openpty()
    words = ("up", scene, "--camera", f"file:{clip}", "--display", "file:out.mkv", "--session", world.name)
    said = bytearray()

    def read() -> None:
        try:
            while data := os.read(leader, 4096):
                said.extend(data)
        except OSError:  # the other end is closed
            pass

    reader = threading.Thread(target=read)
    reader.start()
    process = world.start(*words, stderr=follower)
    os.close(follower)
    assert process.wait(60) == 0, said.decode()
    reader.join(10)
    os.close(leader)
    text = said.decode()
    assert "out.mkv: about" in text and "MB per minute" in text and ".mp4 is smaller" in text
    assert re.search(r"out\.mkv: \d+\.\d MB after \d+ s", text), "nothing said while it grew"
    assert "ended" in text or "end" in text
    frames = cv2.VideoCapture(str(world.root / "out.mkv")).get(cv2.CAP_PROP_FRAME_COUNT)
    assert 60 <= frames <= 240, "60 frames at 30 Hz, shown at 60 Hz"
