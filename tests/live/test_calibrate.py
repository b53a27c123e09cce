"""`lfpipe calibrate live:...`: how the second camera stands, measured, stored, and used."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from lfpipe.capture.open_source import check_live
from lfpipe.cli import cli
from lfpipe.config import Config
from lfpipe.config.check import camera_file, with_measured_focal, write_keys
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
