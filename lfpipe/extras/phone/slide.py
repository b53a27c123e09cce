"""A light field of one row from a camera moved sideways by hand: frames of a video, or pictures of
a folder.

Corners of the middle frame are followed through the others. How far the near ones move against the
far ones gives the camera's place. The chosen views are rectified, so that common points move along
rows only: a fit explains vertical motion by a rotation (roll, pitch, yaw), a scale, and a share of
the sideways motion, the slope of the slide.

Which end of the row is the left one: a camera that moves to the right moves everything to the left,
but people turn it, too, so that the subject stays in the middle. A turn also makes one side of the
picture taller (x' = f a + x + a x^2 / f, y' = y + a x y / f, for an angle a and a focal length f),
which no sideways motion does: that share gives the angle, and the rest is the camera's own motion.
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
from lfpipe.scene.layouts.rgbd import LOWER
from lfpipe.scene.optical_flow import Grey, Mask, robust_fit
from lfpipe.scene.orientation import orient
from lfpipe.scene.source import VIDEOS, Progress, SceneSource, library_errors, list_scene, natural
from lfpipe.scene.video import Video

Corners = NDArray[np.float32]  # (n, 1, 2) as (x, y), OpenCV's form

_GLANCE_PX, _VIEW_PX = 320, 1280  # widths: for measuring motion, and of the views at most
# of the width: parallax between neighbouring views, and of the whole slide
_STEP_SHARE, _MIN_PARALLAX = 0.004, 0.008
_FEWEST = 5  # views
_SHARED = 0.3  # share of the middle frame's details visible in a frame
_FEWEST_SHARED = 20  # details to compare two frames by
# sharpness of the chosen frames: over that of the sharpest tenth, and at least
_BLURRED, _SHARPNESS = 0.15, 4.0
# that are followed through the views, and that a rotation needs
_CORNERS, _FEWEST_CORNERS = 1200, 60
_RETURN_PX = 0.4  # a corner tracked forward and back must return within this
_HUBER_PX = 0.3  # from there on, what is off counts by its amount and not by its square
# px up and down that warps pass over; of a view's size; width
_MAX_RESIDUAL_PX, _MIN_SHRINK, _MIN_VIEW_PX = 0.5, 0.4, 200
# focal length over the longer side: wide phones to short telephoto lenses; that of most phones
_FOCAL_RANGE, _USUAL_FOCAL = (0.55, 2.0), 0.8
# turning that is one: over its standard error, and over the parallax
_CLEAR, _TURNED = 4.0, 0.1
_ZOOMED = 0.05  # change of size: more is no hand


@attrs.frozen(kw_only=True)
class Slide:
    """The row of views that was made."""

    views: int
    width_px: int
    height_px: int
    frames: int  # pictures that the views were chosen from
    residual_px: float  # vertical disparity, 95th percentile
    spread_px: float  # parallax between the outermost views
    order: str  # evidence for the depth order
    order_sure: bool  # whether it decides


@attrs.frozen(kw_only=True)
class Rectified:
    """What makes a row of the views of a slide."""

    homographies: list[NDArray[np.float64]]  # (3, 3), from rectified pixels to those of each view
    residual_px: float  # remaining vertical disparity, 95th percentile
    spread_px: float  # parallax between the outermost views
    moved: NDArray[np.float64]  # by view, the motion of the picture along x, in half widths
    aside: NDArray[np.float64]  # by view and corner, what exceeds that
    yaw: NDArray[np.float64]  # by view, the share x y of its motion along y, in half widths
    corners_y: NDArray[np.float64]  # of the corners in the middle view, in half widths

    def to_the_right(self, position: NDArray[np.float64], longer: float) -> tuple[bool, bool]:
        """(Whether the camera went to the right as its position rises, whether that is sure).

        Sure where the camera was turned: without its turning everything then moves to one side, at
        any focal length that cameras have. Where it was not, pictures may have been shifted by a
        stabilizer; then lower objects are assumed nearer. longer: the longer
        side over the width.
        """
        centred = position - position.mean()
        weights = centred / (centred @ centred)
        turning = float(self.yaw @ weights)
        off = self.yaw - self.yaw.mean() - turning * centred
        error = float(np.sqrt(off @ off / (len(off) - 2) * (weights @ weights)))
        by_corner = weights @ self.aside
        low, high = np.percentile(by_corner, (5, 95)) + float(self.moved @ weights)
        focal = 2 * longer * np.array([*_FOCAL_RANGE, _USUAL_FOCAL])
        ends = np.stack([low - turning * focal**2, high - turning * focal**2])
        turned = abs(turning) > _CLEAR * error and abs(turning) * focal[2] ** 2 > _TURNED * (
            high - low
        )
        if turned:
            return bool(ends[:, 2].mean() < 0), bool((ends < 0).all() or (ends > 0).all())
        lower = float(np.corrcoef(by_corner, self.corners_y)[0, 1])
        return (lower < 0 if abs(lower) > LOWER else bool(ends[:, 2].mean() < 0)), False


def _reader(path: Path) -> tuple[int, Callable[[int], NDArray[Any]]]:
    """(count, read) of the frames of a video or the pictures of a folder, RGB or grey of 8 bit.

    Raises UserError.
    """
    listing = list_scene(path)
    if listing.is_file:
        if not listing.names[0].lower().endswith(VIDEOS):
            raise UserError(
                f"{path}: neither a video nor a folder of pictures",
                f"give a video ({', '.join(VIDEOS)}) or a folder",
            )
        video = Video(path)
        return video.frames, video.rgb
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


def _levelled(pictures: list[NDArray[Any]]) -> list[NDArray[Any]]:
    """Pictures without the changes of exposure between them: with the mean of the middle one."""
    means = [max(1.0, float(picture.mean())) for picture in pictures]
    return [
        np.asarray(cv2.convertScaleAbs(picture, alpha=means[len(means) // 2] / mean))
        for picture, mean in zip(pictures, means, strict=True)
    ]


def _size_change(at: NDArray[np.float64]) -> float:
    """Share by which the largest picture exceeds the smallest, by followed corners (`follow`). Both
    axes must agree: parallax stretches one.
    """
    sizes = [np.ones(2)]
    for there in at:
        use = np.isfinite(there[:, 0])
        if np.count_nonzero(use) >= _FEWEST_SHARED:
            both = np.percentile((there[use], at[len(at) // 2][use]), (10, 90), axis=1)
            own, middle = np.ptp(both, axis=0)
            sizes.append(own / np.maximum(middle, 1e-9))
    return float(np.ptp(sizes, axis=0).min())


def _rectified(picture: NDArray[Any], homography: NDArray[np.float64]) -> NDArray[Any]:
    """A view by its homography of `rectify`; black where it shows nothing."""
    size = picture.shape[1], picture.shape[0]
    return np.asarray(
        cv2.warpPerspective(picture, homography, size, flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP)
    )


def _track(a: Grey, b: Grey, start: Corners, guess: Corners) -> tuple[Corners, Mask]:
    """Positions in b of corners of a, and whether they lead back from there.

    guess: initial positions.
    """
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
    """Where corners of the middle view, at most so many, are in every view: (views, corners, 2) as
    (x, y) px, NaN from where on one is lost.
    """
    middle = len(views) // 2
    corners = cv2.goodFeaturesToTrack(
        views[middle], most, 0.005, max(5, views[middle].shape[1] // 90)
    )
    start = np.zeros((0, 1, 2), np.float32) if corners is None else np.asarray(corners, np.float32)
    at = np.full((len(views), len(start), 2), np.nan)
    at[middle] = start[:, 0]
    for order in (range(middle + 1, len(views)), range(middle - 1, -1, -1)) if len(start) else ():
        before = start
        tracked = np.ones(len(start), bool)
        for k in order:
            # always from the middle view, so that errors do not add up; starting at the last view's
            # position, so that it is found
            before, ok = _track(views[middle], views[k], start, before)
            tracked &= ok
            at[k, tracked] = before[tracked, 0]
    return at


def _motion(at: NDArray[np.float64], shape: tuple[int, ...]) -> tuple[int, NDArray[np.float64]]:
    """The first of the frames that share enough detail; and where the camera stood at each of them,
    px of parallax between the nearest and the farthest, rising to either side: the first principal
    motion of corners (`follow`) after removing the common part. shape: of a frame. Raises
    UserError.
    """
    count = len(at)
    middle = count // 2
    share = np.isfinite(at[..., 0]).mean(axis=1) if at.size else np.zeros(count)
    bad = np.flatnonzero(share <= _SHARED)
    first = int(max(bad[bad < middle], default=-1)) + 1
    last = int(min(bad[bad > middle], default=count)) - 1
    kept = np.isfinite(at[first : last + 1, :, 0]).all(axis=0)
    if kept.sum() < _FEWEST_SHARED or last - first + 1 < _FEWEST:
        raise UserError(
            "the pictures share too little detail: the camera moves too fast, or they are blurred"
            " or too dark",
            "slide over a hand's breadth in four seconds, in good light, with something still in"
            " view",
        )
    moved = at[first : last + 1, kept] - at[middle, kept]
    parallax = _without_rotation(moved, at[middle, kept], shape)
    mode = np.linalg.svd(parallax, full_matrices=False)[2][0]
    reach = np.ptp(np.percentile(mode.reshape(-1, 2), (5, 95), axis=0), axis=0)
    return first, parallax @ mode * float(np.hypot(*reach))


def _without_rotation(
    moved: NDArray[np.float64], at: NDArray[np.float64], size: tuple[int, ...]
) -> NDArray[np.float64]:
    """Motion (frames, points, 2) minus the part explained by rotation or forward motion of the
    camera, as (frames, points * 2).
    """
    x, y = ((at - np.array(size[::-1]) / 2) / size[1]).T
    one = np.ones_like(x)
    none = np.zeros_like(x)
    terms = [(one, none), (none, one), (-y, x), (x, y), (x * x, x * y), (x * y, y * y)]
    basis = np.stack([np.stack(term, axis=1).ravel() for term in terms], axis=1)
    flat = moved.reshape(len(moved), -1)
    return np.asarray(flat - (basis @ np.linalg.lstsq(basis, flat.T, rcond=None)[0]).T)


def _chosen_frames(
    glances: list[Grey], at: NDArray[np.float64]
) -> tuple[list[int], NDArray[np.float64]]:
    """Frames at even steps between the ends of the slide, the sharpest near each step; and where
    the camera stood, in any unit, rising to either side. at: their corners (`follow`). Raises
    UserError.
    """
    start, position = _motion(at, glances[0].shape)
    first, last = sorted((int(np.argmin(position)), int(np.argmax(position))))
    travelled = np.abs(position - position[first])[first : last + 1]
    parallax = float(travelled[-1]) / _GLANCE_PX
    if parallax < _MIN_PARALLAX:
        raise UserError(
            f"near and far move against each other by only {parallax:.2%} of the picture: the"
            " camera was turned, not slid, or hardly moved, or everything is far away",
            "slide the camera sideways by a hand's breadth without turning it, past something near",
        )
    views = int(np.clip(parallax / _STEP_SHARE, _FEWEST, 15))
    step = travelled[-1] / (views - 1)
    sharp = [float(cv2.Laplacian(glance, cv2.CV_32F).var()) for glance in glances[start + first :]]
    steps: set[int] = set()
    for goal in np.linspace(0, travelled[-1], views):
        near = np.flatnonzero(np.abs(travelled - goal) <= step / 4)
        steps.add(
            int(max(near, key=lambda k: sharp[k], default=np.argmin(np.abs(travelled - goal))))
        )
    chosen = sorted(steps)
    if np.median([sharp[k] for k in chosen]) < max(
        _BLURRED * float(np.percentile(sharp, 90)), _SHARPNESS
    ):
        raise UserError("the pictures are blurred", "slide more slowly, in more light")
    return [start + first + k for k in chosen], position[first:][chosen]


def rectify(views: list[Grey]) -> Rectified:
    """What makes a row of views in order of the slide. Raises UserError if they share too
    little.
    """
    height, width = views[0].shape
    unit = width / 2
    centre = np.array([width / 2, height / 2])
    middle = len(views) // 2
    at_px = follow(views, _CORNERS)
    shared = np.isfinite(at_px).all(axis=(0, 2))
    if shared.sum() < _FEWEST_CORNERS:
        raise UserError(
            f"only {int(shared.sum())} details are visible in all pictures; {_FEWEST_CORNERS} are"
            " needed",
            "slide more slowly and less far, in good light, with something still in view",
        )
    # centred, in units of half the width
    at = ((at_px[:, shared] - centre) / unit).transpose(0, 2, 1)
    x, y = at[middle]
    basis = np.stack([np.ones_like(x), x, y, x * y, y * y], axis=1)
    others = [k for k in range(len(views)) if k != middle]
    # pitch, roll, scale, yaw (x y and y y), and the slope of the slide
    fits = np.zeros((len(views), 6))
    aside = np.zeros((len(views), len(x)))  # sideways motion not explained by the rotation

    def moved(k: int) -> NDArray[np.float64]:
        _, roll, scale, yaw, pitch, _ = fits[k]
        return np.asarray(at[k][0] - (x * (1 + scale) - y * roll + yaw * x * x + pitch * x * y))

    for k in others:
        for _ in range(3):
            aside[k] = moved(k) - np.median(moved(k))
            fits[k] = robust_fit(np.column_stack([basis, aside[k]]), at[k][1] - y, _HUBER_PX / unit)
    slope = float(np.average(fits[others, 5], weights=aside[others].std(axis=1) + 1e-9))
    # rows of the result run along the slide
    along = np.array([[1, -slope, 0], [slope, 1, 0], [0, 0, np.hypot(1, slope)]])
    to_px = np.array([[unit, 0, width / 2], [0, unit, height / 2], [0, 0, 1]])
    left = np.zeros_like(aside)
    motion = np.zeros(len(views))
    homographies = []
    for k, fit in enumerate(fits):  # once more, with one slope for all
        vertical = at[k][1] - y - slope * aside[k]
        fit[:5] = robust_fit(basis, vertical, _HUBER_PX / unit)
        left[k] = np.abs(vertical - basis @ fit[:5])
        pitch, roll, scale, yaw, pitch_2, _ = fit
        # second-order terms of a rotation are the same two in both directions:
        # those of a homography
        motion[k] = np.median(moved(k))
        shift = np.array([motion[k], pitch, 1])
        linear = np.array([[1 + scale, -roll, 0], [roll, 1 + scale, 0], [0, 0, 0]])
        homographies.append(
            to_px @ (linear - np.outer(shift, [yaw, pitch_2, -1])) @ along @ np.linalg.inv(to_px)
        )
    residual = float(np.percentile(left[others], 95)) / float(np.hypot(1, slope)) * unit
    return Rectified(
        homographies=homographies,
        residual_px=residual,
        spread_px=float(np.ptp(np.percentile(aside[-1] - aside[0], (5, 95)))) * unit,
        moved=motion,
        aside=aside,
        yaw=fits[:, 3],
        corners_y=y,
    )


def common_area(inside: Mask) -> tuple[slice, slice]:
    """Rows and columns of the largest part of a picture that is inside everywhere, by moving in the
    emptiest side again and again.
    """
    height, width = inside.shape
    sides = np.array([0, height, 0, width])
    while not (part := inside[slice(*sides[:2]), slice(*sides[2:])]).all():
        full = [side.mean() for side in (part[0], part[-1], part[:, 0], part[:, -1])]
        worst = np.argmin(full)
        sides[worst] += (1, -1, 1, -1)[worst]
    return slice(*sides[:2]), slice(*sides[2:])


@attrs.frozen(kw_only=True)
class _Row:
    """Rectified views in the order of the camera's positions, which are in steps of the grid."""

    views: list[NDArray[Any]]
    position: NDArray[np.float64]
    side_sure: bool  # whether the camera's own motion determines the right end
    residual_px: float
    spread_px: float

    def turned(self) -> "_Row":
        """The same from the other end."""
        position = (len(self.views) - 1 - self.position)[::-1]
        return attrs.evolve(self, views=self.views[::-1], position=position, side_sure=False)


def _rectified_row(views: list[NDArray[Any]], position: NDArray[np.float64]) -> _Row:
    """The rectified views of chosen pictures. Raises UserError."""
    rectified = rectify([_grey(view) for view in views])
    longer = max(views[0].shape[:2]) / views[0].shape[1]
    to_the_right, side_sure = rectified.to_the_right(position, longer)
    position = position if to_the_right else -position
    views = [
        _rectified(view, homography)
        for view, homography in zip(views, rectified.homographies, strict=True)
    ]
    # half a px outside is black
    inner = np.pad(np.ones((views[0].shape[0] - 2, views[0].shape[1] - 2), np.uint8), 1)
    inside = [_rectified(inner, homography) > 0 for homography in rectified.homographies]
    area = common_area(np.all(inside, axis=0))
    shrink = _shrink(rectified, *views[0][area].shape[:2])
    return _Row(
        views=[
            np.asarray(cv2.resize(views[k][area], None, None, shrink, shrink, cv2.INTER_AREA))
            for k in np.argsort(position)
        ],
        position=(np.sort(position) - position.min()) / float(np.ptp(position)) * (len(views) - 1),
        side_sure=side_sure,
        residual_px=rectified.residual_px * shrink,
        spread_px=rectified.spread_px * shrink,
    )


def _row(count: int, read: Callable[[int], NDArray[Any]], progress: Progress) -> _Row:
    """The views of a slide of count pictures. Raises UserError if it is unsuitable."""
    numbers = list(range(0, count, -(-count // 400)))
    if len(numbers) < _FEWEST:
        raise UserError(
            f"{len(numbers)} pictures are too few; at least {_FEWEST} are needed",
            "slide for at least two seconds",
        )
    glances = []
    for number in numbers:
        glances.append(_grey(_reduced(read(number), _GLANCE_PX)))
        progress("motion", len(glances), len(numbers))
    at = follow(_levelled(glances), 400)
    try:
        chosen, position = _chosen_frames(glances, at)
        pictures = [_reduced(read(numbers[k]), _VIEW_PX) for k in chosen]
        return _rectified_row(_levelled(pictures), position)
    except UserError:
        if (change := _size_change(at)) > _ZOOMED:  # more than a hand makes
            raise UserError(
                f"the scale changed by {change:.0%} (zoom, or the camera moved closer)",
                "slide the camera sideways, at one zoom and one distance",
            ) from None
        raise


def _shrink(rectified: Rectified, height: int, width: int) -> float:
    """The scale of the views: the remaining vertical motion comes from the hand, which also rises
    and falls, and smaller views have less of it. Raises UserError if they would be too small.
    """
    residual_px = rectified.residual_px
    shrink = min(1.0, _MAX_RESIDUAL_PX / max(residual_px, 1e-9))
    if shrink * width < _MIN_VIEW_PX or shrink < _MIN_SHRINK:
        raise UserError(
            f"views of only {width}x{height} px remain, which differ up and down by"
            f" {residual_px:.2f} px (95 %); they need a width of {_MIN_VIEW_PX} px and at most"
            f" {_MAX_RESIDUAL_PX} px of difference",
            "slide along a straight line without turning the camera, past still objects, in"
            " larger pictures",
        )
    return shrink


def _write(out: Path, row: _Row, sure: bool, progress: Progress) -> None:
    """Raises UserError."""
    # names contain coordinates only if they are certain, because detection trusts them
    form = "out_00_{0:02d}_0.000_{1:.3f}_.png" if sure else "view_{0:02d}.png"
    try:
        out.mkdir(parents=True)
        for col, view in enumerate(row.views):
            picture = view if view.ndim == 2 else cv2.cvtColor(view, cv2.COLOR_RGB2BGR)
            write_file(
                out / form.format(col, row.position[col]),
                cv2.imencode(".png", picture)[1].tobytes(),
                0o644,
            )
            progress("views", col + 1, len(row.views))
    except OSError as error:
        raise UserError(
            f"{out}: cannot be written: {reason(error)}",
            "name a folder that does not exist yet with -o",
        ) from None


def make_slide(path: Path, out: Path, progress: Progress) -> Slide:
    """Writes a row of rectified views of the slide at path into the new folder out, named with
    their camera positions where their order is sure, else with numbers.

    Raises UserError with the reason if the clip is unsuitable.
    """
    with library_errors(path):
        count, read = _reader(path)
        try:
            row = _row(count, read, progress)
        except UserError as error:
            raise UserError(f"{path}: {error.message}", error.remedy) from None
    height_px, width_px = row.views[0].shape[:2]
    source = SceneSource(
        layout="slide",
        path=path,
        files=(),
        rows=1,
        cols=len(row.views),
        read=lambda f, r, c: row.views[c],
        height_px=height_px,
        width_px=width_px,
    )
    order = orient(source, config.Scene())
    why = order.reason
    if order.turn.cols:
        row = row.turned()  # what is hidden contradicts the motion
    elif row.side_sure and not order.sure:
        why = f"{why}; the camera's own motion, without its turning, leads to the right"
    sure = order.sure or row.side_sure
    _write(out, row, sure, progress)
    return Slide(
        views=len(row.views),
        width_px=width_px,
        height_px=height_px,
        frames=count,
        residual_px=row.residual_px,
        spread_px=row.spread_px,
        order=why,
        order_sure=sure,
    )
