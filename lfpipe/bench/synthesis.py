"""Benchmark: synthesis of views between the stored ones: error on held-out views, continuity, and
time per picture.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.inputs import Inputs
from lfpipe.bench.results import Value, mean_of
from lfpipe.bench.runner import Offer, Prepared, Variant, cpu_ms
from lfpipe.config import Render
from lfpipe.config.quality import METHODS, SIZES, WARPS
from lfpipe.render.plan import psnr_db
from lfpipe.render.synthesis.compositor import Compositor, ViewRenderer
from lfpipe.render.synthesis.viewpoint import Position
from lfpipe.scene.disparity import estimate_disparity, quantised, scale_for
from lfpipe.scene.lightfield import LightField

# views between two pictures of a sweep; held-out views, quick and full
SWEEP_STEP = 0.05
MAX_VIEWS = (10, 40)


def subsample(field: LightField, rows: Sequence[int], cols: Sequence[int]) -> LightField:
    """The views of the first frame at rows x cols, with disparities estimated from these views
    alone if field has disparities.

    rows, cols: evenly spaced, with the same step on both axes. Raises ValueError if no disparity
    can be estimated.
    """
    step = _step(rows, cols)
    kept_field = attrs.evolve(
        field,
        views=np.ascontiguousarray(np.asarray(field.views)[:1, rows][:, :, cols]),
        offsets=np.ascontiguousarray(field.offsets[rows][:, cols]) / np.float32(step),
        present=np.ones((len(rows), len(cols)), bool),
        # scores refer to all views: with them, a cross-fade would replace a warp
        manifest=attrs.evolve(field.manifest, scores={}),
    )
    if field.disparity is None:
        return kept_field
    maps = estimate_disparity(kept_field.views[0])
    if maps is None:
        raise ValueError("no disparity can be estimated: one view, or the views are too small")
    valid = maps[~np.isnan(maps)] if not np.isnan(maps).all() else np.zeros(1, np.float32)
    low, high = (float(v) for v in np.percentile(valid, (0.05, 99.95)))
    scale = scale_for(low, high)
    return attrs.evolve(
        kept_field,
        disparity=quantised(maps, scale)[None],
        disparity_scale_px=scale,
        disparity_min_px=low,
        disparity_max_px=high,
    )


def _step(rows: Sequence[int], cols: Sequence[int]) -> int:
    """The step between kept views: the same on both axes, because disparity is per grid step."""
    return next((axis[1] - axis[0] for axis in (cols, rows) if len(axis) > 1), 1)


def left_out(
    field: LightField, rows: Sequence[int], cols: Sequence[int]
) -> dict[Position, NDArray[np.uint8]]:
    """The views between those of `subsample`, by their positions in its grid."""
    step = _step(rows, cols)
    return {
        ((r - rows[0]) / step, (c - cols[0]) / step): np.asarray(field.views[0, r, c])
        for r, c in itertools.product(range(rows[0], rows[-1] + 1), range(cols[0], cols[-1] + 1))
        if (r not in rows or c not in cols) and field.present[r, c]
    }


def view_at(renderer: ViewRenderer, position: Position) -> NDArray[np.float32]:
    """The view at position (row, col), float32 (channels, height, width)."""
    return np.stack(renderer.planes(*position)).astype(np.float32)


def measure(inputs: Inputs) -> Iterator[Offer]:
    """Every method and size of the levels of quality, from every 2nd view."""
    field = inputs.field
    if 2 in field.views.shape[1:3] or max(field.rows, field.cols) < 3:
        yield (
            f"error on held-out views: a grid of {field.rows}x{field.cols} has no view to hold out"
        )
        return
    methods = [
        method for method in reversed(METHODS) if field.disparity is not None or method not in WARPS
    ]
    if len(methods) < len(METHODS):
        yield "warped views: the scene has no disparity"
    if min(field.rows, field.cols) == 1:
        yield "viewpoints off the line: one line of views contains all held-out views"
    every_2nd = range(0, field.rows, 2), range(0, field.cols, 2)
    subsampled = cache(partial(subsample, field, *every_2nd))  # shared
    between = list(left_out(field, *every_2nd).items())
    count = min(MAX_VIEWS[0 if inputs.quick else 1], len(between))  # spread evenly
    places = np.unique(np.linspace(0, len(between) - 1, count).round()).astype(int)
    truth = dict(between[place] for place in places)
    for method, size in itertools.product(methods, SIZES):
        full = size == SIZES[0]
        yield Variant(
            curve=method,
            parameter="every 2nd view" + ("" if full else f", {size:.0%} of the width"),
            prepare=partial(_prepare, subsampled, method, size, truth),
            paper=full and method == "nearest",
            used=full and method == field.method,
        )


def _prepare(
    kept_views: Callable[[], LightField],
    method: str,
    size: float,
    truth: dict[Position, NDArray[np.uint8]],
) -> Prepared:
    kept_field = kept_views()
    own_px = kept_field.width_px, kept_field.height_px
    size_px = max(1, round(own_px[0] * size)), max(1, round(own_px[1] * size))
    renderer = ViewRenderer(kept_field, method, size_px=size_px)
    how = Render(method=method)  # type: ignore[arg-type]
    compositor = Compositor(kept_field, how, size_px=size_px)
    squares = [
        float(np.mean((scaled_up(view_at(renderer, place), own_px) - view) ** 2))
        for place, view in truth.items()
    ]
    metrics = {
        "rmse": mean_of(np.sqrt(squares).tolist(), power=2),
        "psnr_db": mean_of([psnr_db(square) for square in squares]),
        "jump": Value(_jump(kept_field, renderer)),
    }
    places = itertools.cycle((place, place) for place in truth)  # positions of the held-out views
    picture = partial(cpu_ms, lambda: compositor.compose(*next(places)), len(truth))
    return metrics, lambda: {"cpu_ms": picture()}


def scaled_up(view: NDArray[np.float32], size_px: tuple[int, int]) -> NDArray[np.float32]:
    """A view, (channels, height, width), at size_px (width, height), as on a screen."""
    if view.shape[:0:-1] == size_px:
        return view
    return np.stack([cv2.resize(plane, size_px, interpolation=cv2.INTER_CUBIC) for plane in view])


def _jump(kept_field: LightField, renderer: ViewRenderer) -> float:
    """Largest over mean difference between pictures SWEEP_STEP views apart, over two grid steps: 1
    means even motion, 1 / SWEEP_STEP a jump from view to view.
    """
    along = kept_field.cols > 1
    count, across = (
        (kept_field.cols, (kept_field.rows - 1) / 2)
        if along
        else (kept_field.rows, (kept_field.cols - 1) / 2)
    )
    start = (count - 1) / 2 - min(1.0, (count - 1) / 2)
    sweep = np.arange(start, start + min(2.0, count - 1) + 1e-9, SWEEP_STEP)
    pictures = (
        view_at(renderer, (across, float(t)) if along else (float(t), across)) for t in sweep
    )
    steps = [float(np.abs(b - a).mean()) for a, b in itertools.pairwise(pictures)]
    return max(steps) / max(float(np.mean(steps)), 1e-9)
