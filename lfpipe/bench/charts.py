"""Charts of rows with matplotlib, as SVG: one function for each kind."""

import io
import math
from collections.abc import Callable, Sequence
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

from lfpipe.bench.results import Row, short
from lfpipe.bench.subjects import Chart, Profile, Subject

SIZE_IN, DPI = (9.0, 4.6), 100
MARKERS = "osD^vPX<>h"
COLOURS = ("#0072b2", "#d55e00", "#008a63", "#b1548f", "#8a6d00", "#4b4fc4", "#7a7f86")  # for a colour vision deficiency, too
PAPER, INK, SOFT, GRID, RED = "#ffffff", "#1b1f24", "#57606a", "#e4e7eb", "#e5484d"
STYLE: Any = {
    "svg.hashsalt": "lfpipe", "svg.fonttype": "none", "font.size": 10, "font.family": "DejaVu Sans", "text.color": INK,
    "axes.labelcolor": INK, "axes.edgecolor": SOFT, "xtick.color": SOFT, "ytick.color": SOFT, "axes.facecolor": PAPER,
    "figure.facecolor": PAPER, "savefig.facecolor": PAPER, "axes.spines.top": False, "axes.spines.right": False,
}  # fmt: skip


def draw(subject: Subject, rows: Sequence[Row], chart: Chart | Profile) -> str | None:
    """The chart as SVG; None if it holds no point. Equal results give equal files."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=SIZE_IN, dpi=DPI, layout="constrained")
        axes = figure.add_subplot()
        if not (_scatter(axes, subject, rows, chart) if isinstance(chart, Chart) else _profile(axes, rows, chart)):
            return None
        axes.set_title(chart.title, loc="left", fontsize=12, fontweight="bold", color=INK)
        axes.grid(True, which="major", color=GRID, linewidth=0.8)
        axes.set_axisbelow(True)
        handles, labels = axes.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside right upper", frameon=False, fontsize=9, labelcolor=INK)
        out = io.StringIO()
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": "lfpipe bench"})
        return out.getvalue()


def front(rows: Sequence[Row], chart: Chart) -> list[Row]:
    """The rows on the Pareto front of a chart, from left to right; less is better.

    What differs by less than both intervals together ties: a row is beaten by one that is better in one column and better or
    equal in the other.
    """

    def better(a: Row, b: Row, key: str) -> bool:
        one, other = a.values[key], b.values[key]
        return other.value - one.value > one.half + other.half

    def beats(a: Row, b: Row) -> bool:
        x, y = better(a, b, chart.x), better(a, b, chart.y)
        return (x and not better(b, a, chart.y)) or (y and not better(b, a, chart.x))

    drawn = [row for row in rows if chart.x in row.values and chart.y in row.values]
    best = [row for row in drawn if not any(beats(other, row) for other in drawn)]
    return sorted(best, key=lambda row: (row.value(chart.x), row.value(chart.y)))


def _scatter(axes: Axes, subject: Subject, rows: Sequence[Row], chart: Chart) -> bool:
    drawn = [row for row in rows if row.value(chart.x) >= 0 and row.value(chart.y) >= 0]

    def places(some: Sequence[Row]) -> tuple[list[float], list[float]]:
        return [row.value(chart.x) for row in some], [row.value(chart.y) for row in some]

    for k, curve in enumerate(dict.fromkeys(row.curve for row in drawn)):
        axes.plot(*places([row for row in drawn if row.curve == curve]), marker=MARKERS[k % len(MARKERS)],
                  color=COLOURS[k % len(COLOURS)], linewidth=1.4, markersize=6, label=curve)  # fmt: skip
    marks: tuple[tuple[str, str, int, list[Row]], ...] = (
        ("best: nothing is better in both", "o", 110, front(drawn, chart)),
        ("in use", "s", 190, [row for row in drawn if row.used]), ("the paper", "*", 190, [row for row in drawn if row.paper]),
    )  # fmt: skip
    for label, marker, size, some in marks:
        face, edge = (RED, PAPER) if marker == "*" else ("none", INK)
        if some:
            axes.scatter(*places(some), s=size, marker=marker, facecolors=face, edgecolors=edge, zorder=4, label=label)
    axes.margins(0.09, 0.12)
    for axis, scale, key in ((axes.xaxis, axes.set_xscale, chart.x), (axes.yaxis, axes.set_yscale, chart.y)):
        _logarithmic(axis, scale, [row.value(key) for row in drawn])
        axis.set_label_text(subject.column(key).axis)
    return bool(drawn)


def _logarithmic(axis: Axis, scale: Callable[..., None], values: Sequence[float]) -> None:
    """A logarithmic axis; where a value is exactly 0, with 0 at its edge."""
    above = [value for value in values if value > 0]
    low, high = min(above, default=1.0), max(above, default=1.0)
    zero = len(above) < len(values)
    scale("symlog", linthresh=low, linscale=0.4) if zero else scale("log")
    ticks = LogLocator(subs=(1.0,) if high / low > 60 else (1.0, 2.0, 5.0))
    if zero:
        (axis.axes.set_xlim if axis.axis_name == "x" else axis.axes.set_ylim)(-0.3 * low)  # type: ignore[attr-defined]
        axis.set_minor_locator(NullLocator())
        axis.set_ticks([0.0, *(float(tick) for tick in ticks.tick_values(low, high) if low <= tick <= high)])
    else:
        axis.set_major_locator(ticks)
    axis.set_major_formatter(FuncFormatter(lambda value, _: short(value)))
    axis.set_minor_formatter(NullFormatter())


def _profile(axes: Axes, rows: Sequence[Row], profile: Profile) -> bool:
    drawn = [row for row in rows if row.knob == "default" or row.paper]
    for k, row in enumerate(drawn):
        label = f"{row.name} (the paper)" if row.paper else row.curve + " (in use)" * row.used
        axes.plot([x for x, _ in profile.points], [row.value(key) for _, key in profile.points], marker=MARKERS[k % len(MARKERS)],
                  color=RED if row.paper else COLOURS[k % len(COLOURS)], linewidth=1.6, linestyle="--" if row.paper else "-",
                  label=label)  # fmt: skip
    values = [value for row in drawn for _, key in profile.points if math.isfinite(value := row.value(key))]
    if values and min(values) > 0:
        _logarithmic(axes.yaxis, axes.set_yscale, values)
    axes.set_xlabel(profile.x_axis)
    axes.set_ylabel(profile.y_axis)
    return bool(values)
