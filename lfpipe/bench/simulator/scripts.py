"""Scripted viewers: positions of the eyes of each person at every millisecond, and windows with a
known correct picture.

Lengths are px of a camera picture of 640x480, in which the eye distance of a person at 0.63 m is
60 px; 950 px/s are then 1 m/s. Moves follow the minimum-jerk profile of human movements (Flash and
Hogan 1985), unless they have constant speed.
"""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.capture.recordings import FRAME_PX
from lfpipe.errors import UserError
from lfpipe.render.viewer.presence import RestingEyes

Float = NDArray[np.float64]
SEAT = (320.0, 240.0, 60.0)  # x and y of the midpoint of the eyes, and the eye distance
SUREST = 20.0  # logit of the confidence in an unoccluded face
Place = tuple[float, float, float]


def minimum_jerk(share: Float) -> Float:
    """Shares of the distance at shares of the time, both 0 to 1. The largest slope is 1.875."""
    return share**3 * (10 + share * (-15 + 6 * share))


@attrs.frozen(eq=False, kw_only=True)
class Person:
    """A person in front of the camera."""

    path_px: Float
    """float (n, 3): x and y of the midpoint of the eyes, and the eye distance, at each ms."""
    logit: Float
    """(n,): confidence of the landmarks; negative: no face can be found."""
    still: bool = False
    """Whether it is a portrait: without motion and sensor noise."""
    roll_deg: Float | None = None
    """(n,): roll of the head about the midpoint of the eyes; None: upright."""

    def eyes_px(self, ms: NDArray[np.int64] | int) -> Float:
        """The true eyes (..., 2, 2), left first, at these ms."""
        at = np.minimum(ms, len(self.path_px) - 1)
        place = self.path_px[at]
        angle = np.radians(
            np.zeros(place.shape[:-1]) if self.roll_deg is None else self.roll_deg[at]
        )
        half = place[..., 2:] / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        return np.stack([place[..., :2] + half, place[..., :2] - half], axis=-2)


@attrs.frozen(kw_only=True)
class Window:
    """Interval with a known correct picture, for the eyes of a person with this rest position."""

    from_s: float
    to_s: float
    rest: RestingEyes
    person: int = 0
    event: bool = False
    """Whether it starts with an event; the time until the picture is right counts from there."""

    def holds(self, ms: Float) -> NDArray[np.bool_]:
        """Which of these times are in it."""
        return np.asarray((ms >= self.from_s * 1e3) & (ms < self.to_s * 1e3))


@attrs.frozen(kw_only=True)
class Glitch:
    """Landmarks that are wrong in some frames, by shares of the eye distance."""

    at_s: float
    left: float
    right: float
    frames: int = 1


@attrs.frozen(eq=False, kw_only=True)
class Script:
    """A scene with viewers."""

    name: str
    people: tuple[Person, ...]
    windows: tuple[Window, ...]
    """In order of time; errors count in them."""
    glitches: tuple[Glitch, ...] = ()
    steps_from_s: float = 1.0
    """Steps count from this time on: by default, after depth has appeared with the first face."""

    @property
    def count_ms(self) -> int:
        return len(self.people[0].path_px)

    def wrong(self, ms: float) -> Float:
        """The offsets by glitches at ms, in x of the first person's left and right eye, in eye
        distances.
        """
        total = np.zeros(2)
        for one in self.glitches:
            if 0 <= ms - one.at_s * 1e3 < one.frames * 1e3 / 30:
                total += one.left, one.right
        return total


@attrs.frozen
class Move:
    """A move to a place."""

    from_s: float
    to_s: float
    place: Place
    even: bool = False
    """Whether it has constant speed."""


def path(seconds: float, start: Place, *moves: Move) -> Float:
    """A path of float (n, 3), a place for each ms."""
    t_s = np.arange(round(seconds * 1000)) / 1000
    places = np.tile(np.array(start, np.float64), (len(t_s), 1))
    for move in moves:
        share = np.clip((t_s - move.from_s) / (move.to_s - move.from_s), 0, 1)[:, None]
        places += (share if move.even else minimum_jerk(share)) * (move.place - places[-1])
    return places


def swayed(
    places: Float,
    reach_px: float,
    rate_hz: float,
    up: float = 0.3,
    from_s: float = 2.0,
    to_s: float = math.inf,
) -> Float:
    """A path with a sway that grows from from_s on and ends at to_s. up: its height as a share of
    its width.
    """
    t_s = np.arange(len(places)) / 1000
    since_s = np.maximum(t_s - from_s, 0.0)
    share = minimum_jerk(np.minimum(since_s, 1.0)) * minimum_jerk(np.clip(to_s - t_s, 0, 1))
    angle = 2 * math.pi * rate_hz * since_s
    sway = np.stack([np.sin(angle), up * np.sin(1.7 * angle), 0 * angle], axis=1)
    return np.asarray(places + reach_px * share[:, None] * sway, np.float64)


def person(
    places: Float,
    *dips: tuple[float, float, float],
    still: bool = False,
    roll_deg: Float | None = None,
) -> Person:
    """A person on a path. dips: (from_s, to_s, logit) of intervals with another confidence."""
    logit = np.full(len(places), SUREST)
    for from_s, to_s, value in dips:
        logit[round(from_s * 1000) : round(to_s * 1000)] = value
    return Person(path_px=places, logit=logit, still=still, roll_deg=roll_deg)


def _at(x: float, y: float = 240.0, eye_distance: float = 60.0) -> Place:
    return x, y, eye_distance


SEATED = RestingEyes(*SEAT)
SETTLED_S = 2.0  # after sitting down: the rest is measured, and the neutral position has eased in
HIDDEN = -9.0  # logit of a face that cannot be found
COVERED = 5.0  # logit of a face with a hand in front of an eye
OUT_RIGHT = _at(730.0)
OUT_LEFT = _at(-90.0)


def settled(to_s: float, from_s: float = SETTLED_S, rest: RestingEyes = SEATED) -> Window:
    """The window in which a person has settled, by default the viewer at SEAT."""
    return Window(from_s=from_s, to_s=to_s, rest=rest)


def after(event_s: float, to_s: float, rest: RestingEyes = SEATED, person: int = 0) -> Window:
    """The window after an event."""
    return Window(from_s=event_s, to_s=to_s, rest=rest, person=person, event=True)


def seated(name: str, places: Float, *glitches: Glitch, event_s: float = 0.0) -> Script:
    """A viewer who sits down at SEAT and stays near it. event_s: time of an event."""
    seconds = len(places) / 1000
    windows = [settled(event_s or seconds)] + [after(event_s, seconds)] * (event_s > 0)
    return Script(name=name, people=(person(places),), windows=tuple(windows), glitches=glitches)


def _leaves(away_s: float) -> Script:
    """A viewer who leaves through the right side, and comes back elsewhere from the left."""
    goal = _at(190.0)
    leaving = path(3.2, SEAT, Move(2.2, 3.2, OUT_RIGHT))
    back = path(5.0, OUT_LEFT, Move(0.0, 1.0, goal))
    back_s = 3.2 + away_s
    # until a rest elsewhere, the seat is the old one
    sat_down = [after(back_s + 1.0, back_s + 1.9)] * (away_s < 10.0)
    return Script(
        name=f"back elsewhere after {away_s:g} s",
        people=(person(np.concatenate([leaving, path(away_s, OUT_LEFT), back])),),
        windows=(settled(2.4), *sat_down, after(back_s + 2.0, back_s + 5.0, RestingEyes(*goal))),
    )


def _glitch(name: str, left: float, right: float, frames: int = 1) -> Script:
    """Wrong landmarks at rest and, after 4 s, in motion."""
    glitches = [Glitch(at_s=at_s, left=left, right=right, frames=frames) for at_s in (2.51, 4.24)]
    return seated(name, path(6.0, SEAT, Move(3.5, 5.0, _at(360.0))), *glitches, event_s=2.51)


def _steps(count: int, from_s: float) -> list[Move]:
    """Steps of 50 px at 200 px/s to the right and back, with rests between them."""
    return [
        Move(from_s + k, from_s + 0.25 + k, _at(320.0 + 50.0 * (k % 2 == 0)), even=True)
        for k in range(count)
    ]


SCRIPTS = (
    seated("sits", path(6.0, SEAT)),
    seated("sways at 0.5 Hz", swayed(path(7.0, SEAT), 40.0, 0.5)),
    seated("sways at 1 Hz", swayed(path(6.0, SEAT), 40.0, 1.0)),
    seated("sways at 2 Hz", swayed(path(6.0, SEAT), 25.0, 2.0)),
    seated("steps", path(8.5, SEAT, *_steps(6, 2.0))),
    seated("shakes", swayed(path(5.0, SEAT), 18.0, 3.5, up=0.0)),
    # like the fastest measured head: 17 eye distances per second
    seated("shakes fast", swayed(path(5.0, SEAT), 40.0, 4.0, up=0.0)),
    # out of the zone and back, with the longest stay that is not a new seat
    seated(
        "leans out",
        path(6.0, SEAT, Move(2.5, 3.3, _at(470.0)), Move(3.6, 4.4, SEAT)),
        event_s=4.4,
    ),
    # towards the screen and back
    seated(
        "leans in",
        path(7.5, SEAT, Move(2.5, 3.5, _at(320.0, eye_distance=85.0)), Move(4.5, 5.5, SEAT)),
    ),
    # out of the zone and back, after a stay long enough for a new seat
    Script(
        name="leans out for 2 s",
        people=(person(path(10.0, SEAT, Move(2.5, 3.3, _at(470.0)), Move(5.3, 6.1, SEAT))),),
        windows=(settled(2.5), after(6.1, 10.0)),
    ),
    Script(
        name="moves to another seat",
        people=(person(path(8.0, SEAT, Move(2.5, 3.5, _at(480.0)))),),
        windows=(settled(2.4), after(3.5, 8.0, RestingEyes(480.0, 240.0, 60.0))),
    ),
    # the viewer leaves; the tracker follows a neighbour, who then sits down in the empty seat
    Script(
        name="another sits down in the left seat",
        people=(
            person(path(11.0, SEAT, Move(2.2, 3.2, OUT_RIGHT))),
            person(path(11.0, _at(170.0, 230.0, 52.0), Move(6.0, 7.0, SEAT))),
        ),
        windows=(settled(2.3), after(7.0, 11.0, person=1)),
    ),
    # from 0.63 m to 0.3 m and back
    seated(
        "comes to 0.3 m",
        path(7.5, SEAT, Move(2.5, 3.7, _at(320.0, eye_distance=126.0)), Move(5.0, 6.2, SEAT)),
    ),
    # the head, by 60 degrees to the side and back
    Script(
        name="rolls the head",
        people=(
            person(
                path(8.0, SEAT),
                roll_deg=path(
                    8.0,
                    (0.0, 0.0, 0.0),
                    Move(2.5, 4.0, (60.0, 0.0, 0.0)),
                    Move(5.5, 7.0, (0.0, 0.0, 0.0)),
                )[:, 0],
            ),
        ),
        windows=(settled(8.0),),
    ),
    # through the right side and for good; the view holds and eases to its middle
    Script(
        name="leaves sideways",
        people=(person(path(9.0, SEAT, Move(2.2, 3.2, OUT_RIGHT))),),
        windows=(settled(2.4),),
    ),
    # beyond the zone, half out of the picture, and back to the seat
    Script(
        name="half out of the picture",
        people=(person(path(8.0, SEAT, Move(2.2, 3.0, _at(640.0)), Move(3.6, 4.6, SEAT))),),
        windows=(settled(2.4), after(4.6, 8.0)),
    ),
    # the viewer leans out of the zone and hides; the tracker follows a person behind
    Script(
        name="another takes over",
        people=(
            person(path(9.0, SEAT, Move(2.2, 3.0, _at(400.0))), (3.4, 9.0, HIDDEN)),
            person(path(9.0, _at(500.0, 230.0, 52.0))),
        ),
        windows=(settled(2.3), after(5.2, 9.0, RestingEyes(500.0, 230.0, 52.0), person=1)),
    ),
    _leaves(2.0),
    _leaves(12.0),
    # at 1 m/s, to an empty seat
    Script(
        name="walks in",
        people=(person(path(6.5, _at(-90.0, 250.0), Move(1.0, 1.8, SEAT))),),
        windows=(after(1.0 + SETTLED_S, 6.5),),
        steps_from_s=0.0,
    ),
    # appears at the border of the picture and stays there
    Script(
        name="found at the border",
        people=(person(path(6.0, _at(600.0, 245.0, 55.0)), (0.0, 1.0, HIDDEN)),),
        windows=(settled(6.0, 1.0 + SETTLED_S, RestingEyes(600.0, 245.0, 55.0)),),
        steps_from_s=0.0,
    ),
    # the confidence falls while the head moves at 200 px/s
    Script(
        name="confidence falls while moving",
        people=(
            person(
                path(6.0, SEAT, Move(2.5, 2.9, _at(370.0)), Move(3.5, 3.9, SEAT)),
                (2.7, 3.1, 6.0),
                (3.7, 4.1, 6.0),
            ),
        ),
        windows=(settled(2.6), after(4.2, 6.0)),
    ),
    # no face for a time, and then 30 px aside
    Script(
        name="hidden for 0.3 s",
        people=(person(path(6.0, SEAT, Move(2.5, 2.8, _at(350.0))), (2.5, 2.8, HIDDEN)),),
        windows=(settled(2.5), after(2.8, 6.0)),
    ),
    _glitch("one frame wrong by .12", 0.12, 0.12),
    _glitch("one frame wrong by .58", 0.58, 0.58),
    _glitch("one eye wrong by .28", 0.28, 0.0),
    _glitch("the right eye wrong by .28", 0.0, 0.28),
    _glitch("two frames wrong by .58", 0.58, 0.58, 2),
    # it covers the left eye and pulls its landmarks, first with a still and then with a moving head
    Script(
        name="a hand before an eye",
        people=(
            person(
                path(9.0, SEAT, Move(4.8, 6.3, _at(380.0))),
                (2.5, 3.5, COVERED),
                (5.2, 6.2, COVERED),
            ),
        ),
        windows=(settled(2.5), after(2.5, 4.8), after(4.8, 9.0)),
        glitches=(
            Glitch(at_s=2.5, left=0.25, right=0.05, frames=30),
            Glitch(at_s=5.2, left=0.25, right=0.05, frames=30),
        ),
    ),
    # a person nearer than the viewer, who briefly hides the viewer
    Script(
        name="a nearer passer-by",
        people=(
            person(path(8.0, SEAT), (3.8, 4.2, HIDDEN)),
            person(
                path(
                    8.0,
                    _at(-150.0, 250.0, 85.0),
                    Move(3.0, 5.0, _at(790.0, 250.0, 85.0), even=True),
                )
            ),
        ),
        windows=(settled(3.8), after(4.2, 8.0)),
    ),
    # a neighbour at the viewer's distance stays; another person passes behind
    Script(
        name="two people and a passer-by",
        people=(
            person(swayed(path(8.0, SEAT), 30.0, 0.5)),
            person(path(8.0, _at(520.0, 250.0, 55.0))),
            person(path(8.0, _at(30.0, 200.0, 34.0), Move(2.5, 6.5, _at(610.0, 200.0, 34.0)))),
        ),
        windows=(settled(8.0),),
    ),
    # so far that one eye is beyond the zone, and for good
    Script(
        name="rests half out of the zone",
        people=(person(path(9.0, SEAT, Move(2.5, 3.5, _at(401.0)))),),
        windows=(settled(2.4), after(3.5, 9.0, RestingEyes(401.0, 240.0, 60.0))),
    ),
    # the viewer leaves; a neighbour, who waited in the picture, sits down 30 mm beside the seat
    Script(
        name="the next person sits beside the seat",
        people=(
            person(path(12.0, SEAT, Move(3.2, 4.2, OUT_RIGHT))),
            person(path(12.0, _at(170.0, 230.0, 52.0), Move(6.0, 7.0, _at(349.0)))),
        ),
        windows=(settled(3.2), after(7.0, 12.0, RestingEyes(349.0, 240.0, 60.0), person=1)),
    ),
    # through the right side, and back from there to a nearer place
    Script(
        name="back nearer after 2 s",
        people=(
            person(
                np.concatenate(
                    [
                        path(5.2, SEAT, Move(2.2, 3.2, OUT_RIGHT)),
                        path(6.0, OUT_RIGHT, Move(0.0, 1.0, _at(500.0, eye_distance=85.0))),
                    ]
                )
            ),
        ),
        windows=(settled(2.4), after(6.2, 11.2, RestingEyes(500.0, 240.0, 85.0))),
    ),
    # one person is found as soon as the other one is hidden
    Script(
        name="a child and an adult in turn",
        people=(
            person(path(12.0, _at(250.0, 200.0)), (4.0, 8.0, HIDDEN)),
            person(path(12.0, _at(420.0, 300.0, 45.0)), (0.0, 4.0, HIDDEN), (8.0, 12.0, HIDDEN)),
        ),
        windows=(
            settled(4.0, rest=RestingEyes(250.0, 200.0, 60.0)),
            after(4.0, 8.0, RestingEyes(420.0, 300.0, 45.0), person=1),
            after(8.0, 12.0, RestingEyes(250.0, 200.0, 60.0)),
        ),
    ),
    # the tracker finds a portrait on the wall; then a viewer sits down next to it, and moves
    Script(
        name="portrait first",
        people=(
            person(path(20.0, _at(330.0, 180.0, 42.0)), still=True),
            person(
                swayed(
                    path(20.0, _at(-90.0, 270.0, 52.0), Move(4.0, 5.0, _at(240.0, 270.0, 52.0))),
                    reach_px=15.0,
                    rate_hz=0.5,
                    up=0.0,
                    from_s=7.0,
                )
            ),
        ),
        windows=(after(10.0, 20.0, RestingEyes(240.0, 270.0, 52.0), person=1),),
    ),
)
# sways at 0.7 Hz, then takes steps at 200 px/s
MOVES_ABOUT = seated("moves about", swayed(path(10.0, SEAT, *_steps(4, 6.0)), 40.0, 0.7, to_s=5.5))


def recorded(paths: Sequence[Path]) -> Iterator[Script]:
    """A script for each recorded head track. Raises UserError if one cannot be read."""
    for one in paths:
        places, visible = read_track(one)
        places += (FRAME_PX[0] / 2, FRAME_PX[1] / 2, 0.0)
        rest = RestingEyes(*np.median(places[: round(SETTLED_S * 1000)], axis=0).tolist())
        viewer = Person(path_px=places, logit=np.where(visible, SUREST, HIDDEN))
        window = settled(len(places) / 1000, rest=rest)
        yield Script(name=one.stem, people=(viewer,), windows=(window,))


COLUMNS = "t_s,face,left_x,left_y,right_x,right_y"
SMOOTH_MS = 25.0  # standard deviation of the kernel that separates motion from landmark noise
EYE_DISTANCE_S = 1.0  # the same for the eye distance, which a turning head changes
EYE_DISTANCE_PX = 60.0  # of the simulated viewer, to which every track is scaled
REMEDY = f"give a table with the columns {COLUMNS}"


def read_track(path: Path) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The path (n, 3) of a track at each ms, about (0, 0): x and y of the midpoint of the eyes, and
    the eye distance, scaled to a median of EYE_DISTANCE_PX; and whether there is a face, (n,).

    Raises UserError if the table cannot be read.
    """
    t_s, face, eyes = read_table(path)
    with_face = np.flatnonzero(face)
    if len(with_face) < 2:
        raise UserError(f"{path}: contains no face", REMEDY)
    at_s = t_s[0] + np.arange(int((t_s[-1] - t_s[0]) * 1000)) / 1000
    lx, ly, rx, ry = (np.interp(at_s, t_s[with_face], eyes[with_face, k]) for k in range(4))
    eye_distance = _smoothed(np.hypot(lx - rx, ly - ry), EYE_DISTANCE_S * 1000)
    x = _smoothed((lx + rx) / 2, SMOOTH_MS)
    y = _smoothed((ly + ry) / 2, SMOOTH_MS)
    places = np.stack([x - np.median(x), y - np.median(y), eye_distance], axis=1)
    visible = face[np.searchsorted(t_s, at_s, side="right") - 1]
    return places * (EYE_DISTANCE_PX / float(np.median(eye_distance))), visible


def read_table(path: Path) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.float64]]:
    """Times (n,) in s, whether there is a face, and eyes (n, 4) px. Raises UserError."""
    try:
        head, *lines = path.read_text().splitlines() or [""]
        if head.strip() != COLUMNS:
            raise ValueError("wrong columns")
        rows = np.array(
            [[float(cell.strip() or "nan") for cell in line.split(",")] for line in lines]
        )
        if rows.shape[1:] != (6,):
            raise ValueError("expected six numbers in each row")
        face = rows[:, 1] > 0
        if not (np.isfinite(rows[:, :2]).all() and np.isfinite(rows[face]).all()):
            raise ValueError("only the eyes of a frame without a face may be missing")
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: not a head track: {error}", REMEDY) from None
    return rows[:, 0], face, rows[:, 2:]


def _smoothed(values: NDArray[np.float64], sigma: float) -> NDArray[np.float64]:
    """Smooths with a symmetric kernel, without delay."""
    column = cv2.GaussianBlur(
        values.reshape(-1, 1), (1, 0), sigmaX=0.01, sigmaY=sigma, borderType=cv2.BORDER_REPLICATE
    )
    return np.asarray(column, np.float64).ravel()
