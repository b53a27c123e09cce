"""Known motion of a head before the camera: pieces of a path, in mm; and a viewer's path as a
camera sees it.

Coordinates are the camera's: x right and y down in its picture, z away from it. Reaches follow the
minimum-jerk profile of human movements (Flash and Hogan 1985).
"""

import math
from collections.abc import Callable, Sequence

import attrs
import numpy as np
from numpy.typing import NDArray

HeadPosition = tuple[float, float, float]
Float = NDArray[np.float64]
# of a pinhole camera of 640x480 and its viewer
FOCAL_PX = 600.0
HOME_MM = 600.0
EYES_MM = 63.0


def minimum_jerk(s: Float) -> Float:
    """Shares of the distance at shares s of the time, both in 0..1.

    The largest slope is 1.875, in the middle.
    """
    return s * s * s * (10 + s * (-15 + 6 * s))


@attrs.frozen
class Piece:
    """A named piece of a path. position_mm: times (n,), 0 to duration_s -> (n, 3)."""

    name: str
    duration_s: float
    position_mm: Callable[[Float], Float]


def still(at: HeadPosition, duration_s: float) -> Piece:
    return Piece("still", duration_s, lambda t_s: _between(at, at, t_s))


def reach(start: HeadPosition, end: HeadPosition, peak_mm_s: float, name: str = "reach") -> Piece:
    """A minimum-jerk move with the top speed peak_mm_s."""
    duration_s = 1.875 * math.dist(start, end) / peak_mm_s
    return Piece(name, duration_s, lambda t_s: _between(start, end, minimum_jerk(t_s / duration_s)))


def stop(
    start: HeadPosition,
    end: HeadPosition,
    speed_mm_s: float,
    brake_s: float = 0.06,
    run_up_s: float = 0.4,
) -> Piece:
    """A sudden stop: a move that accelerates to speed_mm_s within run_up_s and brakes within
    brake_s.

    The distance must be longer than accelerating and braking need.
    """
    way_mm = math.dist(start, end)
    cruise_s = way_mm / speed_mm_s - (run_up_s + brake_s) / 2

    def position(t_s: Float) -> Float:
        up_s, mid_s, down_s = (
            np.maximum(t_s - since_s, 0) for since_s in (0, run_up_s, run_up_s + cruise_s)
        )
        up_s = np.minimum(up_s, run_up_s)
        done_mm = speed_mm_s * (
            up_s * up_s / (2 * run_up_s) + mid_s - down_s * down_s / (2 * brake_s)
        )
        return _between(start, end, np.minimum(done_mm / way_mm, 1.0))

    return Piece("stop", run_up_s + cruise_s + brake_s, position)


def sway(around: HeadPosition, reach_mm: float, rate_hz: float, duration_s: float) -> Piece:
    """Slow sway about a position, mostly sideways. Starts and ends there at rest."""

    def position(t_s: Float) -> Float:
        fade = minimum_jerk(np.minimum(np.minimum(t_s, duration_s - t_s), 1.0))
        angle = 2 * math.pi * rate_hz * t_s
        offsets = (
            fade * reach_mm * np.sin(angle),
            fade * reach_mm * 0.3 * np.sin(1.7 * angle),
            0 * t_s,
        )
        return np.array(around) + np.stack(offsets, axis=1)

    return Piece("sway", duration_s, position)


def _between(start: HeadPosition, end: HeadPosition, share: Float) -> Float:
    return np.array(start) + np.subtract(end, start) * share[:, None]


def path_at(pieces: Sequence[Piece], t_s: Float) -> tuple[Float, NDArray[np.str_]]:
    """Positions (n, 3) and names of the pieces (n,) at times (n,) of a path; at rest before its
    start and after its end.
    """
    ends_s = np.cumsum([piece.duration_s for piece in pieces])
    index = np.minimum(np.searchsorted(ends_s, t_s, side="right"), len(pieces) - 1)
    positions = np.empty((len(t_s), 3))
    for k, piece in enumerate(pieces):
        here = index == k
        positions[here] = piece.position_mm(
            np.clip(t_s[here] - ends_s[k] + piece.duration_s, 0, piece.duration_s)
        )
    return positions, np.array([piece.name for piece in pieces])[index]


def duration_s(pieces: Sequence[Piece]) -> float:
    return sum(piece.duration_s for piece in pieces)


def viewer_path(z_mm: float, side_mm: float) -> list[Piece]:
    """About 45 s of a viewer before a screen: rest, reaches up to 450 mm/s, sway, sudden stops,
    approach and retreat, leaving the picture and coming back.

    z_mm: distance of the viewer. side_mm: distance of the picture's edge from its middle there.
    """
    home: HeadPosition = (0.0, 0.0, z_mm)
    far = 0.5 * side_mm  # the whole face still in the picture
    left = (-far, 0.0, z_mm)
    right = (far, 10.0, z_mm)
    high = (0.3 * far, -40.0, z_mm)
    low = (-0.4 * far, 30.0, z_mm)
    near, away, out = (0.0, 0.0, 0.75 * z_mm), (20.0, 0.0, 1.5 * z_mm), (1.9 * side_mm, 0.0, z_mm)
    pieces = [still(home, 4.0)]
    at = home
    for goal, peak_mm_s, rest_s in (
        (right, 150, 1.0),
        (left, 450, 1.0),
        (right, 300, 0.5),
        (high, 200, 1.0),
        (low, 350, 0.7),
    ):
        pieces += [reach(at, goal, peak_mm_s), still(goal, rest_s)]
        at = goal
    pieces += [reach(at, home, 250), sway(home, 25.0, 0.5, 6.0)]
    pieces += [
        stop(home, right, 220),
        still(right, 0.8),
        stop(right, left, 400),
        still(left, 0.8),
        reach(left, home, 300),
    ]
    pieces += [
        reach(home, near, 200, "approach"),
        still(near, 0.5),
        reach(near, away, 350, "retreat"),
        still(away, 0.5),
    ]
    pieces += [reach(away, home, 300, "approach"), reach(home, out, 450, "leave"), still(out, 1.5)]
    return [*pieces, reach(out, home, 450, "enter"), still(home, 3.0)]
