"""Known motion of a head before the camera: pieces of path in mm, laid end to end.

Coordinates are the camera's: x right and y down in its picture, z away from it. Reaches follow the minimum-jerk profile
(Flash and Hogan 1985), which human heads and hands keep to closely.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import attrs

Place = tuple[float, float, float]


def minimum_jerk(s: float) -> float:
    """Share of the way at share s of the time, both 0..1. Its steepest slope, in the middle, is 1.875."""
    return s * s * s * (10 + s * (-15 + 6 * s))


@attrs.frozen
class Piece:
    """One named piece of a path: place_mm(t_s) for 0 <= t_s <= duration_s."""

    name: str
    duration_s: float
    place_mm: Callable[[float], Place]


def still(at: Place, duration_s: float) -> Piece:
    return Piece("still", duration_s, lambda t_s: at)


def reach(start: Place, end: Place, peak_mm_s: float, name: str = "reach") -> Piece:
    """A minimum-jerk move whose highest speed is peak_mm_s."""
    duration_s = 1.875 * math.dist(start, end) / peak_mm_s
    return Piece(name, duration_s, lambda t_s: _between(start, end, minimum_jerk(t_s / duration_s)))


def stop(start: Place, end: Place, speed_mm_s: float, brake_s: float = 0.06, run_up_s: float = 0.4) -> Piece:
    """A move at speed_mm_s that gets going within run_up_s and stands within brake_s: a sudden stop.

    The way must be longer than the run-up and the braking take.
    """
    way_mm = math.dist(start, end)
    cruise_s = way_mm / speed_mm_s - (run_up_s + brake_s) / 2

    def place(t_s: float) -> Place:
        up_s, down_s = min(t_s, run_up_s), max(t_s - run_up_s - cruise_s, 0.0)
        mid_s = max(t_s - run_up_s, 0.0)
        gone_mm = speed_mm_s * (up_s * up_s / (2 * run_up_s) + mid_s - down_s * down_s / (2 * brake_s))
        return _between(start, end, min(gone_mm / way_mm, 1.0))

    return Piece("stop", run_up_s + cruise_s + brake_s, place)


def sway(around: Place, reach_mm: float, rate_hz: float, duration_s: float) -> Piece:
    """Slow swinging about a place, mostly sideways; starts and ends there, at rest."""

    def place(t_s: float) -> Place:
        fade = minimum_jerk(min(t_s, duration_s - t_s, 1.0))
        angle = 2 * math.pi * rate_hz * t_s
        x, y, z = around
        return x + fade * reach_mm * math.sin(angle), y + fade * reach_mm * 0.3 * math.sin(1.7 * angle), z

    return Piece("sway", duration_s, place)


def place_at(pieces: Sequence[Piece], t_s: float) -> tuple[Place, str]:
    """Place and name of the piece at time t_s of the whole path; before its start and after its end it stands still."""
    t_s = max(t_s, 0.0)
    for piece in pieces:
        if t_s < piece.duration_s:
            return piece.place_mm(t_s), piece.name
        t_s -= piece.duration_s
    return pieces[-1].place_mm(pieces[-1].duration_s), pieces[-1].name


def duration_s(pieces: Sequence[Piece]) -> float:
    return sum(piece.duration_s for piece in pieces)


def viewer_path(z_mm: float, side_mm: float) -> list[Piece]:
    """What a viewer does before a screen, about 45 s: stillness, reaches up to 450 mm/s, sway, sudden stops, approach and
    retreat, leaving the picture and coming back.

    z_mm: their distance; side_mm: how far to the side the picture's edge is at that distance.
    """
    home: Place = (0.0, 0.0, z_mm)
    far = 0.5 * side_mm  # the whole face still in the picture
    left, right, high, low = (-far, 0.0, z_mm), (far, 10.0, z_mm), (0.3 * far, -40.0, z_mm), (-0.4 * far, 30.0, z_mm)
    near, away, out = (0.0, 0.0, 0.75 * z_mm), (20.0, 0.0, 1.5 * z_mm), (1.9 * side_mm, 0.0, z_mm)
    pieces = [still(home, 4.0)]
    at = home
    for goal, peak_mm_s, rest_s in ((right, 150, 1.0), (left, 450, 1.0), (right, 300, 0.5), (high, 200, 1.0), (low, 350, 0.7)):
        pieces += [reach(at, goal, peak_mm_s), still(goal, rest_s)]
        at = goal
    pieces += [reach(at, home, 250), sway(home, 25.0, 0.5, 6.0)]
    pieces += [stop(home, right, 220), still(right, 0.8), stop(right, left, 400), still(left, 0.8), reach(left, home, 300)]
    pieces += [reach(home, near, 200, "approach"), still(near, 0.5), reach(near, away, 350, "retreat"), still(away, 0.5)]
    pieces += [reach(away, home, 300, "approach"), reach(home, out, 450, "leave"), still(out, 1.5)]
    return [*pieces, reach(out, home, 450, "enter"), still(home, 3.0)]


def _between(start: Place, end: Place, share: float) -> Place:
    x, y, z = (a + (b - a) * share for a, b in zip(start, end, strict=True))
    return x, y, z
