"""`lfpipe calibrate live:SRC`: measures the placement of two cameras by what both see."""

from contextlib import closing

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.capture.open_source import live_camera, open_source
from lfpipe.config import Config, LiveSource, Placement
from lfpipe.errors import UserError
from lfpipe.live.alignment import FAST_FRAMES
from lfpipe.live.estimator import Estimator
from lfpipe.live.records import pairs_in_need

PATIENCE_FRAMES = 600  # before giving up: 20 s at 30 Hz


def placement_of(live: LiveSource, config: Config) -> Placement:
    """How the second one of two cameras stands against the first, by what both see.

    Raises UserError if they see too little.
    """
    estimator = Estimator(attrs.evolve(live, placement=None), aligns=True)
    assert estimator.alignment is not None
    width_px, height_px = live.frame_px
    frame: NDArray[np.uint8] = np.empty((height_px, width_px, 3), np.uint8)
    pair = pairs_in_need(live, [(0.0, 0.5)])
    with closing(open_source(live.source, live_camera(config, live.frame_px))) as source:
        for _ in range(PATIENCE_FRAMES):
            if source.read(frame) is None:
                break
            estimator.estimate(frame, pair)
            if estimator.alignment.frames >= 2 * FAST_FRAMES:
                return estimator.alignment.placement(estimator.swapped)
    raise UserError(
        f"{live.source}: too little is seen in both views",
        "point the cameras at something with texture, in good light",
    )
