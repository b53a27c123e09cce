"""Calibration: the measurement, and the saved settings."""

import json
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.config.check import write_keys
from lfpipe.errors import UserError
from lfpipe.render.ui.pages import (
    MEASURED_FRAMES,
    SPREAD,
    StillEyes,
)
from tests.support.world import World


@pytest.mark.parametrize(
    "before",
    [
        "",
        "[camera]\nfocal_px = 1.0 # mine\nfov_deg = 60\n",
        "# c\n[camera]\nfov_deg = 60\n[render]\nfocal_px = 9\n",
        "camera = { fov_deg = 60 } # one line\n",
    ],
)
def test_write_keys_changes_one_key_alone(before: str, tmp_path: Path) -> None:
    expected = tomllib.loads(before)
    expected.setdefault("camera", {})["focal_px"] = 612.5
    path = tmp_path / "new" / "config.toml"
    write_keys(path, "camera", {"focal_px": 1.5})
    path.write_text(before)
    write_keys(path, "camera", {"focal_px": 612.5})
    assert tomllib.loads(path.read_text()) == expected and len(list(path.parent.iterdir())) == 1
    comments = [
        [line.partition("#")[2] for line in text.splitlines() if "#" in line]
        for text in (before, path.read_text())
    ]
    assert comments[0] == comments[1]
    for damaged in ("camera = 3\n", "[camera\n"):
        path.write_text(damaged)
        with pytest.raises(UserError, match="focal_px not saved"):
            write_keys(path, "camera", {"focal_px": 612.5})
        assert path.read_text() == damaged


@given(
    st.floats(20, 200),
    st.lists(st.floats(-0.4, 0.4), min_size=MEASURED_FRAMES, max_size=MEASURED_FRAMES),
    st.lists(st.integers(0, 3), min_size=MEASURED_FRAMES, max_size=MEASURED_FRAMES),
)
def test_still_eyes_are_measured_whatever_frames_lack_a_face(
    px: float, noise: list[float], gaps: list[int]
) -> None:
    """noise: in shares of the spread that counts as still. gaps: frames without a face."""
    eyes = StillEyes()
    for at, (share, gap) in enumerate(zip(noise, gaps, strict=True)):
        assert eyes.share == pytest.approx(at / MEASURED_FRAMES)
        for _ in range(gap):
            eyes.add(None)
            assert not eyes.has_face
        eyes.add(px * (1 + share * SPREAD))
        assert eyes.has_face
    assert eyes.share == 1.0
    assert eyes.median_px == pytest.approx(px, rel=0.4 * SPREAD)


@given(st.floats(20, 200), st.floats(0.01, 0.2), st.booleans())
def test_moving_eyes_are_not_measured(px: float, step: float, nearer: bool) -> None:
    """step: of a frame, as a share of the distance."""
    eyes = StillEyes()
    for _ in range(2 * MEASURED_FRAMES):
        px *= 1 + step if nearer else 1 / (1 + step)
        eyes.add(px)
        assert eyes.share < 1.0


def test_focal_length_is_that_of_each_camera(world: World, scene: Path, clip: Path) -> None:
    settings = world.root / "settings" / "lfpipe"
    settings.mkdir(parents=True)
    (settings / "cameras.toml").write_text(
        f'[demo]\nfocal_px = 400\nwidth_px = 320\n["file:{clip}"]\nfocal_px = 5\n'
    )
    world.shows(scene, pictures=3)
    # at 640
    assert json.loads(world.ctl("status", "--json"))["config"]["camera"]["focal_px"] == 800
    world.ctl("stop")
    damaged = world.refused(
        "up", scene, "--camera", f"file:{clip}", "--display", "none", "--duration", "1"
    )
    assert "cameras.toml" in damaged and "width_px" in damaged
