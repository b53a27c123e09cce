"""Scores of the rendering methods: every second view is held out, predicted from the others, and
compared. `scene.classification` interprets the scores.
"""

import math

import attrs
import numpy as np

from lfpipe.config.quality import METHODS, WARPS, may_fade
from lfpipe.host.machine import add
from lfpipe.render.synthesis.engine import Synthesiser
from lfpipe.render.synthesis.scene_views import SceneViews
from lfpipe.scene.lightfield import LightField


def psnr_db(mean_square: float) -> float:
    """Peak signal-to-noise ratio of 8-bit pictures; 100 dB means no difference."""
    return min(100.0, 10 * math.log10(255.0**2 / max(mean_square, 1e-10)))


def thinned(field: LightField) -> LightField:
    """Every second view along either axis as a light field: disparities grow with the spacing.
    Copies nothing.
    """
    every = np.s_[::2, ::2]
    return attrs.evolve(
        field,
        views=field.views[:, *every],
        disparity=None if field.disparity is None else field.disparity[:, *every],
        offsets=field.offsets[every] / np.float32(2),
        present=field.present[every],
        disparity_scale_px=field.disparity_scale_px * 2,
        disparity_min_px=field.disparity_min_px * 2,
        disparity_max_px=field.disparity_max_px * 2,
    )


def left_out(field: LightField, count: int) -> list[tuple[int, int]]:
    """Up to count (row, col) of present views that `thinned` omits, evenly distributed between
    those that it keeps; of two rows or columns, the first.
    """
    inside = [
        (r, c)
        for r in range((field.rows - 1) // 2 * 2 + 1)
        for c in range((field.cols - 1) // 2 * 2 + 1)
        if (r % 2 or c % 2) and field.present[r, c]
    ]
    # a stride coprime to the pattern of the grid selects views
    # between two and between four others equally often
    count = min(count, len(inside))
    chosen = np.unique(np.linspace(0, len(inside) - 1, count).round().astype(int))
    return [inside[int(k)] for k in chosen]


def score(field: LightField, method: str, places: list[tuple[int, int]]) -> float:
    """Mean PSNR in dB of the held-out views of field, each made by method from its `thinned`
    neighbours (green plane).
    """
    kept = thinned(field)
    channel = min(1, field.channels - 1)
    synthesiser = Synthesiser(SceneViews(kept), method)
    views = np.asarray(kept.views)
    out = [np.empty((field.height_px, field.width_px), np.uint8)]
    levels_db = []
    for row, col in places:
        (plane,) = synthesiser.render(
            (row / 2, col / 2), 0, 0.0, [lambda frame, r, c: views[frame, r, c, channel]], out
        )
        error = plane.astype(np.float32) - np.asarray(field.views[0, row, col, channel], np.float32)
        levels_db.append(psnr_db(float(np.mean(error**2))))
    return add(levels_db) / len(levels_db)


def scores(field: LightField, count: int = 7) -> dict[str, float]:
    """{method: PSNR in dB} of about count held-out views, without methods that are never used for
    this scene; empty for a grid too small to hold out a view.
    """
    places = left_out(field, count)
    fades = may_fade(field.disparity_min_px, field.disparity_max_px)
    methods = [
        name
        for name in reversed(METHODS)
        if (fades or name != "blend") and (field.disparity is not None or name not in WARPS)
    ]
    return {method: score(field, method, places) for method in methods} if places else {}
