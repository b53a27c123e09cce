"""The simulator: its ground truth is right, and every run gives the same bits."""

import numpy as np
import pytest

from lfpipe.bench.simulator.metrics import Pictures
from lfpipe.bench.simulator.run import Screen, Setup
from lfpipe.bench.simulator.scene import SCENES, scene_of

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
