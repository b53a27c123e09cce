"""A light field of one row from a camera moved sideways by hand: frames of a video, or pictures of a folder.

Corners of the middle frame are followed through the others. How far the near ones move against the far ones gives the camera's
place. The chosen views are rectified, so that common points move along rows only: a fit explains vertical motion by a rotation
(roll, pitch, yaw), a scale, and a share of the sideways motion, the slope of the slide.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import read_picture
from lfpipe.files.safe_files import reason, write_file
from lfpipe.scene.files import VIDEOS, library_errors, list_scene, natural
from lfpipe.scene.optical_flow import Grey, Mask, robust_fit
from lfpipe.scene.orientation import orient
from lfpipe.scene.source import Progress, SceneSource
from lfpipe.scene.video import Video

Corners = NDArray[np.float32]  # (n, 1, 2) as (x, y), OpenCV's form

_MAX_FRAMES = 400  # examined
_GLANCE_PX, _VIEW_PX = 320, 1280  # widths: for measuring motion, and of the views at most
_STEP_SHARE, _MIN_PARALLAX = (
    0.004,
    0.008,
)  # of the width: parallax between neighbouring views, and of the whole slide
_FEWEST, _MOST = 5, 15  # views
_SHARED = 0.3  # share of the middle frame's details visible in a frame
_BLURRED, _SHARPNESS = (
    0.15,
    4.0,
)  # sharpness of the chosen frames: over that of the sharpest tenth, and at least
_CORNERS, _FEWEST_CORNERS = (
    1200,
    60,
)  # that are followed through the views, and that a rotation needs
_RETURN_PX = 0.4  # a corner tracked there and back must return
_HUBER_PX = 0.3  # from there on, what is off counts by its amount and not by its square
_MAX_RESIDUAL_PX, _MIN_SHRINK, _MIN_VIEW_PX = (
    0.5,
    0.4,
    200,
)  # px up and down that warps pass over; of a view's size; width


@attrs.frozen
class Slide:
    """The result: views in folder, of that size, from `frames` pictures. residual_px: vertical disparity, 95th percentile.
    spread_px: parallax between the outermost views. order: evidence that near and far are not exchanged. order_sure: whether
    it decides."""

    folder: Path
    views: int
    width_px: int
    height_px: int
    frames: int
    residual_px: float
    spread_px: float
    order: str
    order_sure: bool


def _reader(path: Path) -> tuple[int, Callable[[int], NDArray[Any]]]:
    """(count, read) of the frames of a video or the pictures of a folder, RGB or grey of 8 bit. Raises UserError."""
    listing = list_scene(path)
    if listing.is_file:
        if not listing.names[0].lower().endswith(VIDEOS):
            raise UserError(
                f"{path}: neither a video nor a folder of pictures",
                f"give a video ({', '.join(VIDEOS)}) or a folder",
            )
        video = Video(path)
        return video.frames, video.read
    names = sorted(listing.pictures(), key=natural)

    def read(number: int) -> NDArray[Any]:
        picture, full = read_picture(listing.file(names[number]))
        return (
            picture if full == 255 else np.asarray(cv2.convertScaleAbs(picture, alpha=255 / full))
        )

    return len(names), read


def _reduced(picture: NDArray[Any], width_px: int) -> NDArray[Any]:
    scale = min(1.0, width_px / picture.shape[1])
    return np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))


def _grey(picture: NDArray[Any]) -> Grey:
    return np.asarray(
        picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), np.uint8
    )


def _rectified(picture: NDArray[Any], homography: NDArray[np.float64]) -> NDArray[Any]:
    """A view by its homography of `rectify`; black where it shows nothing."""
    size = picture.shape[1], picture.shape[0]
    return np.asarray(
        cv2.warpPerspective(picture, homography, size, flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP)
    )


def _track(a: Grey, b: Grey, start: Corners, guess: Corners) -> tuple[Corners, Mask]:
    """Positions in b of corners of a, and whether they lead back from there. guess: initial positions."""
    ends = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 0.003)

    def moved(a: Grey, b: Grey, start: Corners, guess: Corners) -> tuple[Corners, Mask]:
        flags = cv2.OPTFLOW_USE_INITIAL_FLOW
        to, ok, _ = cv2.calcOpticalFlowPyrLK(
            a, b, start, guess.copy(), winSize=(21, 21), maxLevel=4, criteria=ends, flags=flags
        )
        return np.asarray(to, np.float32), np.asarray(ok).ravel() == 1

    to, ok = moved(a, b, start, guess)
    back, ok_back = moved(b, a, to, start)
    return to, ok & ok_back & (np.linalg.norm((back - start).reshape(-1, 2), axis=1) < _RETURN_PX)


def follow(views: list[Grey], most: int) -> NDArray[np.float64]:
    """Where corners of the middle view, at most so many, are in every view: (views, corners, 2) as (x, y) px, NaN from where on
    one is lost."""
    middle = len(views) // 2
    corners = cv2.goodFeaturesToTrack(
        views[middle], most, 0.005, max(5, views[middle].shape[1] // 90)
    )
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


def _motion(glances: list[Grey]) -> tuple[int, NDArray[np.float64]]:
    """The first of the frames that share enough detail; and where the camera stood at each of them, px of parallax between the
    nearest and the farthest, rising to the right if the pictures move to the left: the first principal motion of corners after
    removing the common part. Raises UserError."""
    middle, count = len(glances) // 2, len(glances)
    at = follow(glances, 400)
    share = np.isfinite(at[..., 0]).mean(axis=1) if at.size else np.zeros(count)
    bad = np.flatnonzero(share <= _SHARED)
    first, last = (
        int(max(bad[bad < middle], default=-1)) + 1,
        int(min(bad[bad > middle], default=count)) - 1,
    )
    kept = np.isfinite(at[first : last + 1, :, 0]).all(axis=0)
    if kept.sum() < 20 or last - first + 1 < _FEWEST:
        raise UserError(
            "the pictures share too little detail: the camera moves too fast, or they are blurred or too dark",
            "slide over a hand's breadth in four seconds, in good light, with something still in view",
        )
    moved = at[first : last + 1, kept] - at[middle, kept]
    parallax = _without_rotation(moved, at[middle, kept], glances[middle].shape)
    mode = np.linalg.svd(parallax.reshape(len(parallax), -1), full_matrices=False)[2][0].reshape(
        -1, 2
    )
    reach = np.ptp(np.percentile(mode, (5, 95), axis=0), axis=0)
    position = parallax.reshape(len(parallax), -1) @ mode.ravel() * float(np.hypot(*reach))
    to_the_right = float(np.median(moved[..., 0], axis=1) @ (position - position.mean())) < 0
    return first, position if to_the_right else -position


def _without_rotation(
    moved: NDArray[np.float64], at: NDArray[np.float64], size: tuple[int, ...]
) -> NDArray[np.float64]:
    """Motion (frames, points, 2) minus the part explained by rotation or forward motion of the camera."""
    x, y = ((at - np.array(size[::-1]) / 2) / size[1]).T
    one, none = np.ones_like(x), np.zeros_like(x)
    terms = [(one, none), (none, one), (-y, x), (x, y), (x * x, x * y), (x * y, y * y)]
    basis = np.stack([np.stack(term, axis=1).ravel() for term in terms], axis=1)
    flat = moved.reshape(len(moved), -1)
    left = flat - (basis @ np.linalg.lstsq(basis, flat.T, rcond=None)[0]).T
    return np.asarray(left.reshape(moved.shape))


def choose_frames(
    count: int, read: Callable[[int], NDArray[Any]], progress: Progress
) -> tuple[list[int], NDArray[np.float64]]:
    """Frames at even steps between the ends of the slide, the sharpest near each step; and where the camera stood, in any unit,
    rising to the right. Raises UserError."""
    numbers = list(range(0, count, -(-count // _MAX_FRAMES)))
    if len(numbers) < _FEWEST:
        raise UserError(
            f"{len(numbers)} pictures are too few; at least {_FEWEST} are needed",
            "slide for at least two seconds",
        )
    glances = []
    for number in numbers:
        glances.append(_grey(_reduced(read(number), _GLANCE_PX)))
        progress("motion", len(glances), len(numbers))
    sharp = np.array([float(cv2.Laplacian(glance, cv2.CV_32F).var()) for glance in glances])
    start, position = _motion(glances)
    first, last = sorted((int(np.argmin(position)), int(np.argmax(position))))
    travelled = np.abs(position - position[first])[first : last + 1]
    parallax = float(travelled[-1]) / _GLANCE_PX
    if parallax < _MIN_PARALLAX:
        raise UserError(
            f"near and far move against each other by {parallax:.2%} of the picture only: "
            "the camera was turned, not slid, or hardly moved, or all is far away",
            "slide the camera sideways by a hand's breadth without turning it, past something near",
        )
    views = int(np.clip(parallax / _STEP_SHARE, _FEWEST, _MOST))
    step, sharp = travelled[-1] / (views - 1), sharp[start + first :]
    steps: set[int] = set()
    for goal in np.linspace(0, travelled[-1], views):
        near = np.flatnonzero(np.abs(travelled - goal) <= step / 4)
        steps.add(
            int(max(near, key=lambda k: sharp[k], default=np.argmin(np.abs(travelled - goal))))
        )
    chosen = sorted(steps)
    if np.median(sharp[chosen]) < max(_BLURRED * float(np.percentile(sharp, 90)), _SHARPNESS):
        raise UserError("the pictures are blurred", "slide more slowly, in more light")
    return [numbers[start + first + k] for k in chosen], position[first:][chosen]


def rectify(views: list[Grey]) -> tuple[list[NDArray[np.float64]], float, float]:
    """The homographies (3, 3) from rectified pixels to those of each view, in order of the slide; the vertical disparity that is
    left (95 % are smaller) and the parallax between the outermost views, px. Raises UserError if the views share too little."""
    height, width = views[0].shape
    unit, centre, middle = width / 2, np.array([width / 2, height / 2]), len(views) // 2
    at_px = follow(views, _CORNERS)
    shared = np.isfinite(at_px).all(axis=(0, 2))
    if shared.sum() < _FEWEST_CORNERS:
        raise UserError(
            f"only {int(shared.sum())} details are in all of the pictures, {_FEWEST_CORNERS} are needed",
            "slide more slowly and less far, in good light, with something still in view",
        )
    at = ((at_px[:, shared] - centre) / unit).transpose(
        0, 2, 1
    )  # centred, in units of half the width
    x, y = at[middle]
    basis = np.stack([np.ones_like(x), x, y, x * y, y * y], axis=1)
    others = [k for k in range(len(views)) if k != middle]
    fits = np.zeros(
        (len(views), 6)
    )  # pitch, roll, scale, yaw (x y and y y), and the slope of the slide
    aside = np.zeros((len(views), len(x)))  # sideways motion not explained by the rotation

    def moved(k: int) -> NDArray[np.float64]:
        _, roll, scale, yaw, pitch, _ = fits[k]
        return np.asarray(at[k][0] - (x * (1 + scale) - y * roll + yaw * x * x + pitch * x * y))

    for k in others:
        for _ in range(3):
            aside[k] = moved(k) - np.median(moved(k))
            fits[k] = robust_fit(np.column_stack([basis, aside[k]]), at[k][1] - y, _HUBER_PX / unit)
    slope = float(np.average(fits[others, 5], weights=aside[others].std(axis=1) + 1e-9))
    along = np.array(
        [[1, -slope, 0], [slope, 1, 0], [0, 0, np.hypot(1, slope)]]
    )  # rows of the result run along the slide
    to_px = np.array([[unit, 0, width / 2], [0, unit, height / 2], [0, 0, 1]])
    left, homographies = np.zeros_like(aside), []
    for k, fit in enumerate(fits):  # once more, with one slope for all
        vertical = at[k][1] - y - slope * aside[k]
        fit[:5] = robust_fit(basis, vertical, _HUBER_PX / unit)
        left[k] = np.abs(vertical - basis @ fit[:5])
        pitch, roll, scale, yaw, pitch_2, _ = fit
        # second-order terms of a rotation are the same two in both directions: those of a homography
        shift = np.array([np.median(moved(k)), pitch, 1])
        linear = np.array([[1 + scale, -roll, 0], [roll, 1 + scale, 0], [0, 0, 0]])
        homographies.append(
            to_px @ (linear - np.outer(shift, [yaw, pitch_2, -1])) @ along @ np.linalg.inv(to_px)
        )
    residual = float(np.percentile(left[others], 95)) / float(np.hypot(1, slope)) * unit
    spread = float(np.ptp(np.percentile(aside[-1] - aside[0], (5, 95)))) * unit
    return homographies, residual, spread


def common_area(inside: Mask) -> tuple[slice, slice]:
    """Rows and columns of the largest part of a picture that is inside everywhere, found by shrinking all sides in turn."""
    top, bottom, left, right = 0, inside.shape[0], 0, inside.shape[1]
    while top < bottom and left < right and not inside[top:bottom, left:right].all():
        empty = ~inside[top:bottom, left:right]
        sides = {
            "top": empty[0].mean(),
            "bottom": empty[-1].mean(),
            "left": empty[:, 0].mean(),
            "right": empty[:, -1].mean(),
        }
        worst = max(sides, key=lambda side: sides[side])
        top, bottom = top + (worst == "top"), bottom - (worst == "bottom")
        left, right = left + (worst == "left"), right - (worst == "right")
    return slice(top, bottom), slice(left, right)


def make_slide(path: Path, out: Path, progress: Progress) -> Slide:
    """Writes a row of rectified views of the slide at path into the new folder out, named with their camera positions.

    Raises UserError with the reason if the clip is unsuitable.
    """
    with library_errors(path):
        count, read = _reader(path)
        try:
            numbers, position = choose_frames(count, read, progress)
            views = [read(number) for number in numbers]
            views = [_reduced(view, _VIEW_PX) for view in views]
            homographies, residual_px, spread_px = rectify([_grey(view) for view in views])
            views = [
                _rectified(view, homography)
                for view, homography in zip(views, homographies, strict=True)
            ]
            inner = np.pad(
                np.ones((views[0].shape[0] - 2, views[0].shape[1] - 2), np.uint8), 1
            )  # half a px outside is black
            area = common_area(
                np.all([_rectified(inner, homography) > 0 for homography in homographies], axis=0)
            )
            height, width = views[0][area].shape[:2]
            # the remaining vertical motion comes from the hand, which also rises and falls: smaller views have less of it
            shrink = min(1.0, _MAX_RESIDUAL_PX / max(residual_px, 1e-9))
            if shrink * width < _MIN_VIEW_PX or shrink < _MIN_SHRINK:
                raise UserError(
                    f"views of {width}x{height} px remain, which differ up and down by {residual_px:.2f} px (95 %); they need "
                    f"a width of {_MIN_VIEW_PX} and {_MAX_RESIDUAL_PX} px",
                    "slide along a straight line without turning the camera, past things that stand still, in larger pictures",
                )
        except UserError as error:
            raise UserError(f"{path}: {error.message}", error.remedy) from None
        row = []
        for k in np.argsort(position):
            row.append(
                np.asarray(
                    cv2.resize(
                        views[k][area], None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA
                    ),
                    np.uint8,
                )
            )
    order = orient(
        SceneSource("slide", path, (), 1, len(row), lambda f, r, c: row[c], *row[0].shape[:2]),
        config.Scene(),
    )
    position = (np.sort(position) - position.min()) / float(np.ptp(position)) * (len(row) - 1)
    if order.turn.cols:
        row, position = row[::-1], (len(row) - 1 - position)[::-1]
    try:
        out.mkdir(parents=True)
        for col, view in enumerate(row):
            data = cv2.imencode(
                ".png", view if view.ndim == 2 else cv2.cvtColor(view, cv2.COLOR_RGB2BGR)
            )[1]
            write_file(
                out / f"out_00_{col:02d}_0.000_{position[col]:.3f}_.png", data.tobytes(), 0o644
            )
            progress("views", col + 1, len(row))
    except OSError as error:
        raise UserError(
            f"{out}: cannot be written: {reason(error)}",
            "name a folder that does not exist yet with -o",
        ) from None
    height_px, width_px = row[0].shape[:2]
    return Slide(
        out,
        len(row),
        width_px,
        height_px,
        count,
        residual_px * shrink,
        spread_px * shrink,
        order.reason,
        order.sure,
    )
