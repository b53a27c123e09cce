"""A light field of one row from a camera moved sideways: frames of a video, or pictures of a folder."""

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
from lfpipe.files.safe_files import reason, replaced
from lfpipe.scene.files import VIDEOS, library_errors, list_scene, natural
from lfpipe.scene.optical_flow import Grey
from lfpipe.scene.orientation import orient
from lfpipe.scene.slide_rectification import common_area, corners, rectify, track
from lfpipe.scene.source import SceneSource
from lfpipe.scene.video import Video

Progress = Callable[[str, int, int], None]

_MAX_FRAMES = 400  # examined
_GLANCE_PX, _VIEW_PX = 320, 1280  # widths: for measuring motion, and of the views at most
_STEP_SHARE, _MIN_PARALLAX = 0.004, 0.008  # of the width: parallax between neighbouring views, and of the whole slide
_FEWEST, _MOST = 5, 15  # views
_SHARED = 0.3  # share of the middle frame's details visible in a frame
_BLURRED, _SHARPNESS = 0.15, 4.0  # sharpness of the chosen frames: over that of the sharpest tenth, and at least
_MAX_RESIDUAL_PX, _MIN_SHRINK, _MIN_VIEW_PX = 0.5, 0.4, 200
_NO_DETAIL = (
    "the pictures share too little detail: the camera moves too fast, or they are blurred or too dark",
    "slide over a hand's breadth in four seconds, in good light, with something still in view",
)


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
                f"{path}: neither a video nor a folder of pictures", f"give a video ({', '.join(VIDEOS)}) or a folder"
            )
        video = Video(path)
        return video.frames, video.read
    names = sorted(listing.pictures(), key=natural)

    def read(number: int) -> NDArray[Any]:
        picture, full = read_picture(listing.file(names[number]))
        return picture if full == 255 else np.asarray(cv2.convertScaleAbs(picture, alpha=255 / full))

    return len(names), read


def _grey(picture: NDArray[Any], width_px: int) -> Grey:
    plane = picture if picture.ndim == 2 else np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY))
    scale = min(1.0, width_px / plane.shape[1])
    return np.asarray(cv2.resize(plane, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)


def _followed(glances: list[Grey]) -> tuple[NDArray[np.float64], int, bool]:
    """The camera's position along the slide by frame, px of parallax between the nearest and the farthest; the first frame of
    those that share enough detail; and whether the camera moves up and down. Raises UserError.

    Corners of the middle frame are tracked from frame to frame; the position is their first principal motion after removing the
    common part."""
    middle, count = len(glances) // 2, len(glances)
    start = corners(glances[middle], 400)
    if not len(start):
        raise UserError(*_NO_DETAIL)
    at = np.full((count, len(start), 2), np.nan)
    at[middle] = start.reshape(-1, 2)
    for order in (range(middle + 1, count), range(middle - 1, -1, -1)):
        before, alive, last = start, np.ones(len(start), bool), middle
        for k in order:
            there, ok = track(glances[last], glances[k], before, before)
            alive = alive & ok
            at[k, alive] = there.reshape(-1, 2)[alive]
            before, last = there, k
    bad = np.flatnonzero(np.isfinite(at[..., 0]).mean(axis=1) <= _SHARED)
    first, last = int(max(bad[bad < middle], default=-1)) + 1, int(min(bad[bad > middle], default=count)) - 1
    kept = np.isfinite(at[first : last + 1, :, 0]).all(axis=0)
    if kept.sum() < 20 or last - first + 1 < _FEWEST:
        raise UserError(*_NO_DETAIL)
    moved = at[first : last + 1, kept] - at[middle, kept]
    parallax = _without_rotation(moved, at[middle, kept], glances[middle].shape)
    mode = np.linalg.svd(parallax.reshape(len(parallax), -1), full_matrices=False)[2][0].reshape(-1, 2)
    ends = np.percentile(mode, (5, 95), axis=0)
    reach = np.ptp(ends, axis=0)
    position = parallax.reshape(len(parallax), -1) @ mode.ravel() * float(np.hypot(*reach))
    return position, first, bool(reach[1] > reach[0])


def _without_rotation(moved: NDArray[np.float64], at: NDArray[np.float64], size: tuple[int, ...]) -> NDArray[np.float64]:
    """Motion (frames, points, 2) minus the part explained by rotation or forward motion of the camera."""
    x, y = ((at - np.array(size[::-1]) / 2) / size[1]).T
    one, none = np.ones_like(x), np.zeros_like(x)
    terms = [(one, none), (none, one), (-y, x), (x, y), (x * x, x * y), (x * y, y * y)]
    basis = np.stack([np.stack(term, axis=1).ravel() for term in terms], axis=1)
    flat = moved.reshape(len(moved), -1)
    left = flat - (basis @ np.linalg.lstsq(basis, flat.T, rcond=None)[0]).T
    return np.asarray(left.reshape(moved.shape))


def choose_frames(count: int, read: Callable[[int], NDArray[Any]], progress: Progress) -> list[int]:
    """Frames at even steps along the longest slide, the sharpest near each step. Raises UserError."""
    numbers = list(range(0, count, -(-count // _MAX_FRAMES)))
    if len(numbers) < _FEWEST:
        raise UserError(f"{len(numbers)} pictures are too few; at least {_FEWEST} are needed", "slide for at least two seconds")
    glances = []
    for number in numbers:
        glances.append(_grey(read(number), _GLANCE_PX))
        progress("motion", len(glances), len(numbers))
    sharp = np.array([float(cv2.Laplacian(glance, cv2.CV_32F).var()) for glance in glances])
    position, shared, upright = _followed(glances)
    first, last = _one_way(position)
    travelled = np.abs(position - position[first])[first : last + 1]
    if travelled[-1] < _MIN_PARALLAX * _GLANCE_PX:
        raise UserError(
            f"near and far move against each other by {travelled[-1] / _GLANCE_PX:.2%} of the picture only: "
            "the camera was turned, not slid, or hardly moved, or all is far away",
            "slide the camera sideways by a hand's breadth without turning it, past something near",
        )
    if upright:
        raise UserError("the camera moves up and down, not sideways", "slide it sideways; rotate a clip that lies on its side")
    views = int(np.clip(travelled[-1] / (_STEP_SHARE * _GLANCE_PX), _FEWEST, _MOST))
    step, first = travelled[-1] / (views - 1), first + shared
    chosen: set[int] = set()
    for goal in np.linspace(0, travelled[-1], views):
        near = [k for k in range(len(travelled)) if abs(travelled[k] - goal) <= step / 4]
        chosen.add(first + max(near or [int(np.argmin(np.abs(travelled - goal)))], key=lambda k: sharp[first + k]))
    least = max(_BLURRED * float(np.percentile(sharp, 90)), _SHARPNESS)
    if np.median(sharp[sorted(chosen)]) < least:
        raise UserError("the pictures are blurred", "slide more slowly, in more light")
    if len(chosen) < _FEWEST:
        raise UserError(f"only {len(chosen)} steps of the slide have a picture: the camera moved too fast", "slide more slowly")
    return [numbers[k] for k in sorted(chosen)]


def _one_way(way: NDArray[np.float64]) -> tuple[int, int]:
    """First and last frame of the longest motion in one direction; small reversals do not end it."""
    spans = []
    for rising in (way, -way):
        last = int(np.argmax(rising - np.minimum.accumulate(rising)))
        first = int(np.argmin(rising[: last + 1]))
        spans.append((rising[last] - rising[first], first, last))
    return max(spans)[1:]


def make_slide(path: Path, out: Path, progress: Progress) -> Slide:
    """Writes a row of rectified views of the slide at path into the new folder out, named with their camera positions.

    Raises UserError with the reason if the clip is unsuitable.
    """
    with library_errors(path):
        count, read = _reader(path)
        try:
            numbers = choose_frames(count, read, progress)
            views = [read(number) for number in numbers]
            scale = min(1.0, _VIEW_PX / views[0].shape[1])
            views = [np.asarray(cv2.resize(view, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)) for view in views]
            found = rectify([_grey(view, _VIEW_PX) for view in views])
        except UserError as error:
            raise UserError(f"{path}: {error.message}", error.remedy) from None
        top, left, height, width = common_area(found.maps)
        # the remaining vertical motion comes from the hand, which also rises and falls: smaller views have less of it
        shrink = min(1.0, _MAX_RESIDUAL_PX / max(found.residual_px, 1e-9))
        if width < _MIN_VIEW_PX:
            raise UserError(
                f"{path}: views of {width}x{height} px remain; they need a width of {_MIN_VIEW_PX}",
                "give larger pictures, or hold the camera so that all of them show the same things",
            )
        if shrink * width < _MIN_VIEW_PX or shrink < _MIN_SHRINK:
            raise UserError(
                f"{path}: views of {width}x{height} px remain, which differ up and down by {found.residual_px:.2f} px (95 %)",
                "slide along a straight line without turning the camera, past things that stand still",
            )
        row = []
        for k in np.argsort(found.position):
            x, y = (np.ascontiguousarray(part[top : top + height, left : left + width]) for part in found.maps[k])
            view = cv2.remap(views[k], x, y, cv2.INTER_CUBIC)
            row.append(np.asarray(cv2.resize(view, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA), np.uint8))
    order = orient(SceneSource("slide", path, (), 1, len(row), lambda f, r, c: row[c], *row[0].shape[:2]), config.Scene())
    position = np.sort(found.position)
    position = (position - position[0]) / float(np.ptp(position)) * (len(row) - 1)
    if order.turn.cols:
        row, position = row[::-1], (len(row) - 1 - position)[::-1]
    try:
        out.mkdir(parents=True)
        for col, view in enumerate(row):
            data = cv2.imencode(".png", view if view.ndim == 2 else cv2.cvtColor(view, cv2.COLOR_RGB2BGR))[1]
            with replaced(out / f"out_00_{col:02d}_0.000_{position[col]:.3f}_.png", 0o644) as file:
                file.write(data.tobytes())
            progress("views", col + 1, len(row))
    except OSError as error:
        raise UserError(f"{out}: cannot be written: {reason(error)}", "name a folder that does not exist yet with -o") from None
    size = row[0].shape
    return Slide(
        out, len(row), size[1], size[0], count, found.residual_px * shrink, found.spread_px * shrink, order.said, order.sure
    )
