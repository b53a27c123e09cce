"""True eyes at any time, from a truth file beside a sequence.

The file is what tools/make_sequence.py writes: source_seq, t_ns, left_x_px ... right_y_px, visible, phase; one row per frame.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfpipe.errors import UserError

Float = NDArray[np.float64]
COLUMNS = ("left_x_px", "left_y_px", "right_x_px", "right_y_px")
HEAD = ("source_seq", "t_ns", *COLUMNS, "visible", "phase")


def monotone_slopes(t: Float, y: Float) -> Float:
    """Slopes (n, k) of the monotone cubic through y (n, k) at t (n,), n >= 2: Fritsch and Butland 1984.

    Where y turns the slope is 0, so nothing overshoots and a head that stands still stays still.
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


class Truth:
    """eyes_px (n, 2, 2) at t_ns (n,), n >= 2; visible_ns, still_ns: since when each row's face is so, else -1."""

    def __init__(self, t_ns: ArrayLike, eyes_px: ArrayLike, visible: list[bool], still: list[bool]) -> None:
        self.t_ns = np.asarray(t_ns, np.int64)
        self.eyes_px = np.asarray(eyes_px, np.float64).reshape(-1, 2, 2)
        self.visible_ns = self._since(visible)
        self.still_ns = self._since([a and b for a, b in zip(visible, still, strict=True)])
        self._t_s = self.t_ns / 1e9
        self._flat = self.eyes_px.reshape(-1, 4)
        self._slopes = monotone_slopes(self._t_s, self._flat)

    @classmethod
    def read(cls, path: Path) -> Truth:
        """Raises UserError where the file is not one, with the row that is wrong."""
        try:
            with path.open(newline="") as file:
                rows = list(csv.DictReader(file))
            t_ns = [int(row["t_ns"]) for row in rows]
            eyes_px = [[float(row[name]) for name in COLUMNS] for row in rows]
            made = [row["visible"] == "1" for row in rows], [row["phase"] == "still" for row in rows]
            if len(rows) < 2 or not np.all(np.diff(t_ns) > 0) or not np.isfinite(eyes_px).all():
                raise ValueError("needs two rows or more, in order of time, with finite numbers")
        except (OSError, UnicodeDecodeError, KeyError, TypeError, ValueError) as error:
            raise UserError(f"{path}: no truth about eyes: {error}", "columns as tools/make_sequence.py writes them") from None
        return cls(t_ns, eyes_px, *made)

    def at(self, t_ns: ArrayLike) -> Float:
        """Eyes (..., 2, 2) px at times (...) within the truth; held at its ends."""
        t = np.clip(np.asarray(t_ns, np.float64) / 1e9, self._t_s[0], self._t_s[-1])
        k = np.clip(np.searchsorted(self._t_s, t, side="right") - 1, 0, len(self._t_s) - 2)
        step = self._t_s[k + 1] - self._t_s[k]
        s, step = ((t - self._t_s[k]) / step)[..., None], step[..., None]
        y0, y1, m0, m1 = self._flat[k], self._flat[k + 1], self._slopes[k], self._slopes[k + 1]
        ahead = s * s * (3 - 2 * s)
        found: Float = y0 + ahead * (y1 - y0) + step * s * (1 - s) * ((1 - s) * m0 - s * m1)
        return found.reshape(*t.shape, 2, 2)

    def _since(self, states: list[bool]) -> NDArray[np.int64]:
        out, start = [], -1
        for t_ns, state in zip(self.t_ns.tolist(), states, strict=True):
            start = -1 if not state else (t_ns if start < 0 else start)
            out.append(start)
        return np.array(out, np.int64)
