"""Rectifies views of a camera moved by hand, so that common points move only along rows.

Corners of the middle view are tracked in the others. For each view, a fit explains their vertical motion by a rotation (roll,
pitch, yaw), a scale, and a share of the sideways motion: the slope of the slide. Coordinates are centred and in units of half the
width.
"""

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.scene.optical_flow import Grey

Points = NDArray[np.float64]  # (n, 2) as (x, y)
Corners = NDArray[np.float32]  # (n, 1, 2) as (x, y), OpenCV's form

_CORNERS, _FEWEST = 1200, 60
_RETURN_PX = 0.4  # a corner tracked there and back must return
_ROUNDS = 12  # of the robust fit
_HUBER_PX = 0.3
_TURNED_PX = 2.0  # smallest spread of sideways motion over the whole slide: below it there is no depth


@attrs.frozen
class Rectified:
    """maps: by view, the source of each pixel, (x, y) float32 (h, w) each. position: by view, of the camera along the slide,
    rising to the right. residual_px: 95 % of the vertical disparities are smaller. spread_px: of sideways motion between the
    outermost views."""

    maps: list[tuple[NDArray[np.float32], NDArray[np.float32]]]
    position: NDArray[np.float64]
    residual_px: float
    spread_px: float


def corners(view: Grey, most: int) -> Corners:
    """Corners of a view, float32 (n, 1, 2)."""
    found = cv2.goodFeaturesToTrack(view, most, 0.005, max(5, view.shape[1] // 90))
    return np.zeros((0, 1, 2), np.float32) if found is None else np.asarray(found, np.float32)


def track(a: Grey, b: Grey, start: Corners, guess: Corners) -> tuple[Corners, NDArray[np.bool_]]:
    """Positions in b of corners of a, and whether they lead back from there. guess: initial positions."""
    ends = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 0.003)

    def there(a: Grey, b: Grey, start: Corners, guess: Corners) -> tuple[Corners, NDArray[np.bool_]]:
        flags = cv2.OPTFLOW_USE_INITIAL_FLOW
        to, ok, _ = cv2.calcOpticalFlowPyrLK(a, b, start, guess.copy(), winSize=(21, 21), maxLevel=4, criteria=ends, flags=flags)
        return np.asarray(to, np.float32), np.asarray(ok).ravel() == 1

    to, ok = there(a, b, start, guess)
    back, ok_back = there(b, a, to, start)
    return to, ok & ok_back & (np.linalg.norm((back - start).reshape(-1, 2), axis=1) < _RETURN_PX)


def follow(views: list[Grey]) -> tuple[Points, list[Points]]:
    """Corners of the middle view that all views show, and the position of each in every view, px. Raises UserError."""
    middle = len(views) // 2
    start = corners(views[middle], _CORNERS)
    if not len(start):
        raise UserError("the pictures have no detail to track", "film something with texture, in good light")
    good = np.ones(len(start), bool)
    at = [start] * len(views)
    for order in (range(middle + 1, len(views)), range(middle - 1, -1, -1)):
        before = start
        for k in order:
            # always from the middle view, so that errors do not add up; starting at the last view's position, so that it is found
            at[k], ok = track(views[middle], views[k], start, before)
            good, before = good & ok, at[k]
    if good.sum() < _FEWEST:
        raise UserError(
            f"only {int(good.sum())} details are in all of the pictures, {_FEWEST} are needed",
            "slide more slowly and less far, in good light, with something still in view",
        )
    return start.reshape(-1, 2)[good].astype(float), [points.reshape(-1, 2)[good].astype(float) for points in at]


def _fit(matrix: NDArray[np.float64], values: NDArray[np.float64], unit_px: float) -> NDArray[np.float64]:
    """Least squares with Huber's weights."""
    weights = np.ones(len(values))
    found: NDArray[np.float64] = np.zeros(matrix.shape[1])
    for _ in range(_ROUNDS):
        found[:] = np.linalg.lstsq(matrix * weights[:, None], values * weights, rcond=None)[0]
        off = np.abs(values - matrix @ found) * unit_px
        weights = np.sqrt(np.minimum(1.0, _HUBER_PX / np.maximum(off, 1e-9)))
    return found


def rectify(views: list[Grey]) -> Rectified:
    """The maps that rectify a row of views, in order of the slide. Raises UserError if the slide is unsuitable."""
    height, width = views[0].shape
    unit, centre = width / 2, np.array([width / 2, height / 2])
    start, at_px = follow(views)
    x, y = ((start - centre) / unit).T
    at = [((points - centre) / unit).T for points in at_px]
    basis = np.stack([np.ones_like(x), x, y, x * y, y * y], axis=1)
    others = [k for k in range(len(views)) if k != len(views) // 2]
    fits = np.zeros((len(views), 6))  # pitch, roll, scale, yaw (x y and y y), and the slope of the slide
    aside = np.zeros((len(views), len(x)))  # sideways motion not explained by the rotation

    def moved(k: int) -> NDArray[np.float64]:
        _, roll, scale, yaw, pitch, _ = fits[k]
        return np.asarray(at[k][0] - (x * (1 + scale) - y * roll + yaw * x * x + pitch * x * y))

    for k in others:
        for _ in range(3):
            aside[k] = moved(k) - np.median(moved(k))
            fits[k] = _fit(np.column_stack([basis, aside[k]]), at[k][1] - y, unit)
    slope = float(np.average(fits[others, 5], weights=aside[others].std(axis=1) + 1e-9))
    pattern = aside[-1] - aside[0]
    spread = float(np.ptp(np.percentile(pattern, (5, 95)))) * unit
    if spread < _TURNED_PX:
        raise UserError(
            f"nothing moves against anything else (by {spread:.1f} px): the camera was turned, not slid, or all is far away",
            "slide the camera sideways without turning it, past something near",
        )
    shift, left = np.zeros(len(views)), []
    for k in others:  # once more, with one slope for all
        vertical = at[k][1] - y - slope * aside[k]
        fits[k, :5] = _fit(basis, vertical, unit)
        shift[k] = np.median(moved(k))
        left.append(np.abs(vertical - basis @ fits[k, :5]))
    residual = float(np.percentile(np.concatenate(left), 95)) / float(np.hypot(1, slope)) * unit
    position = aside @ pattern / float(pattern @ pattern)
    if np.median(at[-1][0] - at[0][0]) > 0:  # the picture moves to the right: the camera moved to the left
        position = -position
    maps = [_maps(fit, shift[k], slope, (height, width)) for k, fit in enumerate(fits)]
    return Rectified(maps, position, residual, spread)


def _maps(
    fit: NDArray[np.float64], shift: float, slope: float, size: tuple[int, int]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Sources of the pixels of a rectified view."""
    height, width = size
    unit = width / 2
    rows, cols = np.mgrid[:height, :width]
    along, up = (cols - width / 2) / unit, (rows - height / 2) / unit
    cos, sin = 1 / np.hypot(1, slope), slope / np.hypot(1, slope)
    x, y = cos * along - sin * up, sin * along + cos * up  # rows of the result run along the slide
    pitch, roll, scale, yaw, pitch_2 = fit[:5]
    # second-order terms of a rotation are the same two in both directions
    from_x = x * (1 + scale) - y * roll + shift + yaw * x * x + pitch_2 * x * y
    from_y = y + pitch + roll * x + scale * y + yaw * x * y + pitch_2 * y * y
    return (from_x * unit + width / 2).astype(np.float32), (from_y * unit + height / 2).astype(np.float32)


def common_area(maps: list[tuple[NDArray[np.float32], NDArray[np.float32]]]) -> tuple[int, int, int, int]:
    """(top, left, height, width) of the largest area covered by every view, found by shrinking all sides in turn."""
    height, width = maps[0][0].shape
    inside = np.ones((height, width), bool)
    for x, y in maps:
        inside &= (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    top, bottom, left, right = 0, height, 0, width
    while top < bottom and left < right and not inside[top:bottom, left:right].all():
        part = ~inside[top:bottom, left:right]
        sides = {"top": part[0].mean(), "bottom": part[-1].mean(), "left": part[:, 0].mean(), "right": part[:, -1].mean()}
        worst = max(sides, key=lambda side: sides[side])
        top, bottom = top + (worst == "top"), bottom - (worst == "bottom")
        left, right = left + (worst == "left"), right - (worst == "right")
    return top, left, bottom - top, right - left
