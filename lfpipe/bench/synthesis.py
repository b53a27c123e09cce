"""Subject: views between, and beyond, the stored ones: error on left-out views, continuity, and time per picture."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from functools import cache, partial

import attrs
import numpy as np

from lfpipe.bench.inputs import Inputs
from lfpipe.bench.kept import coarser, kept, made, walk
from lfpipe.bench.model import Candidate, Diagram, Figure, Prepared, Skipped, Subject
from lfpipe.bench.timing import times_ms
from lfpipe.config import Render
from lfpipe.render.compositor import Compositor
from lfpipe.render.scoring import METHODS, psnr_db
from lfpipe.render.synthesis import Synthesiser
from lfpipe.scene.lightfield import LightField

STRIDES, COARSER = (2, 4), (1, 2, 4)
SWEEP_STEP, PLACES = 0.05, (10, 40)
TURN_PICTURES, APART = 15, 23  # pictures of a turn, and steps of the walk between two of them


def kept_places(count: int, stride: int) -> list[int]:
    """Every stride-th of count places from the first on: the one place where there is one only, [] where none is left out."""
    if count == 1:
        return [0]
    places = list(range(0, count, stride))
    return places if len(places) > 1 else []


def candidates(inputs: Inputs) -> Iterator[Candidate | Skipped]:
    """Methods x stride of the kept views x resolution of the disparity."""
    field = inputs.field
    if field.rows * field.cols == 1:
        yield Skipped("synthesis", "one view: there is nothing between")
        return
    strides = [
        s for s in STRIDES if kept_places(field.rows, s) and kept_places(field.cols, s) and max(field.rows, field.cols) > s
    ]
    if not strides:
        yield Skipped("error on left-out views", f"a grid of {field.rows}x{field.cols} has none to leave out")
        return
    if len(strides) < len(STRIDES):
        yield Skipped(f"every {STRIDES[-1]}th view kept", f"a grid of {field.rows}x{field.cols} is too small")
    methods = [m for m in METHODS if field.disparity is not None or not m.startswith("warp")]
    if len(methods) < len(METHODS):
        yield Skipped("warped views", "the scene has no disparity")
    if min(field.rows, field.cols) == 1:
        yield Skipped("viewpoints off the line", "one line of views: all left-out views lie on it")
    part = cache(partial(_part, field))  # several methods share the kept views
    middle = cache(partial(_middle, field))
    for method, stride in itertools.product(methods, strides):
        for factor in COARSER if method.startswith("warp") else (1,):
            fine = "" if factor == 1 else f", disparity 1/{factor}"
            knob = f"every {stride}{'nd' if stride == 2 else 'th'} view{fine}"
            paper = method == "nearest" and stride == strides[0]
            prepare = partial(_prepare, inputs, method, stride, factor, partial(part, stride), middle)
            yield Candidate(method, knob, prepare, paper, f"every {stride}" if method.startswith("warp") else "")


def _part(field: LightField, stride: int) -> LightField:
    """Every stride-th view. Of a field without disparity: the views alone, for the methods that need none."""
    rows, cols = kept_places(field.rows, stride), kept_places(field.cols, stride)
    if field.disparity is not None:
        return kept(field, rows, cols)
    views = np.ascontiguousarray(np.asarray(field.views)[:1, rows][:, :, cols])
    offsets, present = field.offsets[rows][:, cols], np.ones((len(rows), len(cols)), bool)
    return attrs.evolve(field, views=views, offsets=offsets, present=present)


def _middle(field: LightField) -> LightField | None:
    """The middle three columns (and rows) as a field of their own, or None where nothing is outside of them."""
    if field.cols < 5 or field.disparity is None or field.rows not in (1, *range(5, 1000)):
        return None
    cols = range(field.cols // 2 - 1, field.cols // 2 + 2)
    rows = [0] if field.rows == 1 else list(range(field.rows // 2 - 1, field.rows // 2 + 2))
    return kept(field, rows, list(cols))


def _prepare(
    inputs: Inputs,
    method: str,
    stride: int,
    factor: int,
    where: Callable[[], LightField],
    middle: Callable[[], LightField | None],
) -> Prepared:
    field, part = inputs.field, coarser(where(), factor)
    synthesiser = Synthesiser(part, method)
    whole = np.asarray(field.views)[0]
    outs = [np.empty((field.height_px, field.width_px), np.uint8) for _ in range(field.channels)]
    compositor = Compositor(part, Render(method=method, anaglyph="colour"))  # type: ignore[arg-type]
    step = walk(part)
    places = [step() for _ in range(TURN_PICTURES * APART)][::APART]  # the same in every turn: some places take two warps

    def errors() -> dict[str, list[float]]:
        found: dict[str, list[float]] = {"rmse": [], "psnr_db": []}
        for row, col in _left_out(field, stride, PLACES[0 if inputs.quick else 1]):
            wrong = made(part, synthesiser, (row / stride, col / stride), outs) - whole[row, col]
            square = float(np.mean(wrong**2))
            found["rmse"].append(square**0.5)
            found["psnr_db"].append(psnr_db(square))
        found["jump"] = [_jump(part, synthesiser)]
        centre = middle() if stride == STRIDES[0] and factor == 1 else None
        if centre is not None:
            found["outside_rmse"] = _outside(field, centre, method)
        return found

    def turn() -> dict[str, float]:
        times = [times_ms(partial(compositor.compose, *place), 1)[0] for place in places]
        return {"time_ms": float(np.median(times)), "time_p95_ms": float(np.percentile(times, 95))}

    return Prepared(errors, turn)


def _left_out(field: LightField, stride: int, count: int) -> list[tuple[int, int]]:
    """Up to count present views between the kept ones, well spread."""
    last = tuple(kept_places(n, stride)[-1] for n in (field.rows, field.cols))
    between = itertools.product(range(last[0] + 1), range(last[1] + 1))
    inside = [(r, c) for r, c in between if (r % stride or c % stride) and field.present[r, c]]
    chosen = np.unique(np.linspace(0, len(inside) - 1, min(count, len(inside))).round().astype(int))
    return [inside[int(k)] for k in chosen]


def _jump(part: LightField, synthesiser: Synthesiser) -> float:
    """Largest over mean difference between pictures SWEEP_STEP views apart, over two steps of the grid: 1 is even motion, and
    1 / SWEEP_STEP is a jump from view to view."""
    along = part.cols > 1
    count = part.cols if along else part.rows
    start = (count - 1) / 2 - min(1.0, (count - 1) / 2)
    out = [np.empty((part.height_px, part.width_px), np.uint8) for _ in range(part.channels)]
    other = ((part.rows if along else part.cols) - 1) / 2
    steps, before = [], None
    for t in np.arange(start, start + min(2.0, count - 1) + 1e-9, SWEEP_STEP):
        position = (other, float(t)) if along else (float(t), other)
        picture = made(part, synthesiser, position, out)
        if before is not None:
            steps.append(float(np.abs(picture - before).mean()))
        before = picture
    return max(steps) / max(float(np.mean(steps)), 1e-9)


def _outside(field: LightField, centre: LightField, method: str) -> list[float]:
    """RMSE of the views one step outside of the middle ones."""
    synthesiser = Synthesiser(centre, method)
    outs = [np.empty((field.height_px, field.width_px), np.uint8) for _ in range(field.channels)]
    row, found = field.rows // 2, []
    for col in (field.cols // 2 - 2, field.cols // 2 + 2):
        position = (float((centre.rows - 1) // 2), float(col - (field.cols // 2 - 1)))
        wrong = made(centre, synthesiser, position, outs) - np.asarray(field.views)[0, row, col]
        found.append(float(np.mean(wrong**2)) ** 0.5)
    return found


SUBJECT = Subject(
    "synthesis",
    "Views between the stored ones",
    "Views are left out, made from the others (disparities are found from the kept views alone) and compared; a picture is both"
    " eyes' views as one anaglyph at viewpoints between the stored ones.",
    (
        Figure("rmse", "error on left-out views, RMSE", "levels", "rms"),
        Figure("psnr_db", "PSNR on left-out views", "dB", "mean", more_is_better=True),
        Figure("jump", "largest over mean step of a sweep", "", "max"),
        Figure("outside_rmse", "error one view outside the grid, RMSE", "levels", "rms"),
        Figure("time_ms", "time per picture, p50", "ms"),
        Figure("time_p95_ms", "time per picture, p95", "ms"),
    ),
    (
        Diagram("synthesis", "Error on left-out views against time", "time_ms", "rmse", "time_p95_ms"),
        Diagram("synthesis-continuity", "Jumps while moving against time", "time_ms", "jump", "time_p95_ms"),
        Diagram("synthesis-outside", "Error one view outside the grid against time", "time_ms", "outside_rmse", "time_p95_ms"),
    ),
    candidates,
    paper="nearest stored view",
    budget_s=(5.0, 60.0),
)
