"""Selects the rendering method of a scene by scores of held-out views
(`render.synthesis.scoring`).
"""

from collections.abc import Mapping

import numpy as np

from lfpipe.config.quality import METHODS

WORTH_DB = 0.25  # minimum gain of a costlier method: a smaller one is invisible
WARPED_PX = 0.5  # minimum disparity to warp if no view can be held out
# Minimum share of a pair's disparity that both views confirm: profiling/results/synthesis.md
CONFIRMED = 0.5
BLEND_PX = 2.0  # maximum disparity at which a cross-fade shows hardly any double edges


def best_method(scores: Mapping[str, float], reach_px: float, has_disparity: bool) -> str:
    """The method that `auto` selects for a scene of several views.

    scores: PSNR in dB of held-out views by method. Selects the cheapest method that no costlier
    one beats by WORTH_DB. Without scores, the largest disparity, reach_px, decides.
    """
    if scores:
        enough_db = max(scores.values()) - WORTH_DB
        cheapest_first = reversed(METHODS)
        return next(name for name in cheapest_first if scores.get(name, -np.inf) >= enough_db)
    if has_disparity and reach_px >= WARPED_PX:
        return "warp2"
    return "blend" if reach_px <= BLEND_PX else "nearest"
