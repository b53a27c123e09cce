"""Subject: views between and beyond the stored ones. Error on held-out views, continuity, time per picture."""

import itertools
from collections.abc import Callable, Iterator
from functools import cache, partial

import numpy as np

from lfpipe.bench.holdout import ViewRenderer, subsample, viewpoint_walk
from lfpipe.bench.inputs import Inputs
from lfpipe.bench.results import Candidate, Chart, Choice, Figure, Prepared, Samples, Skipped, Subject
from lfpipe.bench.stats import time_figures, times_ms
from lfpipe.config import Render
from lfpipe.config.quality import METHODS, WARPS
from lfpipe.render.compositor import Compositor
from lfpipe.render.scoring import psnr_db
from lfpipe.scene.lightfield import LightField

STRIDES = (2, 4)
SWEEP_STEP, MAX_VIEWS = 0.05, (10, 40)
TURN_PICTURES, APART = 15, 23  # pictures per turn, and steps of the walk between two of them


def every(count: int, stride: int) -> list[int]:
    """Every stride-th of count indices; the only index if count is 1; [] if none is held out."""
    indices = list(range(0, count, stride))
    return indices if count == 1 or len(indices) > 1 else []


def candidates(inputs: Inputs) -> Iterator[Candidate | Skipped]:
    """Methods x stride of the kept views."""
    field = inputs.field
    if field.rows * field.cols == 1:
        yield Skipped("synthesis", "one view: there is nothing between")
        return
    strides = [s for s in STRIDES if every(field.rows, s) and every(field.cols, s) and max(field.rows, field.cols) > s]
    if not strides:
        yield Skipped("error on left-out views", f"a grid of {field.rows}x{field.cols} has no view to leave out")
        return
    if len(strides) < len(STRIDES):
        yield Skipped(f"every {STRIDES[-1]}th view kept", f"a grid of {field.rows}x{field.cols} is too small")
    methods = [m for m in reversed(METHODS) if field.disparity is not None or m not in WARPS]
    if len(methods) < len(METHODS):
        yield Skipped("warped views", "the scene has no disparity")
    if min(field.rows, field.cols) == 1:
        yield Skipped("viewpoints off the line", "one line of views: all left-out views lie on it")
    parts = {stride: cache(partial(_part, field, stride)) for stride in strides}  # methods share the kept views
    for method, stride in itertools.product(methods, strides):
        knob = f"every {stride}{'nd' if stride == 2 else 'th'} view"
        paper, used = (method == name and stride == strides[0] for name in ("nearest", field.method))
        yield Candidate(method, knob, partial(_prepare, inputs, method, stride, parts[stride]), paper, used)


def _part(field: LightField, stride: int) -> LightField:
    return subsample(field, every(field.rows, stride), every(field.cols, stride))


def _prepare(inputs: Inputs, method: str, stride: int, kept: Callable[[], LightField]) -> Prepared:
    field, part = inputs.field, kept()
    renderer, whole = ViewRenderer(part, method), np.asarray(field.views)[0]
    compositor = Compositor(part, Render(method=method, anaglyph="colour"))  # type: ignore[arg-type]
    step = viewpoint_walk(part)
    viewpoints = [step() for _ in range(TURN_PICTURES * APART)][::APART]  # equal in every turn: some viewpoints need two warps

    def errors() -> Samples:
        samples: Samples = {"rmse": [], "psnr_db": []}
        for row, col in _left_out(field, stride, MAX_VIEWS[0 if inputs.quick else 1]):
            square = float(np.mean((renderer.at((row / stride, col / stride)) - whole[row, col]) ** 2))
            samples["rmse"].append(square**0.5)
            samples["psnr_db"].append(psnr_db(square))
        samples["jump"] = [_jump(part, renderer)]
        return samples

    def turn() -> dict[str, float]:
        return time_figures([times_ms(partial(compositor.compose, *viewpoint), 1)[0] for viewpoint in viewpoints])

    return Prepared(errors, turn)


def _left_out(field: LightField, stride: int, count: int) -> list[tuple[int, int]]:
    """Up to count present views between the kept ones, spread evenly."""
    last = tuple(every(n, stride)[-1] for n in (field.rows, field.cols))
    between = itertools.product(range(last[0] + 1), range(last[1] + 1))
    inside = [(r, c) for r, c in between if (r % stride or c % stride) and field.present[r, c]]
    indices = np.unique(np.linspace(0, len(inside) - 1, min(count, len(inside))).round().astype(int))
    return [inside[int(k)] for k in indices]


def _jump(part: LightField, renderer: ViewRenderer) -> float:
    """Largest over mean difference between pictures SWEEP_STEP views apart, over two steps of the grid: 1 is even motion,
    1 / SWEEP_STEP is a jump from view to view."""
    along = part.cols > 1
    count = part.cols if along else part.rows
    start = (count - 1) / 2 - min(1.0, (count - 1) / 2)
    across = ((part.rows if along else part.cols) - 1) / 2
    sweep = np.arange(start, start + min(2.0, count - 1) + 1e-9, SWEEP_STEP)
    pictures = (renderer.at((across, float(t)) if along else (float(t), across)) for t in sweep)
    steps = [float(np.abs(b - a).mean()) for a, b in itertools.pairwise(pictures)]
    return max(steps) / max(float(np.mean(steps)), 1e-9)


SUBJECT = Subject(
    "synthesis",
    "Views between the stored ones",
    "Views are left out, predicted from the others (with disparities estimated from the kept views alone) and compared. A picture"
    " is an anaglyph of both eyes' views, at viewpoints between the stored ones.",
    (
        Figure("rmse", "error on left-out views, RMSE", "levels", "rms"),
        Figure("psnr_db", "PSNR on left-out views", "dB", "mean"),
        Figure("jump", "largest over mean step of a sweep", "", "max"),
        Figure("time_ms", "time per picture, p50", "ms"),
        Figure("time_p95_ms", "time per picture, p95", "ms"),
    ),
    (
        Chart("synthesis", "Error on left-out views against time", "time_ms", "rmse"),
        Chart("synthesis-continuity", "Jumps while moving against time", "time_ms", "jump"),
    ),
    candidates,
    paper="nearest stored view",
    needs=("scene",),
    choice=Choice("render.method", "time_ms", "rmse", 8.0, "half a refresh at 60 Hz"),
    budget_s=(5.0, 60.0),
)
