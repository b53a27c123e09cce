"""How far the picture on the screen is from the eyes before it: error over display time and still jitter, from traces.

    uv run python profiling/eyes_displayed.py TRUTH.csv TRACE.jsonl [TRACE.jsonl ...]

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

import json
import sys
from pathlib import Path

from lfpipe.bench.displayed import Displayed
from lfpipe.bench.truth import Truth


def measured(truth: Truth, trace: Path) -> dict[str, float]:
    """The figures of one trace."""
    return Displayed(truth, [json.loads(line) for line in trace.read_text().splitlines()]).figures()


def main() -> None:
    if len(sys.argv) < 3:
        sys.exit((__doc__ or "").split("\n\n")[1].strip())
    truth, traces = Truth.read(Path(sys.argv[1])), [Path(name) for name in sys.argv[2:]]
    table = [measured(truth, trace) for trace in traces]
    print(f"{'':28}" + "".join(f"{name:>16}" for name in table[0]))
    for trace, figures in zip(traces, table, strict=True):
        ratios = [f" ({value / table[-1][key]:.2f}x)" if len(table) > 1 else "" for key, value in figures.items()]
        cells = [f"{value:.3f}{ratio}" for value, ratio in zip(figures.values(), ratios, strict=True)]
        print(f"{trace.stem[:28]:28}" + "".join(f"{cell:>16}" for cell in cells))


if __name__ == "__main__":
    main()
