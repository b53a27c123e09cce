"""Rectifies views of a camera moved by hand, so that common points move only along rows.

Corners of the middle view are tracked in the others. For each view, a fit explains their vertical motion by a rotation (roll,
pitch, yaw), a scale, and a share of the sideways motion: the slope of the slide. Coordinates are centred and in units of half the
width.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.scene.optical_flow import Grey

Corners = NDArray[np.float32]  # (n, 1, 2) as (x, y), OpenCV's form
Maps = tuple[NDArray[np.float32], NDArray[np.float32]]  # x and y (h, w) of the source of each pixel of a view

_CORNERS, _FEWEST = 1200, 60  # that are followed, and that a rotation needs
_RETURN_PX = 0.4  # a corner tracked there and back must return
_ROUNDS = 12  # of the robust fit
_HUBER_PX = 0.3  # from there on, what is off counts by its amount and not by its square


def _track(a: Grey, b: Grey, start: Corners, guess: Corners) -> tuple[Corners, NDArray[np.bool_]]:
    """Positions in b of corners of a, and whether they lead back from there. guess: initial positions."""
    ends = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 0.003)

    def moved(a: Grey, b: Grey, start: Corners, guess: Corners) -> tuple[Corners, NDArray[np.bool_]]:
        flags = cv2.OPTFLOW_USE_INITIAL_FLOW
        to, ok, _ = cv2.calcOpticalFlowPyrLK(a, b, start, guess.copy(), winSize=(21, 21), maxLevel=4, criteria=ends, flags=flags)
        return np.asarray(to, np.float32), np.asarray(ok).ravel() == 1

    to, ok = moved(a, b, start, guess)
    back, ok_back = moved(b, a, to, start)
    return to, ok & ok_back & (np.linalg.norm((back - start).reshape(-1, 2), axis=1) < _RETURN_PX)


def follow(views: list[Grey], most: int) -> NDArray[np.float64]:
    """Where corners of the middle view, at most so many, are in every view: (views, corners, 2) as (x, y) px, NaN from where on
    one is lost."""
    middle = len(views) // 2
    corners = cv2.goodFeaturesToTrack(views[middle], most, 0.005, max(5, views[middle].shape[1] // 90))
    start = np.zeros((0, 1, 2), np.float32) if corners is None else np.asarray(corners, np.float32)
    at = np.full((len(views), len(start), 2), np.nan)
    at[middle] = start[:, 0]
    for order in (range(middle + 1, len(views)), range(middle - 1, -1, -1)) if len(start) else ():
        before, kept = start, np.ones(len(start), bool)
        for k in order:
            # always from the middle view, so that errors do not add up; starting at the last view's position, so that it is found
            before, ok = _track(views[middle], views[k], start, before)
            kept &= ok
            at[k, kept] = before[kept, 0]
    return at


def _fit(matrix: NDArray[np.float64], values: NDArray[np.float64], unit_px: float) -> NDArray[np.float64]:
    """Least squares with Huber's weights."""
    weights = np.ones(len(values))
    for _ in range(_ROUNDS):
        solution = np.linalg.lstsq(matrix * weights[:, None], values * weights, rcond=None)[0]
        off = np.abs(values - matrix @ solution) * unit_px
        weights = np.sqrt(np.minimum(1.0, _HUBER_PX / np.maximum(off, 1e-9)))
    return np.asarray(solution)


def rectify(views: list[Grey]) -> tuple[list[Maps], float, float]:
    """The maps that rectify views in order of the slide; the vertical disparity that is left (95 % are smaller) and the parallax
    between the outermost views, px. Raises UserError if the views share too little."""
    height, width = views[0].shape
    unit, centre, middle = width / 2, np.array([width / 2, height / 2]), len(views) // 2
    at_px = follow(views, _CORNERS)
    shared = np.isfinite(at_px).all(axis=(0, 2))
    if shared.sum() < _FEWEST:
        raise UserError(
            f"only {int(shared.sum())} details are in all of the pictures, {_FEWEST} are needed",
            "slide more slowly and less far, in good light, with something still in view",
        )
    at = ((at_px[:, shared] - centre) / unit).transpose(0, 2, 1)
    x, y = at[middle]
    basis = np.stack([np.ones_like(x), x, y, x * y, y * y], axis=1)
    others = [k for k in range(len(views)) if k != middle]
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
    shift, left = np.zeros(len(views)), []
    for k in others:  # once more, with one slope for all
        vertical = at[k][1] - y - slope * aside[k]
        fits[k, :5] = _fit(basis, vertical, unit)
        shift[k] = np.median(moved(k))
        left.append(np.abs(vertical - basis @ fits[k, :5]))
    residual = float(np.percentile(np.concatenate(left), 95)) / float(np.hypot(1, slope)) * unit
    spread = float(np.ptp(np.percentile(aside[-1] - aside[0], (5, 95)))) * unit
    return [_maps(fit, shift[k], slope, (height, width)) for k, fit in enumerate(fits)], residual, spread


def _maps(fit: NDArray[np.float64], shift: float, slope: float, size: tuple[int, int]) -> Maps:
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


def common_area(maps: list[Maps]) -> tuple[int, int, int, int]:
    """(top, left, height, width) of the largest area covered by every view, found by shrinking all sides in turn."""
    height, width = maps[0][0].shape
    inside = np.ones((height, width), bool)
    for x, y in maps:
        inside &= (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    top, bottom, left, right = 0, height, 0, width
    while top < bottom and left < right and not inside[top:bottom, left:right].all():
        empty = ~inside[top:bottom, left:right]
        sides = {"top": empty[0].mean(), "bottom": empty[-1].mean(), "left": empty[:, 0].mean(), "right": empty[:, -1].mean()}
        worst = max(sides, key=lambda side: sides[side])
        top, bottom = top + (worst == "top"), bottom - (worst == "bottom")
        left, right = left + (worst == "left"), right - (worst == "right")
    return top, left, bottom - top, right - left
