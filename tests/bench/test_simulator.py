"""The simulator: its ground truth is right, and every run gives the same bits."""

from pathlib import Path

import numpy as np
import pytest

from lfpipe.bench.simulator.camera import Camera
from lfpipe.bench.simulator.metrics import Pictures, viewpoint_metrics
from lfpipe.bench.simulator.run import Setup, Truth
from lfpipe.bench.simulator.scene import SCENES, scene_of
from lfpipe.bench.simulator.screen import Screen
from lfpipe.bench.simulator.scripts import recorded
from lfpipe.errors import UserError

SCREEN = Screen(device_latency_ms=0.0)


@pytest.mark.parametrize("name", SCENES)
def test_stored_views_of_a_scene_are_its_exact_pictures(name: str) -> None:
    scene = scene_of(name)
    views = np.asarray(scene.field.views)[0]
    assert scene.field.disparity is not None and scene.field.disparity.std() > 0
    for row, col in ((0, 0), (scene.rows // 2, scene.cols // 2), (scene.rows - 1, scene.cols - 2)):
        exact = scene.picture((row, col))
        pictures = Pictures(Setup(scene=scene, screen=SCREEN))
        key = pictures.key(np.array(((row, col), (row, col)), np.float64))
        errors = pictures.errors([key], np.array([((row, col), (row, col))], np.float64))
        assert errors.levels.max() < 9, "a shift to the zero plane resamples the stored view"
        if not scene.zero_px:
            np.testing.assert_array_equal(views[row, col].transpose(1, 2, 0)[..., ::-1], exact)


def test_recorded_tracks_are_scripts(tmp_path: Path) -> None:
    t_s = np.arange(120) / 30
    x = 400 + 60 * np.sin(t_s)
    rows = [f"{t:.4f},1,{u + 50:.2f},300,{u - 50:.2f},300" for t, u in zip(t_s, x, strict=True)]
    table = tmp_path / "track.csv"
    head = "t_s,face,left_x,left_y,right_x,right_y"
    table.write_text("\n".join((head, *rows)) + "\n")
    (script,) = recorded([table])
    places = script.people[0].path_px
    assert np.median(places[:, 2]) == pytest.approx(60, abs=0.1)
    assert np.ptp(places[:, 0]) == pytest.approx(0.6 * np.ptp(x), rel=0.02)
    setup = Setup(screen=SCREEN, camera=Camera(noise_px=0.0))
    metrics = viewpoint_metrics(setup.watch(script), Truth(setup, script), script)
    assert metrics["error_views"] < 0.3
    gone = [f"{t:.4f},0,,,," for t in t_s[40:50]]
    table.write_text("\n".join((head, *rows[:40], *gone, *rows[50:])) + "\n")
    (script,) = recorded([table])
    hidden = script.people[0].logit < 0
    assert hidden[1400:1600].all() and hidden.sum() == pytest.approx(333, abs=2)
    for wrong in ("1,2", "1,1,2,3,4,", "x,1,2,3,4,5", ""):
        table.write_text(f"{head}\n{wrong}\n")
        with pytest.raises(UserError, match="not a head track"):
            list(recorded([table]))
