"""How far the picture on the screen is from the eyes before it: error over display time and still jitter, from traces.

    uv run --group dev python profiling/eyes_displayed.py TRUTH.csv TRACE.jsonl [TRACE.jsonl ...]

TRUTH.csv is what tools/make_sequence.py writes; traces are of `lfpipe up --trace` or of the paper's loop (`--trace`), both on
that sequence (`source_seq` may go on past its end where the file loops). A picture stays on the screen from its t_presented_ns
until the next one's. Its frame ties the clocks together: truth at time t is the truth at the frame's own time plus
t - t_sensor_ns, by monotone cubic interpolation. Sampled every millisecond while both true eyes are in the picture:

    error    RMS of |eyes_used - true eyes|, both eyes together, px
    settled  the same without the first half second after a face has (re-)entered
    drawn    as error, where a refresh that drew nothing counts with the eyes of the picture last drawn
    jitter   RMS deviation of eyes_used from its mean, over stretches of stillness from 0.4 s after their start, px

With several traces, each is also given as a ratio to the last one: put the paper's last.
"""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

SIDES = ("left", "right")
SETTLE_NS, STILL_NS, STEP_NS = 500_000_000, 400_000_000, 1_000_000


class Truth:
    """The truth file: eyes (n, 2, 2) px at t_ns (n,), and since when each row's face is visible and still."""

    def __init__(self, path: Path) -> None:
        with path.open() as file:
            rows = list(csv.DictReader(file))
        self.t_ns = np.array([int(row["t_ns"]) for row in rows])
        eyes = np.array([[float(row[f"{side}_{axis}_px"]) for side in SIDES for axis in "xy"] for row in rows])
        self.eyes = PchipInterpolator(self.t_ns, eyes, axis=0)
        self.visible_ns = self._since([row["visible"] == "1" for row in rows])
        self.still_ns = self._since([row["phase"] == "still" and row["visible"] == "1" for row in rows])

    def _since(self, states: list[bool]) -> NDArray[np.int64]:
        """For every row the time since when its state holds; -1 where it does not."""
        out, start = [], -1
        for t_ns, state in zip(self.t_ns.tolist(), states, strict=True):
            start = -1 if not state else (t_ns if start < 0 else start)
            out.append(start)
        return np.array(out)


def measured(truth: Truth, trace: Path) -> dict[str, float]:
    """The figures of one trace. Frames before the first second are left out: every tracker has to find the face first."""
    rows = [json.loads(line) for line in trace.read_text().splitlines()]
    rows = [row for row in rows if row["t_presented_ns"] and row["eyes_used"]]
    shown_ns = np.array([row["t_presented_ns"] for row in rows])
    used = np.array([[row["eyes_used"][side] for side in SIDES] for row in rows])
    frame_ns = truth.t_ns[[row["source_seq"] % len(truth.t_ns) for row in rows]]
    offset_ns = frame_ns - np.array([row["t_sensor_ns"] for row in rows])
    drawn = np.maximum.accumulate([i if row.get("composed", True) else 0 for i, row in enumerate(rows)])
    t_ns = np.arange(shown_ns[0] + 1_000_000_000, shown_ns[-1], STEP_NS)
    now = np.searchsorted(shown_ns, t_ns, side="right") - 1
    true_ns = t_ns + offset_ns[now]
    inside = (true_ns >= 0) & (true_ns <= truth.t_ns[-1])
    now, true_ns = now[inside], true_ns[inside]
    row = np.searchsorted(truth.t_ns, true_ns, side="right") - 1
    true = truth.eyes(true_ns).reshape(-1, 2, 2)
    seen = truth.visible_ns[row] >= 0
    settled = seen & (true_ns - truth.visible_ns[row] > SETTLE_NS)
    still = (truth.still_ns[row] >= 0) & (true_ns - truth.still_ns[row] > STILL_NS)

    def rms(of: NDArray[np.float64], where: NDArray[np.bool_]) -> float:
        return float(np.sqrt(np.square(of[where]).sum(axis=(1, 2)).mean() / 2))

    shaken = np.zeros_like(true)
    for start_ns in np.unique(truth.still_ns[row][still]):
        stretch = still & (truth.still_ns[row] == start_ns)
        shaken[stretch] = used[now[stretch]] - used[now[stretch]].mean(axis=0)
    error, older = used[now] - true, used[drawn[now]] - true
    figures = {"error": rms(error, seen), "settled": rms(error, settled), "drawn": rms(older, seen), "jitter": rms(shaken, still)}
    return figures | {"seconds": float(seen.sum() * STEP_NS / 1e9)}


def main() -> None:
    if len(sys.argv) < 3:
        sys.exit((__doc__ or "").split("\n\n")[1].strip())
    truth, traces = Truth(Path(sys.argv[1])), [Path(name) for name in sys.argv[2:]]
    table = [measured(truth, trace) for trace in traces]
    print(f"{'':28}" + "".join(f"{name:>16}" for name in table[0]))
    for trace, figures in zip(traces, table, strict=True):
        ratios = [f" ({value / table[-1][key]:.2f}x)" if len(table) > 1 else "" for key, value in figures.items()]
        cells = [f"{value:.3f}{ratio}" for value, ratio in zip(figures.values(), ratios, strict=True)]
        print(f"{trace.stem[:28]:28}" + "".join(f"{cell:>16}" for cell in cells))


if __name__ == "__main__":
    main()
