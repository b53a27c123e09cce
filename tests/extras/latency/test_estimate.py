"""The delay of the loop, from simulated cameras and screens.

Many more: `python -m profiling.photon`.
"""

import attrs
import numpy as np
import pytest

from lfpipe.extras.latency.estimate import LoopDelay, estimate
from profiling.photon import bad_recordings, outcome
from profiling.simulated_recordings import Loop, drawn, recording


@pytest.mark.parametrize("seed", range(1))
def test_estimate_holds_the_delay_in_its_interval(seed: int) -> None:
    loop = drawn(np.random.default_rng(seed), seed)
    found = estimate(recording(loop))
    assert (
        abs(found.delay_ms - loop.delay_ms) < 1 and found.low_ms <= loop.delay_ms <= found.high_ms
    )


@pytest.mark.nightly
def test_estimate_refuses_bad_recordings() -> None:
    for what, word, made in bad_recordings(duration_s=8.0):
        answer = outcome(made)
        assert not isinstance(answer, LoopDelay) and word in answer, f"{what}: {answer}"


def test_estimate_takes_recordings_with_lost_frames() -> None:
    loop = Loop(camera_hz=59.7, exposure_ms=8.0, duration_s=8.0)
    made = recording(loop)
    rng = np.random.default_rng(3)
    kept = rng.random(len(made.t_frame_ns)) > 0.6  # most steps are of two or three frames
    t_flip_ns = made.t_flip_ns.copy()
    t_flip_ns[20] = t_flip_ns[21]  # the compositor stood still: the level before was never seen
    found = estimate(
        attrs.evolve(
            made,
            t_frame_ns=made.t_frame_ns[kept],
            pictures=made.pictures[kept],
            t_flip_ns=t_flip_ns,
        )
    )
    assert found.low_ms - 1 < loop.delay_ms < found.high_ms + 1
