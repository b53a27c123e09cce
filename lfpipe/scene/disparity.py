"""Disparity of every view from its neighbours in the grid, as in LightField: px per grid step,
positive is nearer.
"""

from collections.abc import Callable
from functools import partial
from itertools import groupby, product
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.host.worker import add
from lfpipe.scene.lightfield import UNKNOWN, Depth
from lfpipe.scene.optical_flow import (
    RETURN_PX,
    SMALLEST_PX,
    FloatMap,
    Grey,
    displaced,
    fine_flow,
    grid_xy,
)

# (picture, rows away, columns away), fractions allowed
Neighbours = list[tuple[Grey, float, float]]

# views of at least this many px on either side are compared at half their size,
# which maps have anyway
HALVED_PX = 192
ROUNDS = 2  # of refinement by all neighbours jointly
REFINED_OVER_PX = 0.8  # sigma of the window of the refinement
STEADY = 4.0  # squared grey levels per px: with less contrast in the neighbours, values are kept
OUTLIER = 6.0  # grey levels above which a pixel counts less
LARGEST_STEP_PX = 0.5  # the linear approximation of the picture fails beyond it
MEDIAN_PX = 3  # side of the last filter
SOFTNESS = 2.0  # grey levels by which a neighbour may match worse and still count
# sigma of the window of gradient energies; squared grey levels per px^2 added to every direction
ENERGY_PX, ENERGY_FLOOR = 1.5, 0.05
# A neighbour determines a value if the energy along its baseline is this share of the largest.
TELLING_SHARE = 0.05
# Disparity is used where, over windows of WINDOW_PX, it explains a tenth of the squared difference
# between a view and one of its neighbours, and the two warps to a picture midway between them
# differ less from each other than the cross-fade differs from their mean. Areas smaller than
# MIN_AREA_PX on a side are ignored; gaps up to GAP_PX between areas are closed.
MIN_EXPLAINED, WINDOW_PX, MIN_AREA_PX, GAP_PX = 0.1, 9, 15, 25
EXPLAINED_ALL = 4.0  # squared grey levels: a smaller difference needs no explanation
# squared error of a warp per squared difference between two; see profiling/results/synthesis.md
DISAGREEMENT = 1.5
UNSEEN_ERROR = 16.0  # squared grey levels: a warp with a smaller error needs no replacement
OUTSIDE = 64.0  # grey levels of a match outside the neighbour's picture
BORDER = 0.03  # of the width, at either side: the screen edge cuts it off within a few views
# percentile: at the border, where neighbours see different parts, a few values are wrong
EXTREME = 5
RETURN_SHARE = 0.05  # tolerance of disparity followed back, beside RETURN_PX
_BOX = (5, 5)  # px whose errors count together


def sampled(
    picture: NDArray[Any],
    disparity_px: FloatMap,
    d_row: float,
    d_col: float,
    how: int = cv2.INTER_LINEAR,
) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """A view d_row rows and d_col columns away, sampled along the disparity of this one; and the
    pixels whose samples lie outside the picture.
    """
    height, width = disparity_px.shape
    xx, yy = grid_xy(height, width)
    mx, my = xx - disparity_px * float(d_col), yy - disparity_px * float(d_row)
    outside = (mx < 0) | (mx > width - 1) | (my < 0) | (my > height - 1)
    return cv2.remap(picture, mx, my, how, borderMode=cv2.BORDER_REPLICATE), outside


def mismatch(a: Grey, b: Grey, disparity_px: FloatMap, d_row: float, d_col: float) -> FloatMap:
    """Mismatch of a, warped by its disparity, with b at grid steps (d_row, d_col) from it: grey
    levels, box mean.
    """
    warped, outside = sampled(b, disparity_px, d_row, d_col)
    wrong = cv2.absdiff(warped, a).astype(np.float32)
    wrong[outside] += OUTSIDE
    return np.asarray(cv2.blur(wrong, _BOX), np.float32)


def view_disparity(here: Grey, neighbours: Neighbours) -> FloatMap:
    """Disparity of one view, float32 (h, w), from its neighbours, one or more.

    Each neighbour gives one map. Its weight at a pixel is how well it matches there, less where
    something is hidden or outside, times how well its direction determines the value: the gradient
    energy along its baseline (an edge along the baseline matches at any disparity). The flow to a
    pair of opposite neighbours starts from the disparity of the pairs before.
    """
    energies = gradient_energies(here, neighbours)
    order = sorted(range(len(neighbours)), key=lambda k: _line(neighbours[k]))
    neighbours = [neighbours[k] for k in order]
    energies = [energies[k] for k in order]
    maps, errors = list[FloatMap](), list[FloatMap]()
    start: FloatMap | None = None
    for _, pair in groupby(neighbours, _line):
        for neighbour, d_row, d_col in pair:
            shift = None if start is None else np.dstack((-d_col * start, -d_row * start))
            shift = fine_flow(here, neighbour, shift)
            square = d_row * d_row + d_col * d_col
            maps.append(
                shift[..., 0] * np.float32(-d_col / square)
                - shift[..., 1] * np.float32(d_row / square)
            )
            errors.append(mismatch(here, neighbour, maps[-1], d_row, d_col))
        weights = [
            np.asarray(share * (np.maximum(energy, 0) + np.float32(ENERGY_FLOOR)), np.float32)
            for share, energy in zip(_match_weights(errors), energies, strict=False)
        ]
        weighted = [weight * one for weight, one in zip(weights, maps, strict=True)]
        used = neighbours[: len(maps)]
        start = _total(used, weighted) / _total(used, weights)
    assert start is not None
    for _ in range(ROUNDS):
        start = refined(here, neighbours, start)
    return np.asarray(cv2.medianBlur(start, MEDIAN_PX), np.float32)


def _line(neighbour: tuple[Grey, float, float]) -> int:
    """An id of the line through a view and its neighbour, equal for opposite neighbours."""
    _, d_row, d_col = neighbour
    return round(abs(d_row)) + 3 * round(abs(d_col)) + 9 * (d_row * d_col < -0.25)


def gradient_energies(here: Grey, neighbours: Neighbours) -> list[FloatMap]:
    """Gradient energy of a view along the baseline to each neighbour, squared grey levels per px^2,
    float32 (h, w): b' S b for the unit vector b of the baseline and the structure tensor S.
    """
    across, down = (
        cv2.Scharr(here, cv2.CV_32F, *axes) * np.float32(1 / 32) for axes in ((1, 0), (0, 1))
    )
    xx, xy, yy = (
        cv2.GaussianBlur(product, (0, 0), ENERGY_PX)
        for product in (across * across, across * down, down * down)
    )
    energies = []
    for _, d_row, d_col in neighbours:
        square = d_row * d_row + d_col * d_col
        energies.append(
            xx * np.float32(d_col * d_col / square)
            + xy * np.float32(2 * d_row * d_col / square)
            + yy * np.float32(d_row * d_row / square)
        )
    return energies


def _total(neighbours: Neighbours, values: list[FloatMap]) -> FloatMap:
    """The sum of a value of each neighbour.

    Opposite neighbours first: the grid turned by 180 degrees gives the same bits.
    """
    pairs: dict[int, FloatMap] = {}
    for neighbour, value in zip(neighbours, values, strict=True):
        line = _line(neighbour)
        pairs[line] = pairs[line] + value if line in pairs else value
    first, *others = (pairs[line] for line in sorted(pairs))
    return sum(others, first)


def _match_weights(errors: list[FloatMap]) -> list[FloatMap]:
    """Weight of each neighbour at each pixel: 1 for the best match, less for worse ones."""
    best: FloatMap = np.min(np.stack(errors), axis=0)
    return [np.exp((best - error) * np.float32(1 / SOFTNESS)) for error in errors]


def refined(here: Grey, neighbours: Neighbours, disparity_px: FloatMap) -> FloatMap:
    """One Gauss-Newton step of disparity_px, float32 (h, w), by all neighbours jointly.

    Minimises, over a Gaussian window around each pixel, the squared difference between `here` and
    the neighbours sampled through the disparity (Lucas and Kanade 1981, along one unknown).
    Neighbours that match badly, for example because of occlusion, count less.
    """
    own = here.astype(np.float32)
    wrongs, slopes, errors = list[FloatMap](), list[FloatMap](), list[FloatMap]()
    for neighbour, d_row, d_col in neighbours:
        warped, outside = sampled(
            neighbour.astype(np.float32), disparity_px, d_row, d_col, cv2.INTER_CUBIC
        )
        across, down = cv2.Scharr(warped, cv2.CV_32F, 1, 0), cv2.Scharr(warped, cv2.CV_32F, 0, 1)
        slope = -cv2.addWeighted(across, d_col / 32, down, d_row / 32, 0.0)
        slope[outside] = 0
        wrong = np.asarray(warped - own, np.float32)
        wrongs.append(wrong)
        slopes.append(np.asarray(slope, np.float32))
        errors.append(np.asarray(cv2.blur(np.abs(wrong), _BOX), np.float32))
    weighted = [
        slope * share / (1 + np.square(wrong * np.float32(1 / OUTLIER)))
        for wrong, slope, share in zip(wrongs, slopes, _match_weights(errors), strict=True)
    ]
    pull = _total(
        neighbours, [weight * wrong for weight, wrong in zip(weighted, wrongs, strict=True)]
    )
    hold = _total(
        neighbours, [weight * slope for weight, slope in zip(weighted, slopes, strict=True)]
    )
    window = partial(cv2.GaussianBlur, ksize=(0, 0), sigmaX=REFINED_OVER_PX)
    step = window(pull) / (window(hold) + np.float32(STEADY))
    return np.asarray(disparity_px - np.clip(step, -LARGEST_STEP_PX, LARGEST_STEP_PX), np.float32)


def unexplained(here: Grey, neighbours: Neighbours, disparity_px: FloatMap) -> NDArray[np.bool_]:
    """The pixels, bool (h, w), at which views are better cross-faded than warped along the
    disparity, whichever the neighbour.

    Either a view differs from each neighbour as much along its disparity as without it (a static
    sensor or dither pattern, or wrong disparity). Or warping does not improve the picture midway to
    each neighbour: warps from either side differ more from each other, or are blurred more by
    sampling, than the cross-fade differs from both (two surfaces at one place, as with glass and
    highlights, or texture at the limit of sampling).
    """
    own = here.astype(np.float32)
    energies = gradient_energies(here, neighbours)
    telling_energy = np.float32(TELLING_SHARE) * np.max(energies, axis=0)
    worse = list[NDArray[np.bool_]]()
    along = list[FloatMap]()
    still = list[FloatMap]()
    for (neighbour, d_row, d_col), energy in zip(neighbours, energies, strict=True):
        blind = energy < telling_energy  # an edge along the baseline matches at any disparity
        other = neighbour.astype(np.float32)

        def view_at(
            picture: FloatMap, steps: float, how: int, d_row: float = d_row, d_col: float = d_col
        ) -> FloatMap:
            """picture as seen steps of the way to the neighbour; NaN outside it."""
            values, outside = sampled(picture, disparity_px, steps * d_row, steps * d_col, how)
            values[outside] = np.nan
            return np.asarray(values, np.float32)

        same = np.square(other - own)
        moved = np.square(view_at(other, 1.0, cv2.INTER_LINEAR) - own)
        along.append(_windows(np.where(np.isnan(moved), same, moved)))
        still.append(_windows(same))
        along[-1][blind] = still[-1][blind] = np.inf
        sharp = view_at(own, -0.5, cv2.INTER_CUBIC), view_at(other, 0.5, cv2.INTER_CUBIC)
        mean = (sharp[0] + sharp[1]) / 2
        blur = (
            view_at(own, -0.5, cv2.INTER_LINEAR) + view_at(other, 0.5, cv2.INTER_LINEAR)
        ) / 2 - mean
        warped = DISAGREEMENT * np.square(sharp[0] - sharp[1]) + np.square(blur)
        faded = np.square((own + other) / 2 - mean)
        worse.append(
            _windows(np.nan_to_num(warped)) > _windows(np.nan_to_num(faded)) + UNSEEN_ERROR
        )
    unmoved = np.min(along, axis=0) > (1 - MIN_EXPLAINED) * np.min(still, axis=0) + EXPLAINED_ALL
    return _clean_mask(unmoved) | _clean_mask(np.all(worse, axis=0))


def _clean_mask(places: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """places without small areas, and with small gaps closed."""
    opened = cv2.morphologyEx(
        places.astype(np.uint8), cv2.MORPH_OPEN, np.ones((MIN_AREA_PX, MIN_AREA_PX), np.uint8)
    )
    return np.asarray(
        cv2.morphologyEx(opened, cv2.MORPH_CLOSE, np.ones((GAP_PX, GAP_PX), np.uint8)), bool
    )


def _windows(squares: FloatMap) -> FloatMap:
    return np.asarray(cv2.blur(squares, (WINDOW_PX, WINDOW_PX)), np.float32)


def compared(view: Grey) -> Grey:
    """A view, uint8 (h, w), at the size at which disparity is estimated: halved (rounded up) if it
    is large.
    """
    height, width = view.shape
    if min(height, width) < HALVED_PX:
        return view
    even = cv2.copyMakeBorder(view, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE)
    return np.asarray(
        cv2.resize(even, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8
    )


def shrinking(height_px: int, width_px: int) -> int:
    """The factor between a view and `compared` of it."""
    return 2 if min(height_px, width_px) >= HALVED_PX else 1


def stored_map(
    here: Grey, neighbours: Neighbours, disparity_px: FloatMap | None, factor: int
) -> tuple[FloatMap, NDArray[np.bool_]]:
    """A map of a `compared` view, zeros for None, at the size and in the px of stored maps; and
    the mask of unknown values.
    """
    if disparity_px is None:
        disparity_px = np.zeros(here.shape, np.float32)
    stored = disparity_px * np.float32(2) if factor == 2 else halved(disparity_px)
    every = 3 - factor
    unknown = (
        unexplained(here, neighbours, disparity_px)[::every, ::every]
        if neighbours
        else np.zeros(stored.shape, bool)
    )
    return stored, unknown


def halved(disparity_px: FloatMap) -> FloatMap:
    """The map at half resolution (rounded up); values stay in px of the full view."""
    height, width = disparity_px.shape
    return np.asarray(
        cv2.resize(
            disparity_px, ((width + 1) // 2, (height + 1) // 2), interpolation=cv2.INTER_AREA
        ),
        np.float32,
    )


def neighbours_of(
    grey: Callable[[int, int], Grey],
    row: int,
    col: int,
    present: NDArray[np.bool_],
    offsets: NDArray[np.float32],
) -> Neighbours:
    """The present ones of up to four neighbours of a view; with fewer than four, of the diagonal
    ones too: at the edge and in small grids, they see parts that the others do not.

    grey(row, col): a view, uint8 (h, w); present and offsets as in LightField.
    """
    rows, cols = present.shape
    steps = [(0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)]
    inside = [(row + r, col + c) for r, c in steps if 0 <= row + r < rows and 0 <= col + c < cols]
    neighbours: Neighbours = []
    for r, c in inside[:4] if len(inside) == 8 else inside:
        if present[r, c]:
            d_row, d_col = (
                float(v)
                for v in (offsets[r, c] - offsets[row, col])
                + np.array([r - row, c - col], np.float32)
            )
            if d_row * d_row + d_col * d_col > 0.01:  # two cameras in one place give no parallax
                neighbours.append((grey(r, c), d_row, d_col))
    return neighbours


def mean_square_mismatch(here: Grey, neighbours: Neighbours, disparity_px: FloatMap) -> float:
    """Mean square, in grey levels, of `mismatch` of a view over pixels and neighbours."""
    squares = [
        np.square(mismatch(here, view, disparity_px, down, across))
        for view, down, across in neighbours
    ]
    return add([float(square.mean()) for square in squares]) / max(1, len(squares))


def luma(planes: NDArray[np.uint8]) -> Grey:
    """Grey picture uint8 (h, w) of planar (1 or 3, h, w)."""
    return (
        planes[0]
        if planes.shape[0] == 1
        else np.asarray(cv2.cvtColor(cv2.merge(list(planes)), cv2.COLOR_RGB2GRAY), np.uint8)
    )


def estimate_disparity(
    views: NDArray[np.uint8], offsets: NDArray[np.float32] | None = None
) -> FloatMap | None:
    """Disparity of every view of a grid from its neighbours in that grid, px per step of it.

    views: uint8 (rows, cols, channels, h, w), any subset of a light field (`field.views[0, ::2,
    ::2]`). offsets: float32 (rows, cols, 2) in steps of this grid. Returns float32 (rows, cols, (h
    + 1) // 2, (w + 1) // 2), NaN where `unexplained`; None for a single view or views smaller than
    SMALLEST_PX.
    """
    rows, cols, _, height, width = views.shape
    if rows * cols < 2 or min(height, width) < SMALLEST_PX:
        return None
    grid = [[compared(luma(np.asarray(view))) for view in line] for line in views]
    moved = np.zeros((rows, cols, 2), np.float32) if offsets is None else offsets
    out = np.zeros((rows, cols, (height + 1) // 2, (width + 1) // 2), np.float32)
    for r, c in product(range(rows), range(cols)):
        around = neighbours_of(lambda i, j: grid[i][j], r, c, np.ones((rows, cols), bool), moved)
        disparity = view_disparity(grid[r][c], around) if around else None
        out[r, c], unknown = stored_map(grid[r][c], around, disparity, shrinking(height, width))
        out[r, c][unknown] = np.nan
    return out


def depth_range(disparity_px: FloatMap) -> Depth:
    """The range of a map (h, w) without likely errors, and the range at its border."""
    low, high = (round(float(value), 4) for value in np.percentile(disparity_px, (1, 99)))
    border_low, border_high = border_range(disparity_px)
    return Depth(min_px=low, max_px=high, border_low_px=border_low, border_high_px=border_high)


def border_range(disparity_px: FloatMap) -> tuple[float, float]:
    """Disparities of the farthest and the nearest thing at the left and right border of maps (...,
    h, w), which the screen edge cuts off; NaN means unknown.
    """
    width = max(1, round(BORDER * disparity_px.shape[-1]))
    values = np.concatenate((disparity_px[..., :width], disparity_px[..., -width:]), axis=None)
    finite = values[np.isfinite(values)]
    low, high = np.percentile(finite, (EXTREME, 100 - EXTREME)) if len(finite) else (0.0, 0.0)
    return round(float(low), 4), round(float(high), 4)


def confirmed_share(steps: NDArray[np.int8], scale_px: float, axis: int) -> float:
    """The share of the known pixels of a pair of stored maps, (2, h, w), whose disparity leads to
    one of the other view that leads back. axis: x or y, along which the views lie.
    """
    maps = np.where(steps == UNKNOWN, np.nan, steps * np.float32(scale_px / 2))
    shares = list[float]()
    for sign, here, there in ((-1, *maps), (1, *maps[::-1])):
        by_px = np.zeros((*here.shape, 2), np.float32)
        by_px[..., axis] = sign * np.nan_to_num(here)
        to = grid_xy(*here.shape)[axis] + by_px[..., axis]
        off = np.abs(displaced(there, by_px) - here)
        counted = ~np.isnan(here) & (to >= 0) & (to < here.shape[1 - axis])
        agree = off[counted] < RETURN_PX + RETURN_SHARE * np.abs(here[counted])
        shares.append(np.count_nonzero(agree) / max(1, agree.size))
    return min(shares)


def quantised(disparity_px: FloatMap, scale_px: float) -> NDArray[np.int8]:
    """The map as int8 steps of scale_px, clipped; NaN becomes UNKNOWN."""
    steps = np.clip(np.rint(disparity_px * np.float32(1 / scale_px)), -127, 127)
    return np.where(np.isnan(steps), np.float32(UNKNOWN), steps).astype(np.int8)


def scale_for(low_px: float, high_px: float) -> float:
    """The step of the stored maps: 1/16 px if the range fits (up to 7.9 px), else the finest step
    that holds it.
    """
    return max(1 / 16, max(abs(low_px), abs(high_px)) / 127)
