"""The viewer's presence: a state machine that decides when to measure the resting position, and the
easing of the view.

    state      when                                                    then
    nobody     a face                                                  arriving
    arriving   it rests                                                seated, measured
    seated     it rests beyond the grid                                seated, measured again
               it rests for the first time in a former seat, or after  seated, measured again
               a loss of HOLD_S, and more than REST_SPAN beside it
               it settles beyond the grid in a seat that was left      seated, as measured then
               less than RETURN_S ago
               it was just found beyond the grid and is still          exchanged
    arriving, seated, exchanged
               another face took over                                  exchanged
               no face                                                 lost
    exchanged  it rests                                                seated, measured again
               the face of a seat left less than RETURN_S ago, or      seated, as measured then
               any face where that seat was measured
    lost       a face, before ABSENT_S have passed                     as before the loss
               no face for ABSENT_S                                    nobody

"Rests": for REST_S and REST_FRAMES, the eyes stay within REST_SPAN of a point, and the eye distance
within REST_DEPTH. "Settles": the same for SETTLED_S and SETTLED_FRAMES. "Another face took over": a
face of another track follows within MAX_STEP_NS of the last; a longer gap means that the camera
paused. A face belongs to a seat if it has the last position and size of the seat's face
(RETURN_SPAN, RETURN_DEPTH). The measurement is the mean, over the rest, of the eyes' position and
of the eye distance, which gives the viewer's distance. Without a face, the view holds, then glides
to neutral; when a face returns, it is eased back. It never jumps.
"""

import enum
import math
from collections.abc import Callable
from typing import NamedTuple

from lfpipe.eyes import MAX_STEP_NS
from lfpipe.render.synthesis.viewpoint import Place
from lfpipe.transport.ring import SECOND_NS

# passers-by are not still for that long; at 8 Hz and more, the second limit decides
REST_S, REST_FRAMES = 1.0, 8
REST_SPAN = 0.3  # of the eye distance: 2 cm
REST_DEPTH = 0.06  # of the eye distance
ABSENT_S = 10.0  # a viewer who returns sooner keeps the measurement
# people who walk are not still for that long: until a rest, the neutral place may follow the eyes
SETTLED_S, SETTLED_FRAMES = 0.2, 4
RETURN_S = 30.0  # a passer-by is gone by then
# of the eye distance: people who sit down again are slightly displaced
RETURN_SPAN, RETURN_DEPTH = 1.0, 0.2
FOUND_S = 2.0  # time for which a face counts as just found

# a hand in front of the face, a glance aside, a dropped pen:
# a viewer who returns soon finds the picture unchanged
HOLD_S = 3.0
AWAY_S = 0.8  # time constant of easing to neutral: not urgent without a viewer
# Views between two pictures at EASED_HZ beyond the eyes' motion: a visible move, but no jump. From
# one end of the usual grid to the other within half a second.
EASED_VIEWS, EASED_HZ = 0.3, 60.0


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


class RestingEyes(NamedTuple):
    """The position of a resting viewer."""

    x_px: float
    """Of the midpoint of the eyes."""
    y_px: float
    """Of the midpoint of the eyes."""
    eye_distance_px: float

    def contains(self, other: "RestingEyes", span: float, depth: float) -> bool:
        """Whether other is within span of here, and of equal size within depth; both are shares of
        the eye distance.
        """
        aside_px = max(abs(other.x_px - self.x_px), abs(other.y_px - self.y_px))
        return (
            aside_px <= span * self.eye_distance_px
            and abs(other.eye_distance_px - self.eye_distance_px) <= depth * self.eye_distance_px
        )


class Seat(NamedTuple):
    """A seat that a viewer left, by moving or because another face took over."""

    last: RestingEyes
    """The last position of the viewer."""
    rest: RestingEyes
    """The measured position."""
    t_ns: int


class Presence:
    """The state machine. Call `update` once for every tracked frame."""

    def __init__(self) -> None:
        self.state = ViewerState.NOBODY
        self._before = ViewerState.ARRIVING  # the state to return to when the face is found again
        self._generation = 0
        self._t_ns = self._since_ns = 0  # of the last face; when its rest began
        self._found_ns = -round(FOUND_S * SECOND_NS)  # when the last loss ended
        self._first: RestingEyes | None = None  # where the rest began
        self._sums, self._count = RestingEyes(0.0, 0.0, 0.0), 0  # of the eyes since then
        self._last: RestingEyes | None = None  # of the followed viewer
        self._measured: RestingEyes | None = None  # the same
        self._left: Seat | None = None
        self._unconfirmed = False  # whether the seat is a former one, where nobody has rested since
        self.settled = False  # whether the face of the last frame is still, even briefly

    def update(
        self, t_ns: int, here: RestingEyes | None, generation: int = 0, beyond: bool = False
    ) -> RestingEyes | None:
        """Processes the frame of t_ns. here: position of the eyes, None without a face; generation:
        of the face's track; beyond: they are beyond the grid. Returns the rest that gives
        neutral position and distance when it is time to measure them, else None.
        """
        state = self.state
        self.settled = False
        if here is None:
            self._first = None
            if state not in (ViewerState.NOBODY, ViewerState.LOST):
                self._before = state
                self.state = ViewerState.LOST
            elif state is ViewerState.LOST and t_ns - self._t_ns >= ABSENT_S * SECOND_NS:
                self.state = ViewerState.NOBODY
            return None
        gap_ns = t_ns - self._t_ns
        self._t_ns = t_ns
        other, self._generation = generation != self._generation, generation
        if state is ViewerState.NOBODY or (
            state is ViewerState.LOST and gap_ns >= ABSENT_S * SECOND_NS
        ):
            self.state = ViewerState.ARRIVING
        elif state is ViewerState.LOST:
            self.state = self._before
            self._found_ns = t_ns
            self._unconfirmed |= gap_ns >= HOLD_S * SECOND_NS
        elif other and gap_ns < MAX_STEP_NS:
            seat = self._recent_seat(t_ns)
            self._leave(t_ns)
            if seat is not None and seat.last.contains(here, RETURN_SPAN, RETURN_DEPTH):
                return self._return(seat, here)
        self._last = here
        rest = self._rest(t_ns, here, other)
        just_found = t_ns - self._found_ns < FOUND_S * SECOND_NS
        if self.state is ViewerState.SEATED and beyond and self.settled and just_found:
            self._leave(t_ns)
        seat = self._recent_seat(t_ns)
        if seat is not None and self._is_back(seat, here, beyond):
            return self._return(seat, here)
        if rest is None:
            return None
        former, self._unconfirmed = self._unconfirmed, False
        was = self._measured
        same = not former or (was is not None and was.contains(rest, REST_SPAN, RETURN_DEPTH))
        if self.state is ViewerState.SEATED and same and not beyond:
            return None
        self._remember(t_ns)
        self.state = ViewerState.SEATED
        self._first = None
        self._measured = rest
        return rest

    def _is_back(self, seat: Seat, here: RestingEyes, beyond: bool) -> bool:
        """Whether the eyes are back in a seat that was left: immediately if another face had taken
        over, and settled if the viewer had moved to another seat.
        """
        if self.state is ViewerState.EXCHANGED:
            return seat.rest.contains(here, REST_SPAN, RETURN_DEPTH)
        return (
            self.state is ViewerState.SEATED
            and beyond
            and self.settled
            and seat.rest.contains(here, RETURN_SPAN, RETURN_DEPTH)
        )

    def _remember(self, t_ns: int) -> None:
        """Remembers the seat, if one was measured, as the one that was left."""
        if self._last is not None and self._measured is not None:
            self._left = Seat(self._last, self._measured, t_ns)

    def _leave(self, t_ns: int) -> None:
        """Remembers the seat of a viewer who has moved to another one."""
        self._remember(t_ns)
        self.state = ViewerState.EXCHANGED
        self._measured = None

    def _recent_seat(self, t_ns: int) -> Seat | None:
        seat = self._left
        return seat if seat is not None and t_ns - seat.t_ns < RETURN_S * SECOND_NS else None

    def _return(self, seat: Seat, here: RestingEyes) -> RestingEyes:
        """Returns the rest of a seat that is occupied again."""
        self.state = ViewerState.SEATED
        self._first = None
        self._last = here
        self._measured = seat.rest
        self._unconfirmed = True
        return seat.rest

    def _rest(self, t_ns: int, here: RestingEyes, other: bool) -> RestingEyes | None:
        """The mean since the eyes came to rest, if that is at least REST_S ago.

        other: another face than before.
        """
        if other or self._first is None or not self._first.contains(here, REST_SPAN, REST_DEPTH):
            self._first, self._since_ns = here, t_ns
            self._sums, self._count = RestingEyes(0.0, 0.0, 0.0), 0
        self._sums = RestingEyes(*map(sum, zip(self._sums, here, strict=True)))
        self._count += 1
        rest_ns = t_ns - self._since_ns
        self.settled = rest_ns >= SETTLED_S * SECOND_NS and self._count >= SETTLED_FRAMES
        if rest_ns < REST_S * SECOND_NS or self._count < REST_FRAMES:
            return None
        return RestingEyes(*(total / self._count for total in self._sums))


class ViewEasing:
    """The only place that moves the viewpoint; every jump of the target, whatever its cause, is
    smoothed here.

    With a face, a picture differs from the previous one by the motion of the eyes and at most
    EASED_VIEWS; the remainder follows with the next pictures: another face, a found or corrected
    one, a new neutral place and another distance all move the target. After a loss, the picture
    holds for HOLD_S, then glides to the neutral place as (1 + s) exp(-s), s = t / AWAY_S, in closed
    form for any time step.
    """

    def __init__(self) -> None:
        self._shown: Place | None = None
        self._t_ns = 0
        self._lost_ns: int | None = None
        self._left: Place = (0.0, 0.0, 0.0)  # where the glide to the neutral place begins

    def followed(self, t_ns: int, target: Place, motion: Callable[[float], Place]) -> Place:
        """The place to show at t_ns (not decreasing) for eyes at target.

        motion: function from seconds to the steps of the target that the eyes' motion explains.
        """
        dt_s = max(t_ns - self._t_ns, 0) / 1e9
        self._t_ns = t_ns
        self._lost_ns = None
        shown = self._shown
        # after a pause, the next picture is not eased
        if shown is not None and dt_s < MAX_STEP_NS / SECOND_NS and shown != target:
            step = EASED_VIEWS * min(dt_s * EASED_HZ, 1.0)
            if max(abs(b - a) for a, b in zip(shown, target, strict=True)) > step:
                row, left, right = (
                    a + min(max(b - a, min(m, 0.0) - step), max(m, 0.0) + step)
                    for a, b, m in zip(shown, target, motion(dt_s), strict=True)
                )
                target = row, left, right
        self._shown = target
        return target

    def alone(self, t_ns: int, neutral: Place) -> Place:
        """The place to show at t_ns (not decreasing) while there is no face."""
        self._t_ns = t_ns
        if self._shown is None:
            self._left = neutral
            self._lost_ns = t_ns - round(HOLD_S * SECOND_NS)
        elif self._lost_ns is None:
            self._left, self._lost_ns = self._shown, t_ns
        s = max((t_ns - self._lost_ns) / SECOND_NS - HOLD_S, 0.0) / AWAY_S
        rest = (1 + s) * math.exp(-s) if s < 700 else 0.0
        row, left, right = (
            to + (start - to) * rest for start, to in zip(self._left, neutral, strict=True)
        )
        self._shown = row, left, right
        return self._shown


# no common multiple within eight minutes: no visible loop
PERIOD_COLS_S, PERIOD_ROWS_S = 17.0, 29.0
REACH = 0.7  # of the way from the middle of the grid to its edge
EYE_DISTANCE_VIEWS = 1.0  # maximum before any eyes were seen


def idle_place(neutral: Place, grid: tuple[int, int], t_s: float) -> Place:
    """The neutral place after t_s without a viewer: it sways slowly through grid (rows, cols)."""
    row, left, right = neutral
    rows, cols = grid
    row += REACH * (rows - 1) / 2 * math.sin(math.tau * t_s / PERIOD_ROWS_S)
    across = REACH * (cols - 1) / 2 * math.sin(math.tau * t_s / PERIOD_COLS_S)
    eye_distance = min(EYE_DISTANCE_VIEWS, (cols - 1) / 2) / 2 if left == right else 0.0
    return (
        min(max(row, 0.0), rows - 1.0),
        min(max(left + across - eye_distance, 0.0), cols - 1.0),
        min(max(right + across + eye_distance, 0.0), cols - 1.0),
    )
