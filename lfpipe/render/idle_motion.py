"""An exhibition's picture while nobody is there: the viewpoint sways slowly through the grid of views."""

import math

from lfpipe.render.viewpoint import Position

PERIOD_COLS_S, PERIOD_ROWS_S = 17.0, 29.0  # no common multiple within eight minutes: no visible loop
REACH = 0.7  # of the way from the middle of the grid to its edge
APART_VIEWS = 1.0  # at most, between the eyes, before any eyes were seen
GROW_S, FADE_S = 2.0, 0.25  # time constants: away from the last viewer's place, and to the eyes of the next one
STILL = 1e-3  # a smaller share of the motion counts as none


class IdleMotion:
    """Moves viewpoints while nobody is there; leaves them unchanged while somebody is."""

    def __init__(self) -> None:
        self._share = 0.0
        self._t_ns = self._start_ns = 0

    def moved(
        self, left: Position, right: Position, grid: tuple[int, int], t_ns: int, alone: bool, whole: bool = False
    ) -> tuple[Position, Position]:
        """The viewpoints at t_ns (not decreasing), within grid (rows, cols). alone: nobody is there. whole: only stored views."""
        dt_s, self._t_ns = max(t_ns - (self._t_ns or t_ns), 0) / 1e9, t_ns
        if not self._share:
            self._start_ns = t_ns
        self._share += ((1.0 if alone else 0.0) - self._share) * -math.expm1(-dt_s / (GROW_S if alone else FADE_S))
        if not alone and self._share < STILL:
            self._share = 0.0
        if not self._share:
            return left, right
        t_s, (rows, cols) = (t_ns - self._start_ns) / 1e9, grid
        row = left[0] + self._share * REACH * (rows - 1) / 2 * math.sin(math.tau * t_s / PERIOD_ROWS_S)
        across = self._share * REACH * (cols - 1) / 2 * math.sin(math.tau * t_s / PERIOD_COLS_S)
        apart = self._share * min(APART_VIEWS, (cols - 1) / 2) / 2 if left == right else 0.0
        places = [(row, left[1] + across - apart), (row, right[1] + across + apart)]
        kept = [(min(max(r, 0.0), rows - 1.0), min(max(c, 0.0), cols - 1.0)) for r, c in places]
        if whole:
            kept = [(math.floor(r + 0.5), math.floor(c + 0.5)) for r, c in kept]
        return kept[0], kept[1]
