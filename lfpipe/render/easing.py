"""The viewpoint while no face is seen, and when one returns: hold, ease to neutral, ease back, never jump."""

import math

import numpy as np
from numpy.typing import NDArray

HOLD_S = 3.0  # a hand before the face, a glance aside, a dropped pen: a viewer who is back soon finds the picture they left
AWAY_S = 0.8  # time constant of easing to neutral: nobody is looking, no hurry
BACK_S = 0.03  # time constant of easing to eyes found (again): over within 0.15 s, yet a visible move and no jump
LARGEST_STEP = 0.4  # views between two pictures at 60 Hz while easing: a far face takes longer


class EyeEasing:
    """Follows the eyes, whatever their coordinates (px of the camera picture, or rows and columns of the grid).

    When the target jumps (a loss of HOLD_S, a face found again, another face), the jump becomes an offset that decays as (1 + s)
    exp(-s), s = t / time constant: no jump, and no kink at its start. The closed form holds for any time step.
    """

    def __init__(self) -> None:
        self._shown: NDArray[np.float64] | None = None
        self._offset: NDArray[np.float64] | None = None
        self._since_ns, self._fade_s = 0, BACK_S
        self._aim: int | None = None  # generation followed; None: neutral
        self._lost_ns: int | None = None

    def at(
        self,
        t_ns: int,
        eyes: NDArray[np.float64] | None,
        neutral: NDArray[np.float64],
        generation: int = 0,
        view_px: float = math.inf,
    ) -> NDArray[np.float64]:
        """The position to show at t_ns (not decreasing). eyes: None while there is no face. neutral: the position without one.

        generation: counts the tracks of a face; a new number is another face, or the same after a loss. eyes and neutral have the
        same shape. view_px: of the coordinates, per view.
        """
        if eyes is None:
            self._lost_ns = t_ns if self._lost_ns is None else self._lost_ns
            if self._aim is not None and self._shown is not None and t_ns - self._lost_ns < HOLD_S * 1e9:
                return self._shown.copy()
            if self._aim is not None:
                self._turn(t_ns, None, neutral, AWAY_S, view_px)
            self._shown = neutral + self._rest(t_ns)
        else:
            if self._shown is None:
                self._shown = np.array(neutral, np.float64)
            if self._lost_ns is not None or generation != self._aim:
                self._turn(t_ns, generation, eyes, BACK_S, view_px)
            self._lost_ns = None
            self._shown = eyes + self._rest(t_ns)
        return self._shown.copy()

    def shift(self, by: NDArray[np.float64]) -> None:
        """Moves the position shown with its coordinates' origin: the next target is eased to from there."""
        if self._shown is not None:
            self._shown = self._shown + by

    def _turn(self, t_ns: int, aim: int | None, target: NDArray[np.float64], fade_s: float, view_px: float) -> None:
        """Changes the target: the offset is the position shown now minus the new target."""
        self._aim, self._since_ns, self._fade_s = aim, t_ns, fade_s
        self._offset = None if self._shown is None else self._shown - target
        if self._offset is not None:  # the steepest slope of (1 + s) exp(-s) is 1 / e
            views = float(np.abs(self._offset).max()) / max(view_px, 1e-9)
            self._fade_s = max(fade_s, views / (60 * math.e * LARGEST_STEP))

    def _rest(self, t_ns: int) -> NDArray[np.float64] | float:
        """The remaining offset."""
        if self._offset is None:
            return 0.0
        s = max(t_ns - self._since_ns, 0) / 1e9 / self._fade_s
        return self._offset * ((1 + s) * math.exp(-s) if s < 700 else 0.0)
