"""The video: every value preserved, at the right time, and no harm from a full disk."""

import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfpipe.files.codecs import VideoWriter
from lfpipe.render.display.display import DisplayNotice
from lfpipe.render.display.file_display import FileDisplay


def read_back(path: Path) -> list[np.ndarray]:
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    frames = []
    while (answer := capture.read())[0]:
        frames.append(answer[1])
    return frames


def noise(count: int, width: int, height: int) -> np.ndarray:
    return np.random.default_rng(5).integers(0, 256, (count, height, width, 3), np.uint8)


def record(
    path: Path, pictures: Iterable[np.ndarray], rate_hz: float, wait_s: float = 0.0, **options: int
) -> tuple[int, DisplayNotice | None]:
    """Shows the pictures one after the other: how many were dropped, and the notice."""
    pictures = list(pictures)
    display = FileDisplay(path, (pictures[0].shape[1], pictures[0].shape[0]), rate_hz, **options)
    for picture in pictures:
        display.show(picture)
        time.sleep(wait_s)
    display.close()
    return display.dropped, display.notice


@pytest.mark.parametrize("size", [(64, 48), (61, 37)])
def test_file_display_mkv_keeps_every_value(tmp_path: Path, size: tuple[int, int]) -> None:
    pictures = noise(10, *size)
    dropped, _ = record(tmp_path / "out.mkv", pictures, 100.0, 0.01)
    cut = [frame[: size[1], : size[0]] for frame in read_back(tmp_path / "out.mkv")]
    shown = [
        next(k for k, picture in enumerate(pictures) if np.array_equal(frame, picture))
        for frame in cut
    ]
    assert shown == sorted(shown) and dropped == 10 - len(set(shown)) <= 3


def test_file_display_ends_the_video_on_a_full_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pictures = [noise(1, 32, 32)[0]] * 40
    _, notice = record(tmp_path / "out.mkv", pictures, 200.0, 0.005, reserve_bytes=1 << 60)
    assert notice is not None and notice.lost
    assert "the disk is full" in notice.text and "out.mkv" in notice.text
    assert len(read_back(tmp_path / "out.mkv")) == 1  # what was written can be played

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(VideoWriter, "write", full)
    _, notice = record(tmp_path / "out.mp4", pictures, 200.0, 0.005)
    assert notice is not None and "the video ends here" in notice.text


def test_video_writer_killed_leaves_an_mp4_that_plays(tmp_path: Path) -> None:
    import av

    code = """if True:
        import os, sys
        from pathlib import Path
        import numpy as np
        from lfpipe.files.codecs import IN_FRAGMENTS, VideoWriter
        writer = VideoWriter(Path(sys.argv[1]), (64, 48), 30.0, IN_FRAGMENTS)
        for number in range(400):
            writer.write(np.full((48, 64, 3), number % 256, np.uint8))
        os._exit(9)
    """
    path = tmp_path / "killed.mp4"
    assert subprocess.run([sys.executable, "-c", code, str(path)], check=False).returncode == 9
    with av.open(str(path)) as container:
        assert sum(1 for _ in container.decode(video=0)) >= 120
