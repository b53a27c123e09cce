"""CPU time of drawing by each method, measured on a scene's own views."""

import math
import time
from collections.abc import Mapping
from typing import cast

import attrs

from lfpipe.config import Render
from lfpipe.config.quality import METHODS, WARPS
from lfpipe.config.tree import Method
from lfpipe.files.decoding import fit_area
from lfpipe.render.synthesis.compositor import Compositor
from lfpipe.render.synthesis.painter import Painters
from lfpipe.scene.lightfield import LightField

# (width, height) of the measured pictures, at most: a few ms each; time grows with the pixels
MEASURED_PX = (480, 480)
# columns of both eyes in views; the first two pictures build what all need
COLUMNS = ((0.1, 0.9), (0.4, 0.6), (0.2, 0.7), (0.3, 0.8), (0.1, 0.6))
BUILT = 2


def measure_costs(
    field: LightField, render: Render, gpu: Painters | None = None
) -> Mapping[str, float]:
    """CPU time of the calling thread for each drawn pixel by method, ns: the least of a few
    pictures between the middle views. What a GPU draws takes it little time.
    """
    own_px = field.width_px, field.height_px
    _, _, *fitting = fit_area(own_px, MEASURED_PX)
    size_px = min(own_px[0], fitting[0]), min(own_px[1], fitting[1])
    row, col = (field.rows - 1) / 2, float(max(field.cols // 2 - 1, 0))
    costs = {}
    for method in METHODS:
        if method in WARPS and field.disparity is None:
            continue
        compositor = Compositor(
            field, attrs.evolve(render, method=cast(Method, method)), size_px=size_px, gpu=gpu
        )
        spent_ns = []
        for left, right in COLUMNS:
            start_ns = time.thread_time_ns()
            compositor.compose((row, col + left), (row, col + right))
            spent_ns.append(time.thread_time_ns() - start_ns)
        costs[method] = min(spent_ns[BUILT:]) / math.prod(size_px)
    return costs
