"""Small inputs: a textured wall as a light field, a sequence of the demo's face."""

import itertools
from functools import partial
from pathlib import Path

import numpy as np

from lfpipe.bench.inputs import FrameSequence, Inputs
from lfpipe.scene.lightfield import LightField, Manifest
from lfpipe.scene.source import Geometry
from tests.scene import made


def wall(rows: int, cols: int, side_px: int = 64, disparity: bool = True) -> LightField:
    """A textured wall, 2 px of disparity per view."""
    views = np.ascontiguousarray(
        made.wall(rows, cols, side_px, side_px).transpose(0, 1, 4, 2, 3)[None]
    )
    maps = np.full((1, rows, cols, side_px // 2, side_px // 2), 32, np.int8)
    return LightField(
        views=views,
        disparity=maps if disparity else None,
        disparity_scale_px=1 / 16,
        disparity_min_px=2.0 * disparity,
        disparity_max_px=2.0 * disparity,
        disparity_source="truth" if disparity else "none",
        offsets=np.zeros((rows, cols, 2), np.float32),
        present=np.ones((rows, cols), bool),
        geometry=Geometry(),
        frame_rate_hz=0.0,
        name="wall",
        method="warp2" if disparity else "nearest",
        manifest=Manifest(key=f"wall{rows}x{cols}"),
    )


def inputs(field: LightField, work: Path, sequence: FrameSequence | None = None) -> Inputs:
    """Quick inputs; without a sequence, 20 grey frames without truth."""
    frames = partial(itertools.repeat, np.full((120, 160, 3), 90, np.uint8), 20)
    grey = FrameSequence(
        path=work / "grey.avi",
        frames=frames,
        count=20,
        size_px=(160, 120),
        rate_hz=30.0,
        truth=None,
    )
    given = Inputs(quick=True)
    given.scene = work / "wall"
    given.field = field
    given.sequence = sequence or grey
    given.work = work
    return given
