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
from lfpipe.scene.slide_rectification import common_area, follow, rectify
from lfpipe.scene.source import SceneSource
from lfpipe.scene.video import Video

Progress = Callable[[str, int, int], None]

_MAX_FRAMES = 400  # examined
_GLANCE_PX, _VIEW_PX = 320, 1280  # widths: for measuring motion, and of the views at most
_STEP_SHARE, _MIN_PARALLAX = 0.004, 0.008  # of the width: parallax between neighbouring views, and of the whole slide
_FEWEST, _MOST = 5, 15  # views
_SHARED = 0.3  # share of the middle frame's details visible in a frame
_BLURRED, _SHARPNESS = 0.15, 4.0  # sharpness of the chosen frames: over that of the sharpest tenth, and at least
_MAX_RESIDUAL_PX, _MIN_SHRINK, _MIN_VIEW_PX = 0.5, 0.4, 200  # px up and down that warps pass over; of a view's size; width


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


def _motion(glances: list[Grey]) -> tuple[int, NDArray[np.float64]]:
    """The first of the frames that share enough detail; and where the camera stood at each of them, px of parallax between the
    nearest and the farthest, rising to the right if the pictures move to the left: the first principal motion of corners after
    removing the common part. Raises UserError."""
    middle, count = len(glances) // 2, len(glances)
    at = follow(glances, 400)
    share = np.isfinite(at[..., 0]).mean(axis=1) if at.size else np.zeros(count)
    bad = np.flatnonzero(share <= _SHARED)
    first, last = int(max(bad[bad < middle], default=-1)) + 1, int(min(bad[bad > middle], default=count)) - 1
    kept = np.isfinite(at[first : last + 1, :, 0]).all(axis=0)
    if kept.sum() < 20 or last - first + 1 < _FEWEST:
        raise UserError(
            "the pictures share too little detail: the camera moves too fast, or they are blurred or too dark",
            "slide over a hand's breadth in four seconds, in good light, with something still in view",
        )
    moved = at[first : last + 1, kept] - at[middle, kept]
    parallax = _without_rotation(moved, at[middle, kept], glances[middle].shape)
    mode = np.linalg.svd(parallax.reshape(len(parallax), -1), full_matrices=False)[2][0].reshape(-1, 2)
    reach = np.ptp(np.percentile(mode, (5, 95), axis=0), axis=0)
    position = parallax.reshape(len(parallax), -1) @ mode.ravel() * float(np.hypot(*reach))
    to_the_right = float(np.median(moved[..., 0], axis=1) @ (position - position.mean())) < 0
    return first, position if to_the_right else -position


def _without_rotation(moved: NDArray[np.float64], at: NDArray[np.float64], size: tuple[int, ...]) -> NDArray[np.float64]:
    """Motion (frames, points, 2) minus the part explained by rotation or forward motion of the camera."""
    x, y = ((at - np.array(size[::-1]) / 2) / size[1]).T
    one, none = np.ones_like(x), np.zeros_like(x)
    terms = [(one, none), (none, one), (-y, x), (x, y), (x * x, x * y), (x * y, y * y)]
    basis = np.stack([np.stack(term, axis=1).ravel() for term in terms], axis=1)
    flat = moved.reshape(len(moved), -1)
    left = flat - (basis @ np.linalg.lstsq(basis, flat.T, rcond=None)[0]).T
    return np.asarray(left.reshape(moved.shape))


def choose_frames(count: int, read: Callable[[int], NDArray[Any]], progress: Progress) -> tuple[list[int], NDArray[np.float64]]:
    """Frames at even steps along the longest slide, the sharpest near each step; and where the camera stood, in any unit, rising
    to the right. Raises UserError."""
    numbers = list(range(0, count, -(-count // _MAX_FRAMES)))
    if len(numbers) < _FEWEST:
        raise UserError(f"{len(numbers)} pictures are too few; at least {_FEWEST} are needed", "slide for at least two seconds")
    glances = []
    for number in numbers:
        glances.append(_grey(read(number), _GLANCE_PX))
        progress("motion", len(glances), len(numbers))
    sharp = np.array([float(cv2.Laplacian(glance, cv2.CV_32F).var()) for glance in glances])
    start, position = _motion(glances)
    first, last = _one_way(position)
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
        steps.add(int(max(near, key=lambda k: sharp[k], default=np.argmin(np.abs(travelled - goal)))))
    chosen = sorted(steps)
    if np.median(sharp[chosen]) < max(_BLURRED * float(np.percentile(sharp, 90)), _SHARPNESS):
        raise UserError("the pictures are blurred", "slide more slowly, in more light")
    return [numbers[start + first + k] for k in chosen], position[first:][chosen]


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
            numbers, position = choose_frames(count, read, progress)
            views = [read(number) for number in numbers]
            scale = min(1.0, _VIEW_PX / views[0].shape[1])
            views = [np.asarray(cv2.resize(view, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)) for view in views]
            maps, residual_px, spread_px = rectify([_grey(view, _VIEW_PX) for view in views])
            top, left, height, width = common_area(maps)
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
            x, y = (np.ascontiguousarray(source[top : top + height, left : left + width]) for source in maps[k])
            view = cv2.remap(views[k], x, y, cv2.INTER_CUBIC)
            row.append(np.asarray(cv2.resize(view, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA), np.uint8))
    order = orient(SceneSource("slide", path, (), 1, len(row), lambda f, r, c: row[c], *row[0].shape[:2]), config.Scene())
    position = (np.sort(position) - position.min()) / float(np.ptp(position)) * (len(row) - 1)
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
    height_px, width_px = row[0].shape[:2]
    return Slide(out, len(row), width_px, height_px, count, residual_px * shrink, spread_px * shrink, order.said, order.sure)
