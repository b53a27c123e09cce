"""The bounds of each script in `lfpipe bench viewer --check`."""

import csv
from pathlib import Path

import attrs

from lfpipe.bench.results import Results, Row, Value, short

LEAST = ("depth",)


BOUNDS: dict[str, dict[str, float]] = {
    row.pop("row"): {metric: float(text) for metric, text in row.items() if text}
    for row in csv.DictReader(Path(__file__).with_name("bounds.csv").read_text().splitlines())
}
"""By script, scene, camera and screen: the largest right value of each figure; for LEAST, the
smallest.
"""


def judged(row: Row, of: str = "") -> Row:
    """The row with its metrics compared with their bounds. of: the kind of the row; "": script."""
    bounds = BOUNDS.get(f"{of} {row.name}" if of else row.name, {})
    values = {
        key: _judged(value, bounds[key], key in LEAST) if key in bounds else value
        for key, value in row.values.items()
    }
    return attrs.evolve(row, values=values)


def _judged(value: Value, bound: float, least: bool) -> Value:
    if value.value >= bound if least else value.value <= bound:
        return attrs.evolve(value, state="ok")
    limit = "at least" if least else "at most"
    return attrs.evolve(
        value, state="failed", words=f"{short(value.value)}, {limit} {short(bound)} is right"
    )


def beyond(results: Results) -> list[str]:
    """A line for each metric beyond its bound, with script, metric and bound."""
    return [
        f"{row.name}: {column}: {value.text}"
        for _, row, column, value in results.judged()
        if value.state != "ok"
    ]
