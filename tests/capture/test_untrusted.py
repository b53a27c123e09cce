"""Deceptive files given as a camera: too large, broken midway, no files at all, odd names."""

import os
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from lfpipe.capture import camera_list
from lfpipe.capture import open_source as open_source_module
from lfpipe.capture.open_source import check_source, open_source
from lfpipe.capture.recordings import MAX_BROKEN, FileSource
from lfpipe.capture.spec import CameraSpec, FileSpec
from lfpipe.errors import UserError
from lfpipe.files.codecs import BrokenFrame
from tests.capture.made_files import CAMERA, SHAPE, noise, video
from tests.support.hostile_files import NO_FILES, ended

OUT = np.zeros(SHAPE, np.uint8)
COUNT = 6


def six(path: Path, fourcc: str = "HFYU") -> Path:
    return video(path, fourcc, [noise(index) for index in range(COUNT)])


def folder(path: Path) -> Path:
    for index in range(5):
        cv2.imwrite(str(path / f"{index}.png"), noise(index))
    return path


def test_a_video_of_too_large_frames_is_refused_without_decoding_them(tmp_path: Path) -> None:
    path = video(tmp_path / "large.avi", "MJPG", [np.full((10_000, 10_000, 3), 90, np.uint8)])
    assert path.stat().st_size < 3_000_000
    words = [sys.executable, "-m", "lfpipe", "record", str(tmp_path / "out")]
    code, _, err, peak_mb = ended([*words, "--camera", f"file:{path}"], timeout_s=100)
    assert code == 2 and str(path) in err and peak_mb < 300, err
    assert "too large to decode" in err or "10000x10000" in err


def played(source: FileSource) -> tuple[list[int], int]:
    """Numbers of the frames, and how many were broken.

    The limit on memory holds for decoding alone.
    """
    seqs = list[int]()
    broken = 0
    limit = resource.getrlimit(resource.RLIMIT_DATA)
    while True:
        try:
            frame = source.read(OUT)
        except BrokenFrame as error:
            assert error.remedy and "\n" not in error.message
            broken += 1
            continue
        assert resource.getrlimit(resource.RLIMIT_DATA) == limit
        if frame is None:
            source.close()
            return seqs, broken
        seqs.append(frame.source_seq)


def test_a_stream_that_grows_half_way_loses_that_frame_and_goes_on(tmp_path: Path) -> None:
    small = cv2.imencode(".jpg", noise(0))[1].tobytes()
    large = cv2.imencode(".jpg", np.full((10_000, 10_000, 3), 90, np.uint8))[1].tobytes()
    path = tmp_path / "grows.mjpeg"
    path.write_bytes(small * 3 + large + small * 3)
    source = FileSource(FileSpec(path, loop=False), CAMERA)
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert played(source) == ([0, 1, 2, 4, 5, 6], 1)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 250_000


def frames_in(avi: bytes) -> list[int]:
    """Offsets of the frames' chunks in an AVI file."""
    return [
        at for at in range(avi.index(b"movi"), len(avi)) if avi[at : at + 4] in (b"00dc", b"00db")
    ]


def with_a_hole(avi: bytes) -> bytes:
    """With zeros in its third frame."""
    at = frames_in(avi)[2]
    return avi[: at + 8] + bytes(292) + avi[at + 300 :]


@pytest.mark.parametrize(
    ("codec", "damage", "numbers", "lost"),
    [
        ("MJPG", with_a_hole, [0, 1, 3, 4, 5], 1),
        ("png ", with_a_hole, [0, 1, 3, 4], 1),  # FFmpeg: one more
        ("HFYU", lambda avi: avi[: frames_in(avi)[4]], [0, 1, 2, 3], 0),
    ],
)
def test_a_damaged_frame_is_reported_and_counted_and_the_rest_is_played(
    tmp_path: Path, codec: str, damage: Callable[[bytes], bytes], numbers: list[int], lost: int
) -> None:
    path = six(tmp_path / "v.avi", codec)
    path.write_bytes(damage(path.read_bytes()))
    assert played(FileSource(FileSpec(path, loop=False), CAMERA)) == (numbers, lost)


def test_a_source_of_broken_frames_only_gives_up(tmp_path: Path) -> None:
    source = FileSource(FileSpec(folder(tmp_path)), CAMERA)
    source.read(OUT)
    for path in tmp_path.iterdir():
        path.unlink()
    broken = 0
    with pytest.raises(UserError, match=f"the {MAX_BROKEN} before it are broken too") as caught:
        while True:
            try:
                source.read(OUT)
            except BrokenFrame:
                broken += 1
    assert broken == MAX_BROKEN and not isinstance(caught.value, BrokenFrame)


LISTS = {  # of other files and addresses, which FFmpeg would follow
    "SDP": "v=0\no=- 0 0\n",
    "list": "ffconcat version 1.0\nfile /etc/passwd\n",
    "playlist": "#EXTM3U\n#EXTINF:1,\nhttp://localhost/x\n",
}


@pytest.mark.parametrize("kind", [*NO_FILES, *LISTS])
def test_non_recordings_are_refused_by_name(tmp_path: Path, kind: str) -> None:
    for path in (tmp_path / "v.avi", tmp_path / "p.png"):
        if kind in LISTS:
            path.write_text(LISTS[kind])
        else:
            NO_FILES[kind](path)
        with pytest.raises(UserError) as caught:
            check_source(f"file:{path}", CAMERA)
        assert str(path) in caught.value.message and caught.value.remedy


@pytest.mark.parametrize(
    "name",
    [
        b"a%d.avi",
        b"concat:a|b.avi",
        b"http:x.avi",
        b"-v.avi",
        "weiß?.avi".encode(),
        b"a\nb.avi",
        b"\xff\xfe.avi",
    ],
)
def test_odd_names_are_opened_unchanged(
    tmp_path: Path, name: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    six(tmp_path / "plain.avi").rename(tmp_path / os.fsdecode(name))
    monkeypatch.chdir(tmp_path)
    source = open_source(f"file:{os.fsdecode(name)}?loop=0", CAMERA)
    assert played(source) == (list(range(COUNT)), 0)  # type: ignore[arg-type]


@pytest.mark.native("Video4Linux")
def test_nobody_waits_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    def hangs(*_: Any) -> Any:
        time.sleep(1000)

    monkeypatch.setattr(camera_list, "ANSWER_S", 0.2)
    monkeypatch.setattr(camera_list, "V4L2Device", hangs)
    with pytest.raises(OSError, match="no answer for"):
        camera_list.asking(Path("/dev/video0"), lambda device: device.captures, 0.2)
    with pytest.raises(UserError, match="does not answer"):
        open_source("camera:/dev/video7", CAMERA)
    monkeypatch.setattr(open_source_module, "_tried", hangs)
    for kind in (FileSpec, CameraSpec):
        monkeypatch.setattr(kind, "time_limit_s", 0.2)
    for text in ("file:x.avi", "camera:/dev/video7"):
        with pytest.raises(UserError, match=r"no answer for 0\.2 s") as caught:
            check_source(text, CAMERA)
        assert caught.value.message.startswith(text)
