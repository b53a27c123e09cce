"""Subject: views between and beyond the stored ones. Error on held-out views, continuity, time per picture."""

import itertools
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.inputs import Inputs
from lfpipe.bench.runner import Candidate, Offer, Samples, Turn, time_figures, times_ms
from lfpipe.config import Render
from lfpipe.config.quality import METHODS, WARPS
from lfpipe.render.compositor import Compositor
from lfpipe.render.scoring import psnr_db
from lfpipe.render.synthesis import Synthesiser
from lfpipe.render.viewpoint import Position
from lfpipe.scene.disparity import estimate_disparity, quantised, scale_for
from lfpipe.scene.lightfield import LightField

STRIDES = {2: "every 2nd view", 4: "every 4th view"}
SWEEP_STEP, MAX_VIEWS = 0.05, (10, 40)
TURN_PICTURES, APART = 15, 23  # pictures per turn, and steps of the walk between two of them


def subsample(field: LightField, rows: Sequence[int], cols: Sequence[int]) -> LightField:
    """The views of the first frame at rows x cols, with disparities estimated from these views alone if field has disparities.

    rows, cols: evenly spaced, with the same step on both axes. Raises ValueError if no disparity can be estimated.
    """
    step = next((indices[1] - indices[0] for indices in (cols, rows) if len(indices) > 1), 1)
    part = attrs.evolve(
        field,
        views=np.ascontiguousarray(np.asarray(field.views)[:1, rows][:, :, cols]),
        offsets=np.ascontiguousarray(field.offsets[rows][:, cols]) / np.float32(step),
        present=np.ones((len(rows), len(cols)), bool),
    )
    if field.disparity is None:
        return part
    maps = estimate_disparity(part.views[0])
    if maps is None:
        raise ValueError("no disparity can be estimated: one view, or the views are too small")
    known = maps[~np.isnan(maps)] if not np.isnan(maps).all() else np.zeros(1, np.float32)
    low, high = (float(v) for v in np.percentile(known, (0.05, 99.95)))
    scale = scale_for(low, high)
    return attrs.evolve(
        part, disparity=quantised(maps, scale)[None], disparity_scale_px=scale, disparity_min_px=low, disparity_max_px=high
    )


class ViewRenderer:
    """Renders whole views of a field with one method."""

    def __init__(self, field: LightField, method: str) -> None:
        views = np.asarray(field.views)
        self._synthesiser = Synthesiser(field, method)
        self._planes = [lambda r, c, k=k: views[0, r, c, k] for k in range(field.channels)]
        self._outs = [np.empty((field.height_px, field.width_px), np.uint8) for _ in range(field.channels)]

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
    rows, cols = (field.rows - 1) / 2 + 0.8 * np.sin(1.7 * t), (field.cols - 1) / 2 + 0.3 * np.sin(t)
    return [((float(row), float(col - 0.7)), (float(row), float(col + 0.7))) for row, col in zip(rows, cols, strict=True)]


def kept_of(count: int, stride: int) -> list[int]:
    """Every stride-th of count indices; the only index if count is 1; [] if none is held out."""
    indices = list(range(0, count, stride))
    return indices if count == 1 or len(indices) > 1 else []


def measure(inputs: Inputs) -> Iterator[Offer]:
    """Methods x stride of the kept views."""
    field = inputs.field
    grid = f"a grid of {field.rows}x{field.cols}"
    if field.rows * field.cols == 1:
        yield "synthesis: one view: there is nothing between"
        return
    strides = [s for s in STRIDES if kept_of(field.rows, s) and kept_of(field.cols, s) and max(field.rows, field.cols) > s]
    if not strides:
        yield f"error on left-out views: {grid} has no view to leave out"
        return
    if len(strides) < len(STRIDES):
        yield f"{STRIDES[4]} kept: {grid} is too small"
    methods = [method for method in reversed(METHODS) if field.disparity is not None or method not in WARPS]
    if len(methods) < len(METHODS):
        yield "warped views: the scene has no disparity"
    if min(field.rows, field.cols) == 1:
        yield "viewpoints off the line: one line of views: all left-out views lie on it"
    kept = {s: cache(partial(subsample, field, kept_of(field.rows, s), kept_of(field.cols, s))) for s in strides}  # shared
    for method, stride in itertools.product(methods, strides):
        paper, used = (method == name and stride == strides[0] for name in ("nearest", field.method))
        yield Candidate(method, STRIDES[stride], partial(_prepare, inputs, method, stride, kept[stride]), paper, used)


def _prepare(inputs: Inputs, method: str, stride: int, kept: Callable[[], LightField]) -> tuple[Samples, Turn]:
    part, views = kept(), np.asarray(inputs.field.views)[0]
    renderer = ViewRenderer(part, method)
    compositor = Compositor(part, Render(method=method, anaglyph="colour"))  # type: ignore[arg-type]
    viewpoints = viewpoint_walk(part, TURN_PICTURES, APART)  # equal in every turn: some viewpoints need two warps
    held_out = _held_out(inputs.field, stride, MAX_VIEWS[0 if inputs.quick else 1])
    squares = [float(np.mean((renderer.at((r / stride, c / stride)) - views[r, c]) ** 2)) for r, c in held_out]
    samples = {"rmse": [s**0.5 for s in squares], "psnr_db": [*map(psnr_db, squares)], "jump": [_jump(part, renderer)]}
    return samples, lambda: time_figures([times_ms(partial(compositor.compose, *eyes), 1)[0] for eyes in viewpoints])


def _held_out(field: LightField, stride: int, count: int) -> list[tuple[int, int]]:
    """Up to count present views between the kept ones, spread evenly."""
    between = itertools.product(*(range(kept_of(n, stride)[-1] + 1) for n in (field.rows, field.cols)))
    inside = [(r, c) for r, c in between if (r % stride or c % stride) and field.present[r, c]]
    indices = np.unique(np.linspace(0, len(inside) - 1, min(count, len(inside))).round().astype(int))
    return [inside[int(k)] for k in indices]


def _jump(part: LightField, renderer: ViewRenderer) -> float:
    """Largest over mean difference between pictures SWEEP_STEP views apart, over two steps of the grid: 1 is even motion,
    1 / SWEEP_STEP is a jump from view to view."""
    along = part.cols > 1
    count, across = (part.cols, (part.rows - 1) / 2) if along else (part.rows, (part.cols - 1) / 2)
    start = (count - 1) / 2 - min(1.0, (count - 1) / 2)
    sweep = np.arange(start, start + min(2.0, count - 1) + 1e-9, SWEEP_STEP)
    pictures = (renderer.at((across, float(t)) if along else (float(t), across)) for t in sweep)
    steps = [float(np.abs(b - a).mean()) for a, b in itertools.pairwise(pictures)]
    return max(steps) / max(float(np.mean(steps)), 1e-9)
