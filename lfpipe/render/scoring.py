"""The best method for a scene: every second view is held out, predicted from the others, and compared."""

import math

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.config.quality import WARPS, may_fade
from lfpipe.host.machine import add
from lfpipe.render.synthesis import Synthesiser
from lfpipe.render.viewpoint import Position
from lfpipe.scene.lightfield import LightField

METHODS = ("nearest", "blend", "warp", "warp2")  # cheapest first
WORTH_DB = 0.25  # minimum gain of a costlier method: a smaller one is invisible
FLAT_PX = 0.5  # px per view: with less disparity a cross-fade shows no double edges


def psnr_db(mean_square: float) -> float:
    """Peak signal-to-noise ratio of 8-bit pictures; 100 dB stands for no difference at all."""
    return min(100.0, 10 * math.log10(255.0**2 / max(mean_square, 1e-10)))


def thinned(field: LightField, step: int = 2) -> LightField:
    """Every step-th view of the grid as a light field: disparities grow with the spacing. Copies nothing."""
    return attrs.evolve(
        field,
        views=field.views[:, ::step, ::step],
        disparity=None if field.disparity is None else field.disparity[:, ::step, ::step],
        disparity_scale_px=field.disparity_scale_px * step,
        disparity_min_px=field.disparity_min_px * step,
        disparity_max_px=field.disparity_max_px * step,
        offsets=field.offsets[::step, ::step] / np.float32(step),
        present=field.present[::step, ::step],
    )


def _line(field: LightField) -> LightField:
    """The field itself, or a single row or column if the other axis has fewer than three views."""
    if field.rows >= 3 and field.cols >= 3:
        return field
    part = (slice(0, 1), slice(None)) if field.cols >= 3 else (slice(None), slice(0, 1))
    return attrs.evolve(
        field,
        views=field.views[:, *part],
        disparity=None if field.disparity is None else field.disparity[:, *part],
        offsets=field.offsets[part],
        present=field.present[part],
    )


def left_out(field: LightField, count: int) -> list[tuple[int, int]]:
    """Up to count (row, col) of present views that `thinned` leaves out, between those that it keeps, well spread."""
    inside = [
        (r, c)
        for r in range((field.rows - 1) // 2 * 2 + 1)
        for c in range((field.cols - 1) // 2 * 2 + 1)
        if (r % 2 or c % 2) and field.present[r, c]
    ]
    # a stride coprime to the pattern of the grid selects views between two and between four others equally often
    chosen = np.unique(np.linspace(0, len(inside) - 1, count).round().astype(int)) if len(inside) > count else range(len(inside))
    return [inside[int(k)] for k in chosen]


def _wrong(field: LightField, made: NDArray[np.uint8], place: tuple[int, int], channel: int) -> float:
    truth = np.asarray(field.views[0, place[0], place[1], channel], np.float32)
    return float(np.mean((made.astype(np.float32) - truth) ** 2))


def score(field: LightField, method: str, places: list[tuple[int, int]]) -> float:
    """Mean PSNR in dB of the held-out views of field, each made by method from its `thinned` neighbours (green plane)."""
    kept = thinned(field)
    synthesiser = Synthesiser(kept, method)
    out = [np.empty((field.height_px, field.width_px), np.uint8)]
    channel = min(1, field.channels - 1)
    views = np.asarray(kept.views)
    found = []
    for place in places:
        position: Position = (place[0] / 2, place[1] / 2)
        made = synthesiser.render(position, 0, 0.0, [lambda r, c: views[0, r, c, channel]], out)
        found.append(psnr_db(_wrong(field, made[0], place, channel)))
    return add(found) / len(found)


def choose_method(field: LightField, count: int = 7) -> tuple[str, dict[str, float]]:
    """(method that `auto` stands for, {method: dB}) from a hold-out test on about count views.

    The cheapest method that no costlier one beats by WORTH_DB. A grid too small to hold out a view has no scores; then
    disparities decide.
    """
    fades = may_fade(field.disparity_min_px, field.disparity_max_px)
    methods = [name for name in METHODS if (fades or name != "blend") and (field.disparity is not None or name not in WARPS)]
    line = _line(field) if max(field.rows, field.cols) >= 3 else field
    places = left_out(line, count)
    if not places:
        if max(field.rows, field.cols) == 1:
            return "nearest", {}
        extent_px = max(abs(field.disparity_min_px), abs(field.disparity_max_px))
        return ("warp2" if field.disparity is not None and extent_px >= FLAT_PX else "blend" if fades else "nearest"), {}
    scores = {method: score(line, method, places) for method in methods}
    best = max(scores.values())
    return next(method for method in methods if scores[method] >= best - WORTH_DB), scores
