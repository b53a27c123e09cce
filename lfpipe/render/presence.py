"""The viewer's presence: a state machine that decides when to measure the resting position, and the easing of the view.

    state      when                                                    then
    nobody     a face                                                  arriving
    arriving   it rests                                                seated, measured
    seated     it rests with both eyes beyond the grid                 seated, measured again
    arriving, seated, exchanged
               another face took over                                  exchanged
               no face                                                 lost
    exchanged  it rests                                                seated, measured again
               the face of a seat left less than RETURN_S ago          seated, as measured then
    lost       a face, before ABSENT_S have passed                     as before the loss
               no face for ABSENT_S                                    nobody

"Rests": for REST_S and REST_FRAMES the eyes stay within REST_SPAN of a point, and their distance from each other within
REST_DEPTH. "Another face took over": a face of another track follows within GAP_S of the last; a longer gap means that the camera
stood still. A face is that of a seat if it is where the seat's face was last, and as large (RETURN_SPAN, RETURN_DEPTH). The
measurement is the mean over the rest of the eyes' position and of their distance from each other, which gives
the viewer's distance. While no face is seen, and when one returns, the view holds, eases to neutral and eases back; it never
jumps.
"""

import enum
import math
from typing import NamedTuple

from lfpipe.eyes import Eyes
from lfpipe.render.viewpoint import Position
from lfpipe.transport.clock import SECOND_NS

REST_S, REST_FRAMES = (
    1.0,
    8,
)  # who passes by does not stand that long; at 8 Hz and more the second decides
REST_SPAN = 0.3  # of the distance between the eyes: 2 cm
REST_DEPTH = 0.06  # of the same
ABSENT_S = 10.0  # who is back sooner sits as before
GAP_S = 0.5  # as long as filters remember a face
RETURN_S = 30.0  # a passer-by is gone by then
RETURN_SPAN, RETURN_DEPTH = (
    1.0,
    0.2,
)  # of the distance between the eyes; who sits down again sits a little aside

HOLD_S = 3.0  # a hand before the face, a glance aside, a dropped pen: a viewer who is back soon finds the picture they left
AWAY_S = 0.8  # time constant of easing to neutral: nobody is looking, no hurry
BACK_S = 0.03  # time constant of easing to eyes found (again): over within 0.15 s, yet a visible move and no jump
LARGEST_STEP = 0.4  # views between two pictures at 60 Hz while easing: a far face takes longer


class ViewerState(enum.IntEnum):
    """The state, numbered as in the status table."""

    NOBODY = 0
    ARRIVING = 1
    SEATED = 2
    LOST = 3
    EXCHANGED = 4

    @property
    def word(self) -> str:
        return self.name.lower()


class Rest(NamedTuple):
    """The position of a resting viewer. x_px, y_px: the point between the eyes; apart_px: the distance between them."""

    x_px: float
    y_px: float
    apart_px: float

    def holds(self, other: "Rest", span: float, depth: float) -> bool:
        """Whether other is within span of here, and as large but for depth; both are shares of the distance between the eyes."""
        aside_px = max(abs(other.x_px - self.x_px), abs(other.y_px - self.y_px))
        return (
            aside_px <= span * self.apart_px
            and abs(other.apart_px - self.apart_px) <= depth * self.apart_px
        )


class Seat(NamedTuple):
    """A seat whose viewer another face has replaced. last: where the viewer was seen last. rest: as measured."""

    last: Rest
    rest: Rest
    t_ns: int


class Presence:
    """The state machine. Call `update` once for every tracked frame."""

    def __init__(self) -> None:
        self.state = ViewerState.NOBODY
        self._before = ViewerState.ARRIVING  # the state to return to when the face is found again
        self._generation = 0
        self._t_ns = self._since_ns = 0  # of the last face; when its rest began
        self._first: Rest | None = None  # where the rest began
        self._sums, self._count = (0.0, 0.0, 0.0), 0  # of x, y and apart since then
        self._last: Rest | None = None  # of the viewer who is followed
        self._measured: Rest | None = None  # the same
        self._left: Seat | None = None
        self.returned = False  # whether the last frame's face is back in its seat

    def update(
        self, t_ns: int, here: Rest | None, generation: int = 0, beyond: bool = False
    ) -> Rest | None:
        """Processes the frame of t_ns. here: position of the eyes, None without a face; generation: of the face's track; beyond:
        both eyes are beyond the grid. Returns the rest that gives neutral position and distance when it is time to measure them,
        else None.
        """
        state, self.returned = self.state, False
        if here is None:
            self._first = None
            if state not in (ViewerState.NOBODY, ViewerState.LOST):
                self._before, self.state = state, ViewerState.LOST
            elif state is ViewerState.LOST and t_ns - self._t_ns >= ABSENT_S * SECOND_NS:
                self.state = ViewerState.NOBODY
            return None
        gap_ns, self._t_ns = t_ns - self._t_ns, t_ns
        other, self._generation = generation != self._generation, generation
        if state is ViewerState.NOBODY or (
            state is ViewerState.LOST and gap_ns >= ABSENT_S * SECOND_NS
        ):
            self.state = ViewerState.ARRIVING
        elif state is ViewerState.LOST:
            self.state = self._before
        elif other and gap_ns < GAP_S * SECOND_NS:
            seat = self._left
            if self._last is not None and self._measured is not None:
                self._left = Seat(self._last, self._measured, t_ns)
            recent = seat is not None and t_ns - seat.t_ns < RETURN_S * SECOND_NS
            if seat is not None and recent and seat.last.holds(here, RETURN_SPAN, RETURN_DEPTH):
                self.state, self._first, self._last, self._measured = (
                    ViewerState.SEATED,
                    None,
                    here,
                    seat.rest,
                )
                self.returned = True
                return seat.rest
            self.state, self._measured = ViewerState.EXCHANGED, None
        self._last = here
        rest = self._rest(t_ns, here, other)
        if rest is None or (self.state is ViewerState.SEATED and not beyond):
            return None
        self.state, self._first, self._measured = ViewerState.SEATED, None, rest
        return rest

    def _rest(self, t_ns: int, here: Rest, other: bool) -> Rest | None:
        """The mean since the eyes came to rest, if that is at least REST_S ago. other: another face than before."""
        if other or self._first is None or not self._first.holds(here, REST_SPAN, REST_DEPTH):
            self._first, self._since_ns, self._sums, self._count = here, t_ns, (0.0, 0.0, 0.0), 0
        x, y, apart = self._sums
        self._sums = x, y, apart = x + here.x_px, y + here.y_px, apart + here.apart_px
        self._count += 1
        if t_ns - self._since_ns < REST_S * SECOND_NS or self._count < REST_FRAMES:
            return None
        return Rest(x / self._count, y / self._count, apart / self._count)


class EyeEasing:
    """Follows the eyes, in px of the camera picture.

    When the target jumps (a loss of HOLD_S, a face found again, another face), the jump becomes an offset that decays as (1 + s)
    exp(-s), s = t / time constant: no jump, and no kink at its start. The closed form holds for any time step.
    """

    def __init__(self) -> None:
        self._eased: Eyes | None = None
        self._offset: Eyes | None = None
        self._since_ns, self._fade_s = 0, BACK_S
        self._aim: int | None = None  # generation followed; None: neutral
        self._lost_ns: int | None = None

    def at(
        self,
        t_ns: int,
        eyes: Eyes | None,
        neutral: Eyes,
        generation: int = 0,
        view_px: float = math.inf,
    ) -> Eyes:
        """The position to show at t_ns (not decreasing). eyes: None while there is no face. neutral: the position without one.

        generation: counts the tracks of a face; a new number is another face, or the same after a loss. view_px: px per view.
        """
        if eyes is None:
            self._lost_ns = t_ns if self._lost_ns is None else self._lost_ns
            if (
                self._aim is not None
                and self._eased is not None
                and t_ns - self._lost_ns < HOLD_S * SECOND_NS
            ):
                return self._eased
            if self._aim is not None:
                self._turn(t_ns, None, neutral, AWAY_S, view_px)
            eyes = neutral
        else:
            self._eased = self._eased or neutral
            if self._lost_ns is not None or generation != self._aim:
                self._turn(t_ns, generation, eyes, BACK_S, view_px)
            self._lost_ns = None
        if self._offset is not None:
            s = max(t_ns - self._since_ns, 0) / 1e9 / self._fade_s
            rest = (1 + s) * math.exp(-s) if s < 700 else 0.0
            (lx, ly, rx, ry), (off_lx, off_ly, off_rx, off_ry) = eyes, self._offset
            eyes = lx + off_lx * rest, ly + off_ly * rest, rx + off_rx * rest, ry + off_ry * rest
        self._eased = eyes
        return eyes

    def shift(self, x_px: float, y_px: float) -> None:
        """Moves the position shown with its coordinates' origin: the next target is eased to from there."""
        if self._eased is not None:
            lx, ly, rx, ry = self._eased
            self._eased = lx + x_px, ly + y_px, rx + x_px, ry + y_px

    def _turn(
        self, t_ns: int, aim: int | None, target: Eyes, fade_s: float, view_px: float
    ) -> None:
        """Changes the target: the offset is the position shown now minus the new target."""
        self._aim, self._since_ns, self._fade_s = aim, t_ns, fade_s
        if self._eased is None:
            return
        (lx, ly, rx, ry), (to_lx, to_ly, to_rx, to_ry) = self._eased, target
        self._offset = off = lx - to_lx, ly - to_ly, rx - to_rx, ry - to_ry
        # the steepest slope of (1 + s) exp(-s) is 1 / e
        self._fade_s = max(
            fade_s, max(map(abs, off)) / max(view_px, 1e-9) / (60 * math.e * LARGEST_STEP)
        )


PERIOD_COLS_S, PERIOD_ROWS_S = (
    17.0,
    29.0,
)  # no common multiple within eight minutes: no visible loop
REACH = 0.7  # of the way from the middle of the grid to its edge
APART_VIEWS = 1.0  # at most, between the eyes, before any eyes were seen
GROW_S, FADE_S = (
    2.0,
    0.25,
)  # time constants: away from the last viewer's place, and to the eyes of the next one
STILL = 1e-3  # a smaller share of the motion counts as none


class IdleMotion:
    """An exhibition's picture: viewpoints sway slowly through the grid while nobody is there, and are unchanged with a viewer."""

    def __init__(self) -> None:
        self._share = 0.0
        self._t_ns = self._start_ns = 0

    def moved(
        self,
        left: Position,
        right: Position,
        grid: tuple[int, int],
        t_ns: int,
        alone: bool,
        whole: bool = False,
    ) -> tuple[Position, Position]:
        """The viewpoints at t_ns (not decreasing), within grid (rows, cols). alone: nobody is there. whole: only stored views."""
        dt_s, self._t_ns = max(t_ns - (self._t_ns or t_ns), 0) / 1e9, t_ns
        if not self._share:
            self._start_ns = t_ns
        self._share += ((1.0 if alone else 0.0) - self._share) * -math.expm1(
            -dt_s / (GROW_S if alone else FADE_S)
        )
        if not alone and self._share < STILL:
            self._share = 0.0
        if not self._share:
            return left, right
        t_s, (rows, cols) = (t_ns - self._start_ns) / 1e9, grid
        row = left[0] + self._share * REACH * (rows - 1) / 2 * math.sin(
            math.tau * t_s / PERIOD_ROWS_S
        )
        across = self._share * REACH * (cols - 1) / 2 * math.sin(math.tau * t_s / PERIOD_COLS_S)
        apart = self._share * min(APART_VIEWS, (cols - 1) / 2) / 2 if left == right else 0.0
        places = [(row, left[1] + across - apart), (row, right[1] + across + apart)]
        kept = [(min(max(r, 0.0), rows - 1.0), min(max(c, 0.0), cols - 1.0)) for r, c in places]
        if whole:
            kept = [(math.floor(r + 0.5), math.floor(c + 0.5)) for r, c in kept]
        return kept[0], kept[1]
