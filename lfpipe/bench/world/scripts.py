"""Scripted viewers: where both eyes of each person are at every millisecond, and what is right.

Lengths are px of a camera picture of 640x480, in which the eyes of somebody at 0.63 m are 60 px
apart; 950 px/s are then 1 m/s. Moves follow the minimum-jerk profile of human movements (Flash and
Hogan 1985), unless they are even.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.world.tracks import read_track
from lfpipe.render.presence import Rest

Float = NDArray[np.float64]
FRAME_PX = (640, 480)
SEAT = (320.0, 240.0, 60.0)  # x and y between the eyes, and their distance
SUREST = 20.0  # logit of the confidence in a face that nothing hides
Place = tuple[float, float, float]


def minimum_jerk(share: Float) -> Float:
    """Shares of the way at shares of the time, both 0 to 1. The largest slope is 1.875."""
    return share**3 * (10 + share * (-15 + 6 * share))


@attrs.frozen(eq=False, kw_only=True)
class Person:
    """path_px: float (n, 3), x and y between the eyes, and their distance, at each ms."""

    path_px: Float
    logit: Float
    """(n,) of the confidence of the landmarks; negative: no face can be found."""
    still: bool = False
    """A portrait: nothing moves, and there is no sensor noise in its place."""

    def eyes_px(self, ms: NDArray[np.int64] | int) -> Float:
        """The true eyes (..., 2, 2), left first, at these ms."""
        place = self.path_px[np.minimum(ms, len(self.path_px) - 1)]
        half = place[..., 2] / 2
        x = np.stack([place[..., 0] + half, place[..., 0] - half], axis=-1)
        return np.stack([x, np.broadcast_to(place[..., 1:2], x.shape)], axis=-1)


@attrs.frozen(kw_only=True)
class Window:
    """A time in which the right picture is known: the eyes of a person, from this rest."""

    from_s: float
    to_s: float
    rest: Rest
    person: int = 0
    event: bool = False
    """It begins with an event, from which the time until the picture is right counts."""


@attrs.frozen(kw_only=True)
class Glitch:
    """Landmarks that are wrong in some frames, by shares of the distance between the eyes."""

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
    """Rising; errors count in them."""
    glitches: tuple[Glitch, ...] = ()
    steps_from_s: float = 1.0
    """Steps count from here on: by default, after depth has appeared with the first face."""

    @property
    def count_ms(self) -> int:
        return len(self.people[0].path_px)


@attrs.frozen
class Move:
    """A move that ends at a place. even: at constant speed."""

    from_s: float
    to_s: float
    place: Place
    even: bool = False


def path(seconds: float, start: Place, *moves: Move) -> Float:
    """A path of float (n, 3), a place for each ms."""
    t_s = np.arange(round(seconds * 1000)) / 1000
    places = np.tile(np.array(start), (len(t_s), 1))
    for move in moves:
        share = np.clip((t_s - move.from_s) / (move.to_s - move.from_s), 0, 1)[:, None]
        places += (share if move.even else minimum_jerk(share)) * (move.place - places[-1])
    return places


def person(places: Float, *dips: tuple[float, float, float], still: bool = False) -> Person:
    """A person on a path. dips: (from_s, to_s, logit) of times of other confidence."""
    logit = np.full(len(places), SUREST)
    for from_s, to_s, value in dips:
        logit[round(from_s * 1000) : round(to_s * 1000)] = value
    return Person(path_px=places, logit=logit, still=still)


def sway(seconds: float, reach_px: float, rate_hz: float, up: float = 0.3) -> Float:
    """A sway about SEAT from 2 s on. up: its height as a share of its width."""
    places = path(seconds, SEAT)
    t_s = np.maximum(np.arange(len(places)) / 1000 - 2.0, 0.0)
    grown = minimum_jerk(np.minimum(t_s, 1.0)) * reach_px
    angle = 2 * math.pi * rate_hz * t_s
    places[:, 0] += grown * np.sin(angle)
    places[:, 1] += grown * up * np.sin(1.7 * angle)
    return places


SEATED = Rest(*SEAT)
SETTLED_S = 2.0  # after somebody sat down: the rest is measured, and the neutral position eased


def seated(name: str, places: Float, *glitches: Glitch, event_s: float = 0.0) -> Script:
    """A viewer who sits down at SEAT and stays near it. event_s: of what happens to them."""
    seconds = len(places) / 1000
    windows = [Window(from_s=SETTLED_S, to_s=event_s or seconds, rest=SEATED)]
    if event_s:
        windows.append(Window(from_s=event_s, to_s=seconds, rest=SEATED, event=True))
    return Script(name=name, people=(person(places),), windows=tuple(windows), glitches=glitches)


def _at(x: float, y: float = 240.0, apart: float = 60.0) -> Place:
    return x, y, apart


OUT_RIGHT = _at(730.0)
OUT_LEFT = _at(-90.0)


def _steps() -> Script:
    """Steps of 50 px at 200 px/s, with rests between them."""
    moves = [
        Move(2.0 + k, 2.25 + k, _at(320.0 + (50.0 if k % 2 == 0 else 0.0), 240.0), even=True)
        for k in range(6)
    ]
    return seated("steps", path(8.5, SEAT, *moves))


def _leans() -> Script:
    """Out of the zone and back, with as long a stay as is no new seat."""
    moves = Move(2.5, 3.3, _at(470.0)), Move(3.6, 4.4, SEAT)
    return seated("leans out", path(6.0, SEAT, *moves), event_s=4.4)


def _nearer() -> Script:
    """Towards the screen and back."""
    moves = Move(2.5, 3.5, _at(320.0, 240.0, 85.0)), Move(4.5, 5.5, SEAT)
    return seated("leans in", path(7.5, SEAT, *moves))


def _leaves(away_s: float) -> Script:
    """Leaves through the right side, and comes back elsewhere from the left."""
    goal = _at(190.0)
    back_s = 3.2 + away_s
    seconds = back_s + 5.0
    places = path(seconds, SEAT, Move(2.2, 3.2, OUT_RIGHT), Move(back_s, back_s + 1.0, goal))
    gone = slice(round(3.2 * 1000), round(back_s * 1000))
    places[gone] = OUT_LEFT
    back = path(seconds - back_s, OUT_LEFT, Move(0.0, 1.0, goal))
    places[round(back_s * 1000) :] = back
    windows = [Window(from_s=SETTLED_S, to_s=2.4, rest=SEATED)]
    if away_s < 10.0:  # until a rest elsewhere, the seat is the old one
        windows.append(Window(from_s=back_s + 1.0, to_s=back_s + 1.9, rest=SEATED, event=True))
    rest = Rest(*goal)
    windows.append(Window(from_s=back_s + 2.0, to_s=seconds, rest=rest, event=True))
    return Script(
        name=f"back elsewhere after {away_s:g} s", people=(person(places),), windows=tuple(windows)
    )


def _leaves_for_good() -> Script:
    """Leaves through the right side; the view holds and eases to its middle."""
    places = path(9.0, SEAT, Move(2.2, 3.2, OUT_RIGHT))
    windows = (Window(from_s=SETTLED_S, to_s=2.4, rest=SEATED),)
    return Script(name="leaves sideways", people=(person(places),), windows=windows)


def _found_again() -> Script:
    """Leaves beyond the zone, is half out of the picture, and comes back to the seat."""
    places = path(8.0, SEAT, Move(2.2, 3.0, _at(640.0)), Move(3.6, 4.6, SEAT))
    windows = (
        Window(from_s=SETTLED_S, to_s=2.4, rest=SEATED),
        Window(from_s=4.6, to_s=8.0, rest=SEATED, event=True),
    )
    return Script(name="half out of the picture", people=(person(places),), windows=windows)


def _taken_over() -> Script:
    """The viewer leans beyond the zone and hides; another, who stood behind, is followed."""
    leaning = path(9.0, SEAT, Move(2.2, 3.0, _at(400.0)))
    other = path(9.0, _at(500.0, 230.0, 52.0))
    rest = Rest(500.0, 230.0, 52.0)
    windows = (
        Window(from_s=SETTLED_S, to_s=2.3, rest=SEATED),
        Window(from_s=5.2, to_s=9.0, rest=rest, person=1, event=True),
    )
    people = person(leaning, (3.4, 9.0, -9.0)), person(other)
    return Script(name="another takes over", people=people, windows=windows)


def _two_people() -> Script:
    """A neighbour as near as the viewer stays beside; somebody passes behind."""
    places = sway(8.0, 30.0, 0.5)
    neighbour = person(path(8.0, _at(520.0, 250.0, 55.0)))
    passer = person(path(8.0, _at(30.0, 200.0, 34.0), Move(2.5, 6.5, _at(610.0, 200.0, 34.0))))
    windows = (Window(from_s=SETTLED_S, to_s=8.0, rest=SEATED),)
    people = person(places), neighbour, passer
    return Script(name="two people and a passer-by", people=people, windows=windows)


def _portrait() -> Script:
    """A portrait on the wall is found first; then a viewer sits down beside it, and moves."""
    portrait = person(path(20.0, _at(330.0, 180.0, 42.0)), still=True)
    home = _at(240.0, 270.0, 52.0)
    places = path(20.0, _at(-90.0, 270.0, 52.0), Move(4.0, 5.0, home))
    t_s = np.maximum(np.arange(len(places)) / 1000 - 7.0, 0.0)
    places[:, 0] += 15.0 * np.minimum(t_s, 1.0) * np.sin(math.pi * t_s)
    rest = Rest(*home)
    windows = (Window(from_s=10.0, to_s=20.0, rest=rest, person=1, event=True),)
    people = portrait, person(places)
    return Script(name="portrait first", people=people, windows=windows)


def _walks_in() -> Script:
    """Comes in at 1 m/s to an empty seat."""
    start = _at(-90.0, 250.0)
    seconds = 6.5
    places = path(seconds, start, Move(1.0, 1.8, SEAT))
    windows = (Window(from_s=1.0 + SETTLED_S, to_s=seconds, rest=SEATED, event=True),)
    people = (person(places),)
    return Script(name="walks in", people=people, windows=windows, steps_from_s=0.0)


def _found_at_border() -> Script:
    """A face appears at the border of the picture and stays there."""
    place = _at(600.0, 245.0, 55.0)
    places = path(6.0, place)
    windows = (Window(from_s=1.0 + SETTLED_S, to_s=6.0, rest=Rest(*place)),)
    hidden = person(places, (0.0, 1.0, -9.0))
    return Script(name="found at the border", people=(hidden,), windows=windows, steps_from_s=0.0)


def _unsure() -> Script:
    """The confidence falls while the head moves at 200 px/s."""
    places = path(6.0, SEAT, Move(2.5, 2.9, _at(370.0)), Move(3.5, 3.9, SEAT))
    windows = (
        Window(from_s=SETTLED_S, to_s=2.6, rest=SEATED),
        Window(from_s=4.2, to_s=6.0, rest=SEATED, event=True),
    )
    people = (person(places, (2.7, 3.1, 6.0), (3.7, 4.1, 6.0)),)
    return Script(name="confidence falls while moving", people=people, windows=windows)


def _hidden() -> Script:
    """No face for 0.3 s; then it is 30 px aside."""
    places = path(6.0, SEAT, Move(2.5, 2.8, _at(350.0)))
    windows = (
        Window(from_s=SETTLED_S, to_s=2.5, rest=SEATED),
        Window(from_s=2.8, to_s=6.0, rest=SEATED, event=True),
    )
    people = (person(places, (2.5, 2.8, -9.0)),)
    return Script(name="hidden for 0.3 s", people=people, windows=windows)


def _glitch(name: str, left: float, right: float, frames: int = 1) -> Script:
    """Wrong landmarks at rest and, after 4 s, in motion."""
    places = sway(6.0, 30.0, 0.5)
    places[:3500] = SEAT
    places[3500:] = path(2.5, SEAT, Move(0.0, 1.5, _at(360.0)))
    glitches = [Glitch(at_s=at_s, left=left, right=right, frames=frames) for at_s in (2.51, 4.24)]
    return seated(name, places, *glitches, event_s=2.51)


SCRIPTS: tuple[Callable[[], Script], ...] = (
    lambda: seated("sits", path(6.0, SEAT)),
    lambda: seated("sways at 0.5 Hz", sway(7.0, 40.0, 0.5)),
    lambda: seated("sways at 1 Hz", sway(6.0, 40.0, 1.0)),
    lambda: seated("sways at 2 Hz", sway(6.0, 25.0, 2.0)),
    _steps,
    lambda: seated("shakes", sway(5.0, 18.0, 3.5, 0.0)),
    _leans,
    _nearer,
    _leaves_for_good,
    _found_again,
    _taken_over,
    lambda: _leaves(2.0),
    lambda: _leaves(12.0),
    _walks_in,
    _found_at_border,
    _unsure,
    _hidden,
    lambda: _glitch("one frame wrong by .12", 0.12, 0.12),
    lambda: _glitch("one frame wrong by .58", 0.58, 0.58),
    lambda: _glitch("one eye wrong by .28", 0.28, 0.0),
    lambda: _glitch("two frames wrong by .58", 0.58, 0.58, 2),
    _two_people,
    _portrait,
)


def moving() -> Script:
    """Sways at 0.7 Hz, then takes steps at 200 px/s."""
    steps = [Move(6.0 + k, 6.25 + k, _at(320.0 + 50.0 * (k % 2 == 0)), even=True) for k in range(4)]
    places = path(10.0, SEAT, *steps)
    swaying = sway(10.0, 40.0, 0.7) - SEAT
    t_s = np.arange(len(places)) / 1000
    places += swaying * minimum_jerk(np.clip(5.5 - t_s, 0, 1))[:, None]
    return seated("moves about", places)


def scripts() -> Iterator[Script]:
    """All of SCRIPTS."""
    return (make() for make in SCRIPTS)


def recorded(paths: Sequence[Path]) -> Iterator[Script]:
    """A script for each recorded head track. Raises UserError if one cannot be read."""
    for one in paths:
        places, visible = read_track(one)
        places += (FRAME_PX[0] / 2, FRAME_PX[1] / 2, 0.0)
        rest = Rest(*np.median(places[: round(SETTLED_S * 1000)], axis=0).tolist())
        window = Window(from_s=SETTLED_S, to_s=len(places) / 1000, rest=rest)
        viewer = Person(path_px=places, logit=np.where(visible, SUREST, -9.0))
        yield Script(name=one.stem, people=(viewer,), windows=(window,))
