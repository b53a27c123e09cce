"""Draws the pictures of a few camera frames as a timeline, from a trace of `lfpipe up --trace`.

uv run python tools/draw_timeline.py TRACE [--out docs/timeline.svg] [--frames 3] [--loop-ms 45]
"""

import argparse
import itertools
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
from matplotlib.figure import Figure

from lfpipe.files.trace import trace_lines

ROWS = ("camera, driver, decoding", "tracking", "waiting for its turn", "composing", "waiting for the blank", "screen to light")
COLOURS = ("#56b4e9", "#009e73", "#d0d7de", "#e69f00", "#d0d7de", "#cc79a7")
SETTLED = 60  # lines that a session takes to find its pace


def chosen(lines: list[dict[str, Any]], frames: int) -> list[dict[str, Any]]:
    """The first pictures of so many frames in a row: those whose age is most usual."""
    new = [line for before, line in itertools.pairwise(lines) if line["source_seq"] != before["source_seq"] and line["composed"]]
    first = new[SETTLED:]
    ages = [line["t_presented_ns"] - line["t_sensor_ns"] for line in first]
    middle = sorted(ages)[len(ages) // 2]
    starts = range(len(first) - frames + 1)
    best = min(starts, key=lambda k: max(abs(age - middle) for age in ages[k : k + frames]))
    return first[best : best + frames]


def main(trace: Path, out: Path, frames: int, loop_ms: float) -> None:
    lines = [dict(fields.values) for fields in trace_lines(trace, "a trace written by `lfpipe up --trace`")]
    pictures = chosen(lines, frames)
    zero_ns = pictures[0]["t_sensor_ns"]
    with mpl.rc_context({"svg.hashsalt": "lfpipe", "font.family": "DejaVu Sans", "svg.fonttype": "path"}):
        figure = Figure(figsize=(10, 4.2), layout="constrained")
        axes = figure.subplots()
        high = 0.8 / len(pictures)  # each frame has a lane of its own in every row
        for number, picture in enumerate(pictures):
            names = ("t_sensor_ns", "t_read_ns", "t_tracked_ns", "t_started_ns", "t_composed_ns", "t_presented_ns")
            times = [(picture[name] - zero_ns) / 1e6 for name in names]
            times.append(times[-1] + loop_ms)
            for row, (start, end) in enumerate(itertools.pairwise(times)):
                lane = row - 0.4 + (number + 0.5) * high
                axes.barh(lane, max(end - start, 0.15), left=start, height=0.9 * high, color=COLOURS[row])
                axes.text(end + 0.5, lane, f"{end - start:.1f} ms", va="center", fontsize=7)
        axes.set_yticks(range(len(ROWS)), ROWS, fontsize=9)
        axes.invert_yaxis()
        axes.set_xlabel("ms after the stamp of the first frame", fontsize=9)
        axes.spines[["top", "right"]].set_visible(False)
        figure.savefig(out, metadata={"Date": None, "Creator": "tools/draw_timeline.py"})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("trace", type=Path)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "timeline.svg")
    parser.add_argument("--frames", type=int, default=3)
    parser.add_argument("--loop-ms", type=float, default=45.0, help="drawn behind the present; not in the trace")
    args = parser.parse_args()
    main(args.trace, args.out, args.frames, args.loop_ms)
