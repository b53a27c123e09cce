"""True eyes at any time, between the rows of a table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfpipe.errors import UserError
from lfpipe.sequence.eyes import COLUMNS, Truth, table_of

HEAD = ("source_seq", "t_ns", *COLUMNS, "visible", "phase")

Float = NDArray[np.float64]


def monotone_slopes(t: Float, y: Float) -> Float:
    """Slopes (n, k) of the monotone cubic through y (n, k) at t (n,), n >= 2: Fritsch and Butland 1984.

    The slope is 0 where y reverses: no overshoot, and a head at rest stays at rest.
    """
    step = np.diff(t)[:, None]
    secant = np.diff(y, axis=0) / step
    slopes = np.zeros_like(y)
    slopes[0], slopes[-1] = secant[0], secant[-1]
    before, after = secant[:-1], secant[1:]
    first, second = 2 * step[1:] + step[:-1], step[1:] + 2 * step[:-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        harmonic = (first + second) / (first / before + second / after)
    slopes[1:-1] = np.where(before * after > 0, harmonic, 0.0)
    return slopes


class EyePath:
    """The path of the true eyes. visible_ns, still_ns: per row, the time from which both eyes are visible and the head rests;
    else -1."""

    def __init__(self, truth: Truth) -> None:
        self.t_ns, self.eyes_px = truth.t_ns, truth.eyes_px
        self.visible_ns = self._since(truth.visible)
        self.still_ns = self._since(truth.visible & truth.still)
        self._t_s = self.t_ns / 1e9
        self._flat = self.eyes_px.reshape(-1, 4)
        self._slopes = monotone_slopes(self._t_s, self._flat)

    @classmethod
    def read(cls, path: Path) -> EyePath:
        """The path in a table of true eyes. Raises UserError if it cannot be read."""
        truth = table_of(path)
        if len(truth.t_ns) < 2:
            raise UserError(f"{path}: holds {len(truth.t_ns)} row; at least 2 are needed", "see tools/make_sequence.py")
        return cls(truth)

    def at(self, t_ns: ArrayLike) -> Float:
        """Eyes (..., 2, 2) px at times (...), by a monotone cubic; constant before the first row and after the last."""
        t = np.clip(np.asarray(t_ns, np.float64) / 1e9, self._t_s[0], self._t_s[-1])
        k = np.clip(np.searchsorted(self._t_s, t, side="right") - 1, 0, len(self._t_s) - 2)
        step = self._t_s[k + 1] - self._t_s[k]
        s, step = ((t - self._t_s[k]) / step)[..., None], step[..., None]
        y0, y1, m0, m1 = self._flat[k], self._flat[k + 1], self._slopes[k], self._slopes[k + 1]
        ahead = s * s * (3 - 2 * s)
        found: Float = y0 + ahead * (y1 - y0) + step * s * (1 - s) * ((1 - s) * m0 - s * m1)
        return found.reshape(*t.shape, 2, 2)

    def _since(self, state: NDArray[np.bool_]) -> NDArray[np.int64]:
        starts = state & ~np.concatenate([[False], state[:-1]])
        since = np.maximum.accumulate(np.where(starts, self.t_ns, self.t_ns[0]))
        return np.where(state, since, -1)
