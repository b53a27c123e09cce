"""How far the picture on the screen is from the eyes before it, over display time, from a trace."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.truth import Truth

SIDES = ("left", "right")
SETTLE_NS, STILL_NS, STEP_NS, SKIP_NS = 500_000_000, 400_000_000, 1_000_000, 1_000_000_000

Float = NDArray[np.float64]


class Displayed:
    """A trace beside the truth, sampled every millisecond while a picture is on the screen.

    rows: of a trace, in order. A picture stays from its t_presented_ns until the next one's. Its frame ties the clocks
    together: truth at time t is the truth at the frame's own time plus t - t_sensor_ns. The first second is left out: every
    tracker has to find the face first; and the half second after a looped file starts over, where the head leaps as no head
    does. Raises ValueError where nothing of the trace lies within the truth.
    """

    def __init__(self, truth: Truth, rows: list[dict[str, Any]]) -> None:
        self.rows = rows = [row for row in rows if row["t_presented_ns"] and row["eyes_used"]]
        if not rows:
            raise ValueError("the trace holds no picture made for eyes")
        shown_ns = np.array([row["t_presented_ns"] for row in rows])
        frame_ns = truth.t_ns[[row["source_seq"] % len(truth.t_ns) for row in rows]]
        offset_ns = frame_ns - np.array([row["t_sensor_ns"] for row in rows])
        t_ns = np.arange(shown_ns[0] + SKIP_NS, shown_ns[-1], STEP_NS)
        now = np.searchsorted(shown_ns, t_ns, side="right") - 1
        true_ns = t_ns + offset_ns[now]
        first_round = np.array([row["source_seq"] < len(truth.t_ns) for row in rows])[now]
        inside = (true_ns >= np.where(first_round, 0, SETTLE_NS)) & (true_ns <= truth.t_ns[-1])
        self.now: NDArray[np.intp] = now[inside]
        self.true_ns = true_ns[inside]
        if not len(self.now):
            raise ValueError("the trace holds no second within the truth")
        row = np.searchsorted(truth.t_ns, self.true_ns, side="right") - 1
        self.true_px = truth.at(self.true_ns)
        self.since_ns: NDArray[np.int64] = truth.still_ns[row]
        self.seen: NDArray[np.bool_] = truth.visible_ns[row] >= 0
        self.settled: NDArray[np.bool_] = self.seen & (self.true_ns - truth.visible_ns[row] > SETTLE_NS)
        self.still: NDArray[np.bool_] = (self.since_ns >= 0) & (self.true_ns - self.since_ns > STILL_NS)
        self.used_px = np.array([[row["eyes_used"][side] for side in SIDES] for row in rows], np.float64)
        self.drawn = np.maximum.accumulate([i if row.get("composed", True) else 0 for i, row in enumerate(rows)])

    def figures(self) -> dict[str, float]:
        """RMS in px, both eyes together: error (all display time with both eyes in the picture), settled (without the half second
        after a face has entered), drawn (a refresh that drew nothing counts with the eyes of the picture last drawn), jitter
        (deviation from its mean over stretches of stillness; NaN without any); seconds of display time."""
        error = self.used_px[self.now] - self.true_px
        older = self.used_px[self.drawn[self.now]] - self.true_px
        shaken = np.zeros_like(self.true_px)
        for start_ns in np.unique(self.since_ns[self.still]):
            stretch = self.still & (self.since_ns == start_ns)
            shaken[stretch] = self.used_px[self.now[stretch]] - self.used_px[self.now[stretch]].mean(axis=0)
        return {
            "error": _rms(error, self.seen),
            "settled": _rms(error, self.settled),
            "drawn": _rms(older, self.seen),
            "jitter": _rms(shaken, self.still),
            "seconds": float(self.seen.sum() * STEP_NS / 1e9),
        }

    def view_error(self, alpha_px: float, centre_px: tuple[float, float], grid: tuple[int, int]) -> float:
        """RMS distance, in views, of the viewpoint shown from the one of the true eyes, both eyes together.

        alpha_px, centre_px: of the mapping that the trace was made with. grid: rows, cols.
        """
        shown = np.array([[row["view"][side] for side in SIDES] for row in self.rows], np.float64)[self.drawn[self.now]]
        rows = (grid[0] - 1) / 2 + (self.true_px[:, :, 1].mean(axis=1, keepdims=True) - centre_px[1]) / alpha_px
        cols = (grid[1] - 1) / 2 + (centre_px[0] - self.true_px[:, :, 0]) / alpha_px
        wanted = np.stack([np.clip(np.broadcast_to(rows, cols.shape), 0, grid[0] - 1), np.clip(cols, 0, grid[1] - 1)], axis=2)
        return _rms(shown - wanted, self.seen)


def _rms(of: Float, where: NDArray[np.bool_]) -> float:
    return float(np.sqrt(np.square(of[where]).sum(axis=(1, 2)).mean() / 2)) if where.any() else float("nan")
