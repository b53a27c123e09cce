"""Cameras and calibration: what the kernel's answers mean, what is written, and a whole run on the demo's face."""

from __future__ import annotations

import json
import struct
import tomllib
from pathlib import Path

import numpy as np
import pytest

from lfpipe.capture.v4l2 import ENUM_FRAMEINTERVALS_BYTES, rate_of
from lfpipe.track.calibration import FRAMES, EyeGauge, with_key, write_key
from lfpipe.track.engine import Face
from tests.world import World


@pytest.mark.parametrize(("interval", "rate"), [((1, 30), "30"), ((1001, 30000), "29.97"), ((2, 15), "7.5"), ((0, 1), "?")])
def test_rates_of_a_camera(interval: tuple[int, int], rate: str) -> None:
    reply = bytearray(ENUM_FRAMEINTERVALS_BYTES)
    struct.pack_into("=I4sIII2I", reply, 0, 0, b"MJPG", 640, 480, 1, *interval)
    assert rate_of(bytes(reply)) == rate


@pytest.mark.parametrize(
    "before",
    [
        "",
        "[camera]\n",
        "[camera]\nfocal_px = 1.0 # mine\nfov_deg = 60\n",
        "[render]\nalpha_px = 3\n",
        "# c\n[camera]\nfov_deg = 60\n[render]\nfocal_px = 9\n",
    ],
)
def test_one_key_changes_and_nothing_else(before: str, tmp_path: Path) -> None:
    wanted = tomllib.loads(before)
    wanted.setdefault("camera", {})["focal_px"] = 612.5
    assert tomllib.loads(with_key(before, "camera", "focal_px", 612.5)) == wanted
    path = tmp_path / "new" / "config.toml"
    write_key(path, "camera", "focal_px", 1.5)
    write_key(path, "camera", "focal_px", 612.5)
    assert tomllib.loads(path.read_text()) == {"camera": {"focal_px": 612.5}} and len(list(path.parent.iterdir())) == 1


def test_a_viewer_who_moves_is_no_measure() -> None:
    def face(apart_px: float) -> Face:
        return Face(np.array([[300 + apart_px, 200.0], [300.0, 200.0]]), 1.0, (0.0, 0.0, 1.0, 1.0))

    gauge = EyeGauge()
    assert not gauge.full and not gauge.steady and gauge.median_px == 0
    for k in range(FRAMES):
        gauge.add(face(60 + k % 2 * 0.5))
        gauge.add(None)
    assert gauge.full and gauge.steady and abs(gauge.median_px - 60) <= 0.5
    for k in range(FRAMES):
        gauge.add(face(50 + k))
    assert gauge.full and not gauge.steady


def test_without_a_screen_the_demo_is_measured_and_kept(world: World) -> None:
    done = world.run("calibrate", "--camera", "demo", "--distance", "600")
    assert done.returncode == 0, done.stderr
    written = tomllib.loads((world.root / "settings" / "lfpipe" / "config.toml").read_text())
    assert 300 < written["camera"]["focal_px"] < 1200 and str(written["camera"]["focal_px"]) in done.stdout
    card = world.run("calibrate", "--camera", "demo", "--by", "card")
    assert card.returncode == 2 and "no screen" in card.stderr
    listed = world.run("cameras", "--json")
    assert listed.returncode == 0 and isinstance(json.loads(listed.stdout)["cameras"], list)
