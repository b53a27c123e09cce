"""Colours of two cameras: found from what both show, whatever their response."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.live.field import Colours, Estimator, LiveViews, matched
from lfpipe.live.records import UNCHANGED
from tests.live import made
from tests.render import rendered
from tests.support.examples import examples

RNG = np.random.default_rng(1)
SCENE = RNG.integers(20, 200, (4000, 3)).astype(np.float64)


@examples(40)
@given(
    gains=st.tuples(*3 * [st.floats(0.5, 1.2)]), gamma=st.floats(0.75, 1.3), noise=st.floats(0, 3)
)
def test_any_response_is_matched_within_noise(
    gains: tuple[float, ...], gamma: float, noise: float
) -> None:
    taken = 255 * (SCENE / 255) ** gamma * gains
    right = np.clip(taken + RNG.normal(0, noise, taken.shape), 0, 255).astype(np.uint8)
    colours = Colours(2)
    for _ in range(12):
        colours.add(1, SCENE.astype(np.uint8), right)
    off = matched(right[None], colours.curves[1])[0] - SCENE
    assert np.abs(np.median(off, axis=0)).max() <= 2
    np.testing.assert_array_equal(colours.curves[0], UNCHANGED)
    assert (np.diff(colours.curves[1].astype(int), axis=0) >= 0).all(), "no value is reversed"


@pytest.mark.parametrize("gains", [(1, 1, 1), (0.75, 0.75, 0.75), (0.7, 1.0, 0.9)])
def test_a_view_of_a_darker_camera_is_as_bright_as_the_others(gains: tuple[float, ...]) -> None:
    field = rendered.field(1, 2, 96, 128, scale=2.0)
    live = made.source()
    frame = made.frame_of(field)
    frame[:, 128:] = frame[:, 128:] * gains
    estimator, views = Estimator(live, aligns=True), LiveViews(live, "demo")
    for _ in range(8):
        record = estimator.estimate(frame, [((0, 0), (0, 1))])
    shown = views.show(frame, [(0, 0), (0, 1)], record, 0).views[0, 0]
    left, right = (np.asarray(view, float)[:, :, 8:-8].mean(axis=(1, 2)) for view in shown)
    assert np.abs(left - right).max() < 3
