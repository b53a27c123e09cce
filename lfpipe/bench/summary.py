"""Charts of error against run time, as HTML images, and the first screen of a report: one chart,
one sentence and the headline figures.
"""

import base64
import html
import importlib.util
import io
import math
from textwrap import fill
from typing import TYPE_CHECKING, Any

from lfpipe.bench.benchmarks import Benchmark
from lfpipe.bench.results import Results, Row, short
from lfpipe.bench.style import html_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# distinguishable with a colour vision deficiency
COLOURS = ("#0072b2", "#d55e00", "#008a63", "#b1548f", "#8a6d00", "#4b4fc4", "#7a7f86")
MAX_NAMES = 8  # of points in a chart that stay legible
MARGIN = 1.25  # of an axis beyond the largest value
LOGARITHMIC = 10.0  # the largest over the least value of an axis that is not linear
TICKS = (1.0, 2.0, 5.0)  # of a decade
LABEL_CHARS = 44  # of a line of an axis' label, as long as the axis in any font


def has_charts() -> bool:
    """Whether matplotlib is installed."""
    return importlib.util.find_spec("matplotlib") is not None


def chart(benchmark: Benchmark, rows: list[Row], x: str, y: str) -> str:
    """Two columns, a curve for each method, with names beside the points: of all, or, of more than
    MAX_NAMES, of the default, the paper, and of each curve at its end. "" if there are no points,
    or without matplotlib.
    """
    rows = [row for row in rows if row.value(x) >= 0 and row.value(y) >= 0]
    if not rows or not has_charts():
        return ""
    curves = {row.curve: row for row in rows}  # and the last point of each
    names = {
        row.name: curve if len(rows) > MAX_NAMES else row.name for curve, row in curves.items()
    }
    names |= {row.name: row.name for row in rows if len(rows) <= MAX_NAMES or row.used or row.paper}

    def draw(axes: "Axes") -> None:
        for k, curve in enumerate(curves):
            points = [row for row in rows if row.curve == curve]
            axes.errorbar(
                [row.value(x) for row in points],
                [row.value(y) for row in points],
                xerr=_bars(points, x),
                yerr=_bars(points, y),
                marker="o",
                color=COLOURS[k % len(COLOURS)],
                capsize=2,
                linewidth=1,
            )
            for row in (one for one in points if one.name in names):
                steps = [other.value(y) - row.value(y) for other in rows if other is not row]
                is_above = min(steps, key=abs, default=0.0) <= 0  # away from its neighbour
                axes.annotate(
                    "default: " * row.used + "paper: " * row.paper + names[row.name],
                    (row.value(x), row.value(y)),
                    (8, 5 if is_above else -11),
                    textcoords="offset points",
                    color=COLOURS[k % len(COLOURS)],
                    bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 0.5},
                    zorder=5,  # above the bars of its neighbours
                    fontweight="bold" if row.used or row.paper else "normal",
                )

    return _image(benchmark, rows, x, y, draw)


def _bars(rows: list[Row], key: str) -> tuple[list[float], list[float]]:
    """The lengths of error bars, down and up."""
    values = [row.values[key] for row in rows]
    return [one.value - one.low for one in values], [one.high - one.value for one in values]


def _image(benchmark: Benchmark, rows: list[Row], x: str, y: str, draw: Any) -> str:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    title = f"{benchmark.column(y).label} against {benchmark.column(x).label}"
    style: Any = {"svg.fonttype": "none", "axes.spines.top": False, "axes.spines.right": False}
    with mpl.rc_context(style):
        figure = Figure(figsize=(7.5, 4.8), layout="constrained")
        xlabel, ylabel = (fill(benchmark.column(key).axis, LABEL_CHARS) for key in (x, y))
        axes = figure.add_subplot(xlabel=xlabel, ylabel=ylabel)
        draw(axes)
        for axis, key in (("x", x), ("y", y)):
            bounds = [(row.values[key].low, row.values[key].high) for row in rows]
            _scale(axes, axis, [end for bound in bounds for end in bound])
        axes.grid(True, color="#e4e7eb")
        out = io.StringIO()
        figure.savefig(out, format="svg", metadata={"Date": None})
    data = base64.b64encode(out.getvalue().encode()).decode()
    image = f'<img alt="{html.escape(title)}" src="data:image/svg+xml;base64,{data}">'
    return f"<div class=wide>{image}</div>"


def _scale(axes: "Axes", axis: str, values: list[float]) -> None:
    """A linear axis from 0 with room for names, or a logarithmic one with plain numbers; an exact 0
    is drawn at its edge.
    """
    above = [value for value in values if value > 0]
    low, high = min(above, default=1.0), max(above, default=1.0)
    if high < LOGARITHMIC * low:
        getattr(axes, f"set_{axis}lim")(0.0, high * MARGIN)
        return
    getattr(axes, f"set_{axis}scale")("symlog", linthresh=low, linscale=0.4)
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    ticks = [step * 10.0**decade for decade in decades for step in TICKS]
    ticks = [tick for tick in ticks if low / 1.5 <= tick <= high * 1.5]
    ticks = [0.0, *ticks] if min(values) <= 0 else ticks
    getattr(axes, f"set_{axis}ticks")(ticks, [short(tick) for tick in ticks], minor=False)
    getattr(axes, f"set_{axis}ticks")([], minor=True)


# (column, that of the paper's pipeline, text, unit) of HEADLINE_ROW: (table, row)
HEADLINES = (
    ("lag_ms", "plain_lag_ms", "lag behind a moving head", "ms"),
    ("error_views", "plain_error", "error of the viewpoint", "views"),
)
HEADLINE_ROW = "screen", "60 Hz"  # that most people have
LESS = "of 30 Hz and a screen of 60 Hz; less is better"


def summary(benchmark: Benchmark, results: Results) -> str:
    """HTML; "" for a benchmark without a `sentence`."""
    if not (text := sentence(benchmark, results)):
        return ""
    lead = f"<p class=lead>{html.escape(text)}</p>"
    shown, _ = _alternatives(benchmark, results)
    return lead + chart(benchmark, shown, *benchmark.charts[0]) + _headlines(results)


def _alternatives(benchmark: Benchmark, results: Results) -> tuple[list[Row], Row | None]:
    """The paper's methods and those that differ from the default in one setting; the default."""
    keys = {key for axes in benchmark.charts[:1] for key in axes}
    rows = [row for row in results.rows if keys and keys <= row.values.keys()]
    used = next((row for row in rows if row.used), None)
    curve, parameter = (used.curve, used.parameter) if used else ("", "")
    return [
        row for row in rows if row.paper or row.curve == curve or row.parameter == parameter
    ], used


def sentence(benchmark: Benchmark, results: Results) -> str:
    """The default against the paper's method, of a benchmark that chooses by its error; "" where
    there is none, or no default was measured.
    """
    rows, used = _alternatives(benchmark, results)
    if used is None or benchmark.choice is None:
        return ""
    cost, error = (benchmark.column(key) for key in benchmark.charts[0])
    text = f"{error.label[0].upper()}{error.label[1:]}: {used.values[error.key].text} {error.unit}"
    text = f"{text.rstrip()} by default"
    for paper in (row for row in rows if row.paper):
        times = used.value(cost.key) / max(paper.value(cost.key), 1e-9)
        text += f", {paper.values[error.key].text} by the paper's method"
        text += f", at {times:.2g} times its {cost.label}"
    return f"{text}."


def headlines(results: Results) -> list[tuple[str, str, str]]:
    """(quantity, lfpipe, the paper's pipeline) of the README's figures, where a table has them."""
    row = next(
        (
            row
            for table in results.tables
            for row in table.rows
            if (table.of, row.name) == HEADLINE_ROW
        ),
        None,
    )
    if row is None:
        return []
    return [
        (f"{text}, {unit}", row.values[own].text, row.values[plain].text)
        for own, plain, text, unit in HEADLINES
    ]


def _headlines(results: Results) -> str:
    if not (cells := headlines(results)):
        return ""
    note = f"In brackets: the range over the phases of a camera {LESS}."
    table = html_table(("", "lfpipe", "the paper's pipeline"), cells)
    return f"{table}<p class=soft>{html.escape(note)}</p>"
