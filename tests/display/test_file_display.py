"""The video: every value preserved, at the right time, and no harm from a full disk."""

import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfpipe.files.video_writer import VideoWriter
from lfpipe.render.file_display import CHECK_FRAMES, FileDisplay


def read_back(path: Path) -> list[np.ndarray]:
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    frames = []
    while (got := capture.read())[0]:
        frames.append(got[1])
    return frames


def noise(count: int, width: int, height: int) -> np.ndarray:
    return np.random.default_rng(5).integers(0, 256, (count, height, width, 3), np.uint8)


@pytest.mark.parametrize("suffix", [".mkv", ".avi"])
@pytest.mark.parametrize("size", [(64, 48), (61, 37)])
def test_every_value_comes_back(tmp_path: Path, suffix: str, size: tuple[int, int]) -> None:
    pictures = noise(10, *size)
    display = FileDisplay(tmp_path / f"out{suffix}", size, 100.0)
    for picture in pictures:
        display.show(picture)
        time.sleep(0.01)
    display.close()
    frames = read_back(tmp_path / f"out{suffix}")
    width, height = size
    cut = [frame[:height, :width] for frame in frames]
    shown = [next(k for k, picture in enumerate(pictures) if np.array_equal(frame, picture)) for frame in cut]
    assert shown == sorted(shown)
    assert display.dropped == 10 - len(set(shown))
    assert display.dropped <= 3


def test_a_picture_stands_until_the_next(tmp_path: Path) -> None:
    pictures = noise(2, 32, 32)
    display = FileDisplay(tmp_path / "out.mkv", (32, 32), 50.0)
    began = time.monotonic()
    display.show(pictures[0])
    time.sleep(0.4)
    display.show(pictures[1])
    middle = time.monotonic()
    time.sleep(0.3)
    display.close()
    ended = time.monotonic()
    frames = read_back(tmp_path / "out.mkv")
    first = sum(np.array_equal(frame, pictures[0]) for frame in frames)
    second = sum(np.array_equal(frame, pictures[1]) for frame in frames)
    assert first + second == len(frames)
    assert abs(first - 50 * (middle - began)) <= 3
    assert abs(second - 50 * (ended - middle)) <= 3


def test_a_flood_is_counted_and_does_not_stop_the_caller(tmp_path: Path) -> None:
    picture = noise(1, 640, 480)[0]
    display = FileDisplay(tmp_path / "out.mkv", (640, 480), 30.0)
    for _ in range(300):
        display.show(picture)
    display.close()
    assert display.dropped > 200
    assert len(read_back(tmp_path / "out.mkv")) < 300 - display.dropped + 60
    assert any(f"{display.dropped} pictures are missing" in notice.text for notice in display.notices())


def test_pictures_of_another_shape_are_fitted(tmp_path: Path) -> None:
    display = FileDisplay(tmp_path / "out.mkv", (64, 32), 50.0)
    display.show(np.full((40, 40, 3), 200, np.uint8))
    display.close()
    frame = read_back(tmp_path / "out.mkv")[0]
    assert frame.shape == (32, 64, 3)
    assert (frame[:, 16:48] == 200).all() and not frame[:, :16].any() and not frame[:, 48:].any()


def test_a_full_disk_ends_the_video_with_a_notice(tmp_path: Path) -> None:
    display = FileDisplay(tmp_path / "out.mkv", (32, 32), 200.0, reserve_bytes=1 << 60)
    picture = noise(1, 32, 32)[0]
    for _ in range(CHECK_FRAMES * 4):
        display.show(picture)
        time.sleep(0.005)
    notices = display.notices()
    assert len(notices) == 1 and notices[0].lost and "the disk is full" in notices[0].text and "out.mkv" in notices[0].text
    display.show(picture)
    display.close()
    assert len(read_back(tmp_path / "out.mkv")) == CHECK_FRAMES  # what was written can be played
    assert display.notices() == []


def test_a_file_that_may_not_grow_ends_the_video(tmp_path: Path) -> None:
    code = f"""
import resource, time, numpy as np
resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
from pathlib import Path
from lfpipe.files.video_writer import VideoWriter
from lfpipe.render.file_display import FileDisplay
display = FileDisplay(Path({str(tmp_path / "out.mkv")!r}), (640, 480), 200.0)
rng = np.random.default_rng(0)
picture = rng.integers(0, 256, (480, 640, 3), np.uint8)
for _ in range(300):
    display.show(picture)
    time.sleep(0.005)
display.close()
print(display.notices())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "no longer grows" in done.stdout and done.stderr == ""


def test_mp4_is_h264_whose_pictures_stand_and_whose_index_comes_first(tmp_path: Path) -> None:
    import av

    pictures = [np.full((36, 60, 3), shade, np.uint8) for shade in (40, 200)]
    display = FileDisplay(tmp_path / "out.mp4", (60, 36), 50.0)
    for picture in pictures:
        display.show(picture)
        time.sleep(0.5)
    display.close()
    with av.open(str(tmp_path / "out.mp4")) as container:
        assert container.streams.video[0].codec_context.name == "h264"
        shades = [frame.to_ndarray(format="rgb24").mean() for frame in container.decode(video=0)]
    assert len(shades) > CHECK_FRAMES, "the file was moved to its place while it grew"
    assert shades == sorted(shades) and shades[0] == pytest.approx(40, abs=2) and shades[-1] == pytest.approx(200, abs=2)
    data = (tmp_path / "out.mp4").read_bytes()
    assert 0 < data.index(b"moov") < data.index(b"mdat") and list(tmp_path.iterdir()) == [tmp_path / "out.mp4"]


def test_mp4_of_a_killed_writer_plays(tmp_path: Path) -> None:
    import av

    code = """if True:
        import os, sys
        from pathlib import Path
        import numpy as np
        from lfpipe.files.video_writer import VideoWriter
        writer = VideoWriter(Path(sys.argv[1]), (64, 48), 30.0)
        for number in range(400):
            writer.write(np.full((48, 64, 3), number % 256, np.uint8))
        os._exit(9)
    """
    path = tmp_path / "killed.mp4"
    assert subprocess.run([sys.executable, "-c", code, str(path)], check=False).returncode == 9
    with av.open(str(path)) as container:
        assert sum(1 for _ in container.decode(video=0)) >= 120


def test_mp4_ends_with_a_notice_where_the_disk_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(VideoWriter, "write", full)
    display = FileDisplay(tmp_path / "out.mp4", (64, 48), 200.0)
    for picture in noise(20, 64, 48):
        display.show(picture)
        time.sleep(0.005)
    display.close()
    assert any("the video ends here" in notice.text for notice in display.notices())
