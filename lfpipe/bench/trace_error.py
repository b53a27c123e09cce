"""Error over display time of the eyes that pictures on the screen were made for, from a trace and the true eyes."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.inputs import eyes_at
from lfpipe.sequence.eyes import Truth

SIDES = ("left", "right")
SETTLE_NS, STILL_NS, STEP_NS, SKIP_NS = 500_000_000, 400_000_000, 1_000_000, 1_000_000_000

Float = NDArray[np.float64]


def _since_ns(truth: Truth, state: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Per row of the truth, the time from which a state has held; -1 where it does not."""
    starts = state & ~np.concatenate([[False], state[:-1]])
    return np.where(state, np.maximum.accumulate(np.where(starts, truth.t_ns, truth.t_ns[0])), -1)


class AlignedTrace:
    """A trace aligned with the true eyes, sampled every STEP_NS while a picture is on the screen.

    rows: of a trace, in order. A picture stays on the screen from its t_presented_ns until the next one's. Its frame aligns the
    clocks: the truth at time t is the truth at the frame's own time plus t - t_sensor_ns. Two parts do not count: the first
    SKIP_NS, in which every tracker searches for the face, and SETTLE_NS after a looped file restarts, where the head jumps as no
    real head does. Raises ValueError if nothing remains.
    """

    def __init__(self, truth: Truth, rows: list[dict[str, Any]]) -> None:
        self.rows = rows = [row for row in rows if row["t_presented_ns"] and row["eyes_used"]]
        if not rows:
            raise ValueError("the trace holds no picture made for eyes")
        presented_ns = np.array([row["t_presented_ns"] for row in rows])
        offset_ns = truth.t_ns[[row["source_seq"] % len(truth.t_ns) for row in rows]] - [row["t_sensor_ns"] for row in rows]
        t_ns = np.arange(presented_ns[0] + SKIP_NS, presented_ns[-1], STEP_NS)
        now = np.searchsorted(presented_ns, t_ns, side="right") - 1
        true_ns = t_ns + offset_ns[now]
        first_round = np.array([row["source_seq"] < len(truth.t_ns) for row in rows])[now]
        inside = (true_ns >= np.where(first_round, 0, SETTLE_NS)) & (true_ns <= truth.t_ns[-1])
        self.now: NDArray[np.intp] = now[inside]
        true_ns = true_ns[inside]
        if not len(true_ns):
            raise ValueError("the trace and the truth have no time in common")
        row = np.searchsorted(truth.t_ns, true_ns, side="right") - 1
        self.true_px = eyes_at(truth, true_ns)
        self.visible: NDArray[np.bool_] = truth.visible[row]
        self.still_since_ns = _since_ns(truth, truth.visible & truth.still)[row]
        self.still = (self.still_since_ns >= 0) & (true_ns - self.still_since_ns > STILL_NS)
        self.used_px = np.array([[row["eyes_used"][side] for side in SIDES] for row in rows], np.float64)
        self.drawn = np.maximum.accumulate([i if row.get("composed", True) else 0 for i, row in enumerate(rows)])

    def figures(self) -> dict[str, float]:
        """RMS in px over both eyes. error: while both eyes are visible. jitter: deviation from the mean of each period in which
        the head rests, from STILL_NS after its start; NaN if it never rests."""
        error = self.used_px[self.now] - self.true_px
        deviation = np.zeros_like(self.true_px)
        for start_ns in np.unique(self.still_since_ns[self.still]):
            rest = self.still & (self.still_since_ns == start_ns)
            deviation[rest] = self.used_px[self.now[rest]] - self.used_px[self.now[rest]].mean(axis=0)
        return {"error": _rms(error, self.visible), "jitter": _rms(deviation, self.still)}

    def view_error(self, alpha_px: float, centre_px: tuple[float, float], grid: tuple[int, int]) -> float:
        """RMS distance, in views, between the viewpoint on screen and that of the true eyes, over both eyes.

        alpha_px, centre_px: of the mapping that made the trace. grid: rows, cols.
        """
        on_screen = np.array([[row["view"][side] for side in SIDES] for row in self.rows], np.float64)[self.drawn[self.now]]
        rows = (grid[0] - 1) / 2 + (self.true_px[:, :, 1].mean(axis=1, keepdims=True) - centre_px[1]) / alpha_px
        cols = (grid[1] - 1) / 2 + (centre_px[0] - self.true_px[:, :, 0]) / alpha_px
        true = np.stack([np.clip(np.broadcast_to(rows, cols.shape), 0, grid[0] - 1), np.clip(cols, 0, grid[1] - 1)], axis=2)
        return _rms(on_screen - true, self.visible)


def _rms(values: Float, where: NDArray[np.bool_]) -> float:
    return float(np.sqrt(np.square(values[where]).sum(axis=(1, 2)).mean() / 2)) if where.any() else float("nan")
