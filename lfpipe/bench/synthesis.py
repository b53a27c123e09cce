"""Subject: views between and beyond the stored ones. Error on held-out views, continuity, time per
picture.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.inputs import Inputs
from lfpipe.bench.results import Value, mean_of, rms_of
from lfpipe.bench.runner import Candidate, Offer, Turn, cpu_ms
from lfpipe.config import Render
from lfpipe.config.quality import METHODS, WARPS
from lfpipe.render.compositor import Compositor, ViewRenderer
from lfpipe.render.scoring import psnr_db
from lfpipe.render.viewpoint import Position
from lfpipe.scene.disparity import estimate_disparity, quantised, scale_for
from lfpipe.scene.lightfield import LightField

# views between two pictures of a sweep; left-out views, quick and full
SWEEP_STEP = 0.05
MAX_VIEWS = (10, 40)


def subsample(field: LightField, rows: Sequence[int], cols: Sequence[int]) -> LightField:
    """The views of the first frame at rows x cols, with disparities estimated from these views
    alone if field has disparities.

    rows, cols: evenly spaced, with the same step on both axes. Raises ValueError if no disparity
    can be estimated.
    """
    step = next((indices[1] - indices[0] for indices in (cols, rows) if len(indices) > 1), 1)
    kept_field = attrs.evolve(
        field,
        views=np.ascontiguousarray(np.asarray(field.views)[:1, rows][:, :, cols]),
        offsets=np.ascontiguousarray(field.offsets[rows][:, cols]) / np.float32(step),
        present=np.ones((len(rows), len(cols)), bool),
        # scores are of all views: by them, a cross-fade would be drawn in place of a warp
        manifest={**field.manifest, "scores": {}},
    )
    if field.disparity is None:
        return kept_field
    maps = estimate_disparity(kept_field.views[0])
    if maps is None:
        raise ValueError("no disparity can be estimated: one view, or the views are too small")
    known = maps[~np.isnan(maps)] if not np.isnan(maps).all() else np.zeros(1, np.float32)
    low, high = (float(v) for v in np.percentile(known, (0.05, 99.95)))
    scale = scale_for(low, high)
    return attrs.evolve(
        kept_field,
        disparity=quantised(maps, scale)[None],
        disparity_scale_px=scale,
        disparity_min_px=low,
        disparity_max_px=high,
    )


def view_at(renderer: ViewRenderer, position: Position) -> NDArray[np.float32]:
    """The view at position (row, col), float32 (channels, height, width)."""
    return np.stack(renderer.planes(*position)).astype(np.float32)


def measure(inputs: Inputs) -> Iterator[Offer]:
    """Every method, from every 2nd view."""
    field = inputs.field
    if 2 in field.views.shape[1:3] or max(field.rows, field.cols) < 3:
        yield (
            f"error on left-out views: a grid of {field.rows}x{field.cols} has no view to leave out"
        )
        return
    methods = [
        method for method in reversed(METHODS) if field.disparity is not None or method not in WARPS
    ]
    if len(methods) < len(METHODS):
        yield "warped views: the scene has no disparity"
    if min(field.rows, field.cols) == 1:
        yield "viewpoints off the line: one line of views: all left-out views lie on it"
    # shared
    kept = cache(partial(subsample, field, range(0, field.rows, 2), range(0, field.cols, 2)))
    for method in methods:
        prepare = partial(_prepare, inputs, method, kept)
        yield Candidate(
            curve=method,
            knob="every 2nd view",
            prepare=prepare,
            paper=method == "nearest",
            used=method == field.method,
        )


def _prepare(
    inputs: Inputs, method: str, kept_views: Callable[[], LightField]
) -> tuple[dict[str, float | Value], Turn]:
    field = inputs.field
    kept_field = kept_views()
    views = np.asarray(field.views)[0]
    renderer = ViewRenderer(kept_field, method)
    compositor = Compositor(kept_field, Render(method=method))  # type: ignore[arg-type]
    between = np.ndindex(2 * kept_field.rows - 1, 2 * kept_field.cols - 1)
    left_out = [(r, c) for r, c in between if (r % 2 or c % 2) and field.present[r, c]]
    count = min(MAX_VIEWS[0 if inputs.quick else 1], len(left_out))  # spread evenly
    places = np.unique(np.linspace(0, len(left_out) - 1, count).round()).astype(int)
    sample = [left_out[k] for k in places.tolist()]
    squares = [
        float(np.mean((view_at(renderer, (r / 2, c / 2)) - views[r, c]) ** 2)) for r, c in sample
    ]
    figures: dict[str, float | Value] = {
        "rmse": rms_of(np.sqrt(squares).tolist()),
        "psnr_db": mean_of([psnr_db(square) for square in squares]),
        "jump": _jump(kept_field, renderer),
    }
    upcoming = itertools.cycle((r / 2, c / 2) for r, c in sample)  # where the error is measured

    def picture() -> None:
        place = next(upcoming)
        compositor.compose(place, place)

    return figures, lambda: {"cpu_ms": cpu_ms(picture, len(sample))}


def _jump(kept_field: LightField, renderer: ViewRenderer) -> float:
    """Largest over mean difference between pictures SWEEP_STEP views apart, over two steps of the
    grid: 1 is even motion, 1 / SWEEP_STEP is a jump from view to view.
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
