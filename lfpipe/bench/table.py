"""The protocol of papers on angular super-resolution: keep the corners of 7x7 views, synthesise the 45 others and compare.

PSNR and SSIM of luma are averaged over the synthesised views of a scene. The 7x7 views are the central ones of 9x9 (DistgASR) or
the top left ones (LFASR-geo, ELFR). Smaller grids use the largest square that fits; the name of the row tells it.
"""

import time
import tracemalloc
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.inputs import Progress
from lfpipe.bench.results import Results, Row, Table, Value
from lfpipe.bench.runner import conditions
from lfpipe.bench.subjects import TABLE
from lfpipe.bench.synthesis import ViewRenderer, subsample
from lfpipe.config.quality import METHODS, WARPS
from lfpipe.errors import UserError
from lfpipe.render.scoring import psnr_db
from lfpipe.scene.lightfield import LightField

SIDE = 7  # views per side in the printed protocol
PASSES = 3  # timed passes over all synthesised views
LUMA, BLACK = np.array([65.481, 128.553, 24.966]) / 255, 16.0  # ITU-R BT.601, 16 to 235, as MATLAB's rgb2ycbcr
SIGMA_PX, WINDOW_PX, K1, K2 = 1.5, 11, 0.01, 0.03  # Wang, Bovik, Sheikh, Simoncelli, IEEE TIP 2004
Float = NDArray[np.float64]


@attrs.frozen
class Protocol:
    """keep: kept views per side. crop: "central" or "top-left". border_px: shaved off each side before comparing. timed: with the
    time per picture."""

    keep: int = 2
    crop: str = "central"
    border_px: int = 22
    timed: bool = True


def studio_luma(planes: NDArray[np.generic]) -> Float:
    """Luma, float64 (h, w), 16 to 235, of planar RGB (3, h, w) or grey (1, h, w) with values 0 to 255. Not rounded."""
    weights = LUMA if len(planes) == 3 else LUMA.sum(keepdims=True)
    return np.asarray(np.tensordot(weights, np.asarray(planes, np.float64), 1) + BLACK, np.float64)


def shaved(picture: Float, border_px: int) -> Float:
    """The picture without border_px on each side. Raises ValueError if the rest is too small for SSIM."""
    height, width = picture.shape
    if min(height, width) - 2 * border_px < WINDOW_PX:
        raise ValueError(f"a view of {width}x{height} px is too small for a border of {border_px} px")
    return picture[border_px : height - border_px, border_px : width - border_px]


def ssim(a: Float, b: Float) -> float:
    """Mean structural similarity: Gaussian window of 11x11 with sigma 1.5, population covariance, peak 255.

    The mean is over the windows that lie within the picture, as in the authors' code and in scikit-image.
    """

    def mean(values: Float) -> Float:
        return cv2.GaussianBlur(values, (WINDOW_PX, WINDOW_PX), SIGMA_PX, borderType=cv2.BORDER_REFLECT)  # type: ignore[return-value]

    mean_a, mean_b = mean(a), mean(b)
    var_a, var_b, both = mean(a * a) - mean_a**2, mean(b * b) - mean_b**2, mean(a * b) - mean_a * mean_b
    c1, c2 = (K1 * 255) ** 2, (K2 * 255) ** 2
    similarity = (2 * mean_a * mean_b + c1) * (2 * both + c2) / ((mean_a**2 + mean_b**2 + c1) * (var_a + var_b + c2))
    pad = WINDOW_PX // 2
    return float(similarity[pad:-pad, pad:-pad].mean())


def axis(count: int, keep: int, crop: str) -> tuple[int, int]:
    """(first view, step between kept views) along an axis of `count` views; step 0 for a single view.

    Raises ValueError if no view lies between the kept ones.
    """
    if count == 1:
        return 0, 0
    step = (min(SIDE, count) - 1) // (keep - 1)
    if step < 2:
        raise ValueError(f"{count} views in a line: none lies between {keep} kept ones")
    return ((count - 1 - step * (keep - 1)) // 2 if crop == "central" else 0), step


def grid_of(field: LightField, protocol: Protocol) -> tuple[tuple[int, int], tuple[int, int], int]:
    """((first row, kept rows), (first column, kept columns), step). Raises ValueError as `axis`."""
    (row, row_step), (col, col_step) = (axis(count, protocol.keep, protocol.crop) for count in (field.rows, field.cols))
    if not (row_step or col_step):
        raise ValueError("one view: nothing lies between")
    step = min(step for step in (row_step, col_step) if step)  # the same on both axes, as disparity is per step of the grid
    return (row, protocol.keep if row_step else 1), (col, protocol.keep if col_step else 1), step


def scene_rows(field: LightField, protocol: Protocol, progress: Progress) -> Iterator[Row]:
    """A row for each method. Raises ValueError if the field does not fit the protocol."""
    (row, rows), (col, cols), step = grid_of(field, protocol)
    grid = f"{rows}x{cols} -> {(rows - 1) * step + 1}x{(cols - 1) * step + 1}"
    inside = np.ndindex((rows - 1) * step + 1, (cols - 1) * step + 1)
    places = [(r, c) for r, c in inside if (r % step or c % step) and field.present[row + r, col + c]]
    kept_rows, kept_cols = ([start + k * step for k in range(n)] for start, n in ((row, rows), (col, cols)))
    if not field.present[np.ix_(kept_rows, kept_cols)].all():
        raise ValueError("one of the kept views is missing")
    views = np.asarray(field.views[0])
    truth = {place: shaved(studio_luma(views[row + place[0], col + place[1]]), protocol.border_px) for place in places}
    started = time.perf_counter()
    part = subsample(field, kept_rows, kept_cols)
    prepare_s = time.perf_counter() - started
    for method in reversed(METHODS):
        warps = method in WARPS
        if warps and part.disparity is None:
            continue
        tracemalloc.start()
        renderer = ViewRenderer(part, method)
        errors, similarities = [], []
        for k, place in enumerate(places):
            luma = shaved(studio_luma(renderer.at((place[0] / step, place[1] / step))), protocol.border_px)
            errors.append(psnr_db(float(np.mean(np.square(truth[place] - luma)))))
            similarities.append(ssim(truth[place], luma))
            progress(f"{field.name}, {method}", k + 1, len(places))
        buffers = tracemalloc.get_traced_memory()[0]
        tracemalloc.stop()
        stored = part.views.nbytes + (part.disparity.nbytes if warps and part.disparity is not None else 0)
        figures = {"psnr_db": float(np.mean(errors)), "worst_db": min(errors), "ssim": float(np.mean(similarities))}
        figures |= {"mb": (stored + buffers) / 1e6, "prepare_s": prepare_s if warps else 0.0}
        figures |= {"ms": _median_ms(renderer, places, step)} if protocol.timed else {}
        values = {name: Value(value, value, value) for name, value in figures.items()}
        values |= {name: attrs.evolve(values[name], words=f"{figures[name]:.{digits}f}")
                   for name, digits in (("psnr_db", 2), ("worst_db", 2), ("ssim", 4))}  # fmt: skip
        yield Row(f"{field.name}, {grid}, {method}", values, method)


def _median_ms(renderer: ViewRenderer, places: Sequence[tuple[int, int]], step: int) -> float:
    """Median time to draw one view in colour, over PASSES passes over the synthesised views."""
    times = []
    for row, col in [*places] * PASSES:
        start = time.perf_counter_ns()
        renderer.draw((row / step, col / step))
        times.append((time.perf_counter_ns() - start) / 1e6)
    return float(np.median(times))


def measure_scenes(scenes: Sequence[tuple[Path, Callable[[], LightField]]], protocol: Protocol, progress: Progress) -> Results:
    """Every method on every scene. scenes: (path, function that opens it); one that cannot be measured is left out."""
    cv2.setNumThreads(1)  # as in a session
    started, cpu_s = time.monotonic(), time.process_time()
    results, rows = Results(TABLE.name, about=conditions()), []
    for path, open_field in scenes:
        try:
            rows += list(scene_rows(open_field(), protocol, progress))
        except (UserError, ValueError) as error:
            results.left_out.append(f"{path.name}: {error}")
    note = f"{protocol.keep}x{protocol.keep} views kept of the {protocol.crop} 7x7, {protocol.border_px} px shaved off each side."
    results.tables = [Table("scene, views, method", TABLE.columns, tuple(rows), "", note)]
    results.wall_s, results.cpu_s = round(time.monotonic() - started, 1), round(time.process_time() - cpu_s, 1)
    return results
