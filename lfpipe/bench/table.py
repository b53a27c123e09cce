"""The protocol of papers on angular super-resolution: keep the corners of 7x7 views, synthesise the
45 others and compare.

PSNR and SSIM of luma are averaged over the synthesised views of a scene. The 7x7 views are the
central ones of 9x9 (DistgASR). Smaller grids use the largest square that fits, given in the row's
name.
"""

import importlib.util
import itertools
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.benchmarks import TABLE
from lfpipe.bench.inputs import Progress
from lfpipe.bench.results import Results, Row, Table, Value
from lfpipe.bench.runner import Prepared, Variant, conditions, cpu_ms, run
from lfpipe.bench.synthesis import left_out, subsample, view_at
from lfpipe.config.quality import METHODS, WARPS
from lfpipe.errors import UserError
from lfpipe.host.worker import install_command
from lfpipe.render.plan import psnr_db
from lfpipe.render.synthesis.compositor import ViewRenderer
from lfpipe.render.synthesis.viewpoint import Position
from lfpipe.scene.lightfield import LightField

SIDE = 7  # views per side in the published protocol
# ITU-R BT.601, 16 to 235, as MATLAB's rgb2ycbcr
LUMA = np.array([65.481, 128.553, 24.966]) / 255
BLACK = 16.0
WINDOW_PX = 11  # side of SSIM's window
Float = NDArray[np.float64]


@attrs.frozen
class Protocol:
    """The protocol for holding out and comparing views."""

    keep: int = 2
    """Kept views per side."""
    border_px: int = 22
    """Cropped from each side before comparing."""
    timed: bool = True
    """Whether to measure the time per picture."""


def studio_luma(planes: NDArray[np.generic]) -> Float:
    """Luma, float64 (h, w), 16 to 235, of planar RGB (3, h, w) or grey (1, h, w) with values 0 to
    255. Not rounded.
    """
    weights = LUMA if len(planes) == 3 else LUMA.sum(keepdims=True)
    return np.asarray(np.tensordot(weights, np.asarray(planes, np.float64), 1) + BLACK, np.float64)


def shaved(picture: Float, border_px: int) -> Float:
    """The picture without border_px on each side.

    Raises ValueError if the rest is too small for SSIM.
    """
    height, width = picture.shape
    if min(height, width) - 2 * border_px < WINDOW_PX:
        raise ValueError(
            f"a view of {width}x{height} px is too small for a border of {border_px} px"
        )
    return picture[border_px : height - border_px, border_px : width - border_px]


def ssim(a: Float, b: Float) -> float:
    """Mean structural similarity (Wang, Bovik, Sheikh, Simoncelli, IEEE TIP 2004): Gaussian window
    of 11x11 with sigma 1.5, population covariance, peak 255.
    """
    from skimage.metrics import structural_similarity

    return float(
        structural_similarity(  # type: ignore[no-untyped-call]
            a, b, data_range=255, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
        )
    )


def kept_views(count: int, keep: int) -> range:
    """Indices of the kept views along an axis, evenly spaced among the central ones; a single view
    is kept.

    Raises ValueError if no view is between them.
    """
    step = (min(SIDE, count) - 1) // (keep - 1)
    if count > 1 and step < 2:
        raise ValueError(f"{count} views in a line: none is between {keep} kept ones")
    first = (count - 1 - step * (keep - 1)) // 2
    return range(first, first + step * (keep - 1) + 1, max(step, 1))


def measure(field: LightField, protocol: Protocol) -> Iterator[Variant]:
    """A variant for each method. Raises ValueError if the field does not fit the protocol."""
    axes = [kept_views(count, protocol.keep) for count in (field.rows, field.cols)]
    if field.rows == field.cols == 1:
        raise ValueError("one view: no view can be held out")
    # the same on both axes, because disparity is per grid step
    step = min(axis.step for axis in axes if len(axis) > 1)
    rows, cols = ([axis.start + k * step for k in range(len(axis))] for axis in axes)
    if not field.present[np.ix_(rows, cols)].all():
        raise ValueError("one of the kept views is missing")
    truth = {
        place: shaved(studio_luma(view), protocol.border_px)
        for place, view in left_out(field, rows, cols).items()
    }
    kept_field = subsample(field, rows, cols)
    whole = f"{rows[-1] - rows[0] + 1}x{cols[-1] - cols[0] + 1}"
    grid = f"{len(rows)}x{len(cols)} -> {whole}"
    for method in reversed(METHODS):
        if kept_field.disparity is not None or method not in WARPS:
            yield Variant(
                curve=method,
                parameter=f"{field.name}, {grid}",
                prepare=partial(_prepare, kept_field, method, truth, protocol),
            )


def _prepare(
    kept_field: LightField, method: str, truth: dict[Position, Float], protocol: Protocol
) -> Prepared:
    renderer = ViewRenderer(kept_field, method)
    db = []
    similar = []
    for place, true in truth.items():
        luma = shaved(studio_luma(view_at(renderer, place)), protocol.border_px)
        db.append(psnr_db(float(np.mean(np.square(true - luma)))))
        similar.append(ssim(true, luma))
    upcoming = itertools.cycle(truth)
    repetition = partial(cpu_ms, lambda: renderer.planes(*next(upcoming)), len(truth))
    maps = kept_field.disparity if method in WARPS else None
    stored_bytes = kept_field.views.nbytes + (0 if maps is None else maps.nbytes)
    metrics = {
        "psnr_db": Value(float(np.mean(db))),
        "worst_db": Value(min(db)),
        "ssim": Value(float(np.mean(similar))),
        "mb": Value(stored_bytes / 1e6),
    }
    return metrics, (lambda: {"ms": repetition()}) if protocol.timed else None


def measure_scenes(
    scenes: Sequence[tuple[Path, Callable[[], LightField]]], protocol: Protocol, progress: Progress
) -> Results:
    """Every method on every scene.

    scenes: (path, function that opens it); a scene that does not fit the protocol is skipped.
    Raises UserError if a library is missing.
    """
    if importlib.util.find_spec("skimage") is None:
        raise UserError(
            "bench table needs scikit-image for SSIM, which is not installed here",
            f"`{install_command('scikit-image')}`",
        )
    whole = Results(TABLE.name, about=conditions())
    rows = list[Row]()
    for path, open_field in scenes:
        try:
            results = run(TABLE, measure(open_field(), protocol), False, progress)
            rows += results.rows
            whole.failures |= results.failures
            whole.wall_s += results.wall_s
        except UserError as error:
            whole.failures[path.name] = str(error)
        except ValueError as error:
            whole.left_out.append(f"{path.name}: {error}")
    note = (
        f"{protocol.keep}x{protocol.keep} views kept of the central 7x7, {protocol.border_px} px"
        " cropped from each side."
    )
    whole.tables = [Table("method, scene, views", TABLE.columns, tuple(rows), "", note)]
    return whole
