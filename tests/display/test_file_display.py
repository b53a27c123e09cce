"""The video: every value preserved, at the right time, and no harm from a full disk."""

import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfpipe.files.video_writer import VideoWriter
from lfpipe.render.display.display import DisplayNotice
from lfpipe.render.display.file_display import CHECK_FRAMES, FileDisplay


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
) -> tuple[int, list[DisplayNotice]]:
    """Shows the pictures one after the other: how many were dropped, and the notices."""
    pictures = list(pictures)
    display = FileDisplay(path, (pictures[0].shape[1], pictures[0].shape[0]), rate_hz, **options)
    for picture in pictures:
        display.show(picture)
        time.sleep(wait_s)
    display.close()
    return display.dropped, display.notices()


def test_file_display_avi_is_small_and_close(tmp_path: Path) -> None:
    y, x = np.mgrid[:240, :320].astype(np.float32)
    picture = np.dstack([np.sin(x / 9) * np.cos(y / 7) * 90 + 128] * 3).astype(np.uint8)
    for suffix in (".avi", ".mkv"):
        record(tmp_path / f"out{suffix}", [picture] * 30, 100.0, 0.01)
    assert cv2.PSNR(read_back(tmp_path / "out.avi")[-1], picture) > 38
    sizes = [(tmp_path / f"out{suffix}").stat().st_size for suffix in (".avi", ".mkv")]
    assert sizes[0] < sizes[1] / 2


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


def test_file_display_fits_pictures_of_another_shape(tmp_path: Path) -> None:
    record(
        tmp_path / "out.mkv",
        (np.zeros((32, 64, 3), np.uint8), np.full((40, 40, 3), 200, np.uint8)),
        50.0,
        0.1,
    )
    frame = read_back(tmp_path / "out.mkv")[-1]
    assert frame.shape == (32, 64, 3)
    assert (frame[:, 16:48] == 200).all() and not frame[:, :16].any() and not frame[:, 48:].any()


def test_file_display_ends_the_video_on_a_full_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pictures = [noise(1, 32, 32)[0]] * (CHECK_FRAMES * 4)
    _, notices = record(tmp_path / "out.mkv", pictures, 200.0, 0.005, reserve_bytes=1 << 60)
    assert (
        len(notices) == 1
        and notices[0].lost
        and "the disk is full" in notices[0].text
        and "out.mkv" in notices[0].text
    )
    assert len(read_back(tmp_path / "out.mkv")) == CHECK_FRAMES  # what was written can be played

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(VideoWriter, "write", full)
    _, notices = record(tmp_path / "out.mp4", pictures, 200.0, 0.005)
    assert any("the video ends here" in notice.text for notice in notices)


def test_file_display_mp4_is_h264(tmp_path: Path) -> None:
    import av

    record(
        tmp_path / "out.mp4",
        [np.full((36, 60, 3), shade, np.uint8) for shade in (40, 200)],
        50.0,
        0.5,
    )
    with av.open(str(tmp_path / "out.mp4")) as container:
        assert container.streams.video[0].codec_context.name == "h264"
        shades = [frame.to_ndarray(format="rgb24").mean() for frame in container.decode(video=0)]
    assert (
        shades == sorted(shades)
        and shades[0] == pytest.approx(40, abs=2)
        and shades[-1] == pytest.approx(200, abs=2)
    )
    assert list(tmp_path.iterdir()) == [tmp_path / "out.mp4"]


def test_file_display_mp4_writes_through_no_link(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("mine")
    names = (".out.mp4.index", ".out.mp4", ".out.new.mp4", "..out.new.mp4.index", ".out.index")
    planted = [tmp_path / name for name in (*names, ".out.new.mp4.index")]
    for link in planted:
        link.symlink_to(victim)
    record(tmp_path / "out.mp4", [np.full((36, 60, 3), 90, np.uint8)] * 2, 50.0, 1.3)
    assert victim.read_text() == "mine" and all(link.is_symlink() for link in planted)
    assert not (tmp_path / "out.mp4").is_symlink() and read_back(tmp_path / "out.mp4")


def test_video_writer_killed_leaves_an_mp4_that_plays(tmp_path: Path) -> None:
    import av

    code = """if True:
        import os, sys
        from pathlib import Path
        import numpy as np
        from lfpipe.files.video_writer import IN_FRAGMENTS, VideoWriter
        writer = VideoWriter(Path(sys.argv[1]), (64, 48), 30.0, IN_FRAGMENTS)
        for number in range(400):
            writer.write(np.full((48, 64, 3), number % 256, np.uint8))
        os._exit(9)
    """
    path = tmp_path / "killed.mp4"
    assert subprocess.run([sys.executable, "-c", code, str(path)], check=False).returncode == 9
    with av.open(str(path)) as container:
        assert sum(1 for _ in container.decode(video=0)) >= 120
