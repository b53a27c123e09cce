"""`lfpipe calibrate live:...`: how the second camera stands, measured, stored, and used."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from lfpipe.capture.live_source import check_live
from lfpipe.capture.open_source import camera_name
from lfpipe.cli import cli
from lfpipe.config import Config
from lfpipe.config.user_files import camera_file, with_measured_focal, write_keys
from lfpipe.errors import UserError
from tests.live import made
from tests.render import rendered
from tests.support.films import write_film

HEIGHT, WIDTH, TURN_DEG = 240, 320, 0.8


@pytest.fixture
def settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "settings"))
    return camera_file()


def calibrated(text: str) -> str:
    words = ["calibrate", text]
    return CliRunner().invoke(cli, words, standalone_mode=False, catch_exceptions=False).output


def test_placement_is_stored_for_the_cameras_and_used(tmp_path: Path, settings: Path) -> None:
    frame = made.frame_of(rendered.field(1, 2, HEIGHT, WIDTH, scale=1.0))
    size_px = WIDTH, HEIGHT
    turned = cv2.getRotationMatrix2D(((WIDTH - 1) / 2, (HEIGHT - 1) / 2), -TURN_DEG, 1.0)
    turned[1, 2] += 3
    right = frame[:, WIDTH:]
    right[:] = cv2.warpAffine(right.copy(), turned, size_px, borderMode=cv2.BORDER_REPLICATE)
    text = f"live:file:{write_film(tmp_path / 'pair.avi', [frame] * 10)}"
    assert check_live(text, Config()).placement is None
    said = calibrated(text)
    assert "right camera is rotated by 0.8 degrees clockwise" in said and str(settings) in said
    live = check_live(text, Config())
    assert live.placement is not None and not live.placement.swapped
    assert live.placement.rotation_deg == pytest.approx(TURN_DEG, abs=0.15)
    assert live.placement.height_px == pytest.approx(3, abs=0.5)
    # of the same cameras with views of half the size, and beside a camera's focal length
    half = np.asarray(cv2.resize(frame, None, fx=0.5, fy=0.5), np.uint8)
    write_film(tmp_path / "pair.avi", [half] * 10)
    placed = check_live(text, Config()).placement
    assert placed is not None
    assert placed.height_px == pytest.approx(live.placement.height_px / 2)
    write_keys(settings, "Cam", {"focal_px": 500.0, "width_px": 640})
    assert with_measured_focal(Config(), "Cam").camera.focal_px == 500


def test_placement_needs_two_cameras_that_see_something(tmp_path: Path, settings: Path) -> None:
    grey = np.full((96, 256, 3), 90, np.uint8)
    plain = write_film(tmp_path / "plain.avi", [grey] * 3)
    with pytest.raises(UserError, match="too little"):
        calibrated(f"live:file:{plain}")
    with pytest.raises(UserError, match="not two cameras"):
        calibrated(f"live:file:{plain}?grid=2x4")
    assert not settings.exists()


def test_damaged_placement_is_named(tmp_path: Path, settings: Path) -> None:
    path = write_film(tmp_path / "pair.avi", [np.full((96, 256, 3), 90, np.uint8)] * 3)
    write_keys(settings, f"live:file:{path}", {"rotation_deg": "left"})
    with pytest.raises(UserError) as refused:
        check_live(f"live:file:{path}", Config())
    assert str(settings) in refused.value.message and "calibrate" in refused.value.remedy


def test_cameras_in_a_row_have_one_name_for_their_placement() -> None:
    assert camera_name("row:demo,file:/a") == "demo,file:/a"
