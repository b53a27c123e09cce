"""Subject: views between and beyond the stored ones. Error on held-out views, continuity, time per picture."""

import itertools
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.inputs import Inputs
from lfpipe.bench.results import Figures, rms
from lfpipe.bench.runner import Candidate, Offer, Turn, time_ms
from lfpipe.config import Render
from lfpipe.config.quality import METHODS, WARPS
from lfpipe.render.compositor import Compositor
from lfpipe.render.scoring import psnr_db
from lfpipe.render.synthesis import Synthesiser
from lfpipe.render.viewpoint import Position
from lfpipe.scene.disparity import estimate_disparity, quantised, scale_for
from lfpipe.scene.lightfield import LightField

SWEEP_STEP, MAX_VIEWS = (
    0.05,
    (10, 40),
)  # views between two pictures of a sweep; left-out views, quick and full
TURN_PICTURES, APART = 15, 23  # pictures per turn, and steps of the walk between two of them


def subsample(field: LightField, rows: Sequence[int], cols: Sequence[int]) -> LightField:
    """The views of the first frame at rows x cols, with disparities estimated from these views alone if field has disparities.

    rows, cols: evenly spaced, with the same step on both axes. Raises ValueError if no disparity can be estimated.
    """
    step = next((indices[1] - indices[0] for indices in (cols, rows) if len(indices) > 1), 1)
    kept_field = attrs.evolve(
        field,
        views=np.ascontiguousarray(np.asarray(field.views)[:1, rows][:, :, cols]),
        offsets=np.ascontiguousarray(field.offsets[rows][:, cols]) / np.float32(step),
        present=np.ones((len(rows), len(cols)), bool),
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


class ViewRenderer:
    """Renders whole views of a field with one method."""

    def __init__(self, field: LightField, method: str) -> None:
        views = np.asarray(field.views)
        self._synthesiser = Synthesiser(field, method)
        self._planes = [
            lambda frame, r, c, k=k: views[frame, r, c, k] for k in range(field.channels)
        ]
        self._outs = [
            np.empty((field.height_px, field.width_px), np.uint8) for _ in range(field.channels)
        ]

    def at(self, position: Position) -> NDArray[np.float32]:
        """The view at position (row, col), float32 (channels, height, width)."""
        return np.stack(self.draw(position)).astype(np.float32)

    def draw(self, position: Position) -> list[NDArray[np.uint8]]:
        """The planes of the view at position, uint8 (height, width) each, valid until the next call."""
        return self._synthesiser.render(position, 0, 0.0, self._planes, self._outs)


def viewpoint_walk(field: LightField, count: int, apart: int) -> list[tuple[Position, Position]]:
    """Viewpoints of the left and right eye, 1.4 views apart, drifting among the middle 3x3 views of the grid. apart: steps of the
    walk between two of them."""
    t = np.arange(0, count * apart, apart) * 0.013
    rows, cols = (
        (field.rows - 1) / 2 + 0.8 * np.sin(1.7 * t),
        (field.cols - 1) / 2 + 0.3 * np.sin(t),
    )
    return [
        ((float(row), float(col - 0.7)), (float(row), float(col + 0.7)))
        for row, col in zip(rows, cols, strict=True)
    ]


def measure(inputs: Inputs) -> Iterator[Offer]:
    """Every method, from every 2nd view."""
    field = inputs.field
    if 2 in field.views.shape[1:3] or max(field.rows, field.cols) < 3:
        yield f"error on left-out views: a grid of {field.rows}x{field.cols} has no view to leave out"
        return
    methods = [
        method for method in reversed(METHODS) if field.disparity is not None or method not in WARPS
    ]
    if len(methods) < len(METHODS):
        yield "warped views: the scene has no disparity"
    if min(field.rows, field.cols) == 1:
        yield "viewpoints off the line: one line of views: all left-out views lie on it"
    kept = cache(
        partial(subsample, field, range(0, field.rows, 2), range(0, field.cols, 2))
    )  # shared
    for method in methods:
        prepare = partial(_prepare, inputs, method, kept)
        yield Candidate(
            method, "every 2nd view", prepare, method == "nearest", method == field.method
        )


def _prepare(
    inputs: Inputs, method: str, kept_views: Callable[[], LightField]
) -> tuple[Figures, Turn]:
    field, kept_field = inputs.field, kept_views()
    views, renderer = np.asarray(field.views)[0], ViewRenderer(kept_field, method)
    compositor = Compositor(kept_field, Render(method=method, anaglyph="colour"))  # type: ignore[arg-type]
    viewpoints = viewpoint_walk(kept_field, TURN_PICTURES, APART)
    between = np.ndindex(2 * kept_field.rows - 1, 2 * kept_field.cols - 1)
    left_out = [(r, c) for r, c in between if (r % 2 or c % 2) and field.present[r, c]]
    count = min(MAX_VIEWS[0 if inputs.quick else 1], len(left_out))  # spread evenly
    some = [left_out[int(k)] for k in np.unique(np.linspace(0, len(left_out) - 1, count).round())]
    squares = [float(np.mean((renderer.at((r / 2, c / 2)) - views[r, c]) ** 2)) for r, c in some]
    psnrs_db = [psnr_db(square) for square in squares]
    figures = {
        "rmse": rms(np.sqrt(squares)),
        "psnr_db": float(np.mean(psnrs_db)),
        "jump": _jump(kept_field, renderer),
    }
    upcoming = itertools.cycle(viewpoints)  # equal in every turn: some viewpoints need two warps
    turn = partial(time_ms, lambda: compositor.compose(*next(upcoming)), TURN_PICTURES)
    return figures, lambda: {"time_ms": turn()}


def _jump(kept_field: LightField, renderer: ViewRenderer) -> float:
    """Largest over mean difference between pictures SWEEP_STEP views apart, over two steps of the grid: 1 is even motion,
    1 / SWEEP_STEP is a jump from view to view."""
    along = kept_field.cols > 1
    count, across = (
        (kept_field.cols, (kept_field.rows - 1) / 2)
        if along
        else (kept_field.rows, (kept_field.cols - 1) / 2)
    )
    start = (count - 1) / 2 - min(1.0, (count - 1) / 2)
    sweep = np.arange(start, start + min(2.0, count - 1) + 1e-9, SWEEP_STEP)
    pictures = (renderer.at((across, float(t)) if along else (float(t), across)) for t in sweep)
    steps = [float(np.abs(b - a).mean()) for a, b in itertools.pairwise(pictures)]
    return max(steps) / max(float(np.mean(steps)), 1e-9)
