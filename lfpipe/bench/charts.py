"""Charts of error against run time with matplotlib, as SVG."""

import io
from collections.abc import Callable, Sequence
from typing import Any

import matplotlib as mpl
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, SymmetricalLogLocator

from lfpipe.bench.results import Row, short
from lfpipe.bench.subjects import Chart, Subject

SIZE_IN, DPI = (9.0, 4.6), 100
MARKERS = "osD^vPX<>h"
COLOURS = ("#0072b2", "#d55e00", "#008a63", "#b1548f", "#8a6d00", "#4b4fc4", "#7a7f86")  # for a colour vision deficiency, too
PAPER, INK, SOFT, GRID, RED = "#ffffff", "#1b1f24", "#57606a", "#e4e7eb", "#e5484d"
STYLE: Any = {
    "svg.hashsalt": "lfpipe", "svg.fonttype": "none", "font.size": 10, "font.family": "DejaVu Sans", "text.color": INK,
    "axes.labelcolor": INK, "axes.edgecolor": SOFT, "xtick.color": SOFT, "ytick.color": SOFT, "axes.facecolor": PAPER,
    "figure.facecolor": PAPER, "savefig.facecolor": PAPER, "axes.spines.top": False, "axes.spines.right": False,
}  # fmt: skip


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


def draw(subject: Subject, rows: Sequence[Row], chart: Chart) -> str | None:
    """The chart as SVG; None if it holds no point. Equal results give equal files."""
    drawn = [row for row in rows if row.value(chart.x) >= 0 and row.value(chart.y) >= 0]
    if not drawn:
        return None

    def places(some: Sequence[Row]) -> tuple[list[float], list[float]]:
        return [row.value(chart.x) for row in some], [row.value(chart.y) for row in some]

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=SIZE_IN, dpi=DPI, layout="constrained")
        axes = figure.add_subplot()
        for k, curve in enumerate(dict.fromkeys(row.curve for row in drawn)):
            axes.plot(*places([row for row in drawn if row.curve == curve]), marker=MARKERS[k % len(MARKERS)],
                      color=COLOURS[k % len(COLOURS)], linewidth=1.4, markersize=6, label=curve)  # fmt: skip
        for label, marker, size, face, some in (
            ("best: nothing is better in both", "o", 110, "none", front(drawn, chart)),
            ("in use", "s", 190, "none", [row for row in drawn if row.used]),
            ("the paper", "*", 190, RED, [row for row in drawn if row.paper]),
        ):
            if some:
                edge = PAPER if marker == "*" else INK
                axes.scatter(*places(some), s=size, marker=marker, facecolors=face, edgecolors=edge, zorder=4, label=label)
        axes.margins(0.09, 0.12)
        for axis, set_scale, key in ((axes.xaxis, axes.set_xscale, chart.x), (axes.yaxis, axes.set_yscale, chart.y)):
            _logarithmic(axis, set_scale, [row.value(key) for row in drawn])
            axis.set_label_text(subject.column(key).axis)
        axes.set_title(chart.title, loc="left", fontsize=12, fontweight="bold", color=INK)
        axes.grid(True, which="major", color=GRID, linewidth=0.8)
        axes.set_axisbelow(True)
        figure.legend(loc="outside right upper", frameon=False, fontsize=9, labelcolor=INK)
        out = io.StringIO()
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": "lfpipe bench"})
        return out.getvalue()


def _logarithmic(axis: Axis, set_scale: Callable[..., None], values: Sequence[float]) -> None:
    """A logarithmic axis; where a value is exactly 0, with 0 at its edge."""
    above = [value for value in values if value > 0]
    low, high = min(above, default=1.0), max(above, default=1.0)
    subs = (1.0,) if high / low > 60 else (1.0, 2.0, 5.0)
    if len(above) < len(values):
        set_scale("symlog", linthresh=low, linscale=0.4)
        axis.set_major_locator(SymmetricalLogLocator(linthresh=low, base=10, subs=subs))
    else:
        set_scale("log")
        axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(FuncFormatter(lambda value, _: short(value)))
    axis.set_minor_formatter(NullFormatter())
