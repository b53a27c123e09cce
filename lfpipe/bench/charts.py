"""Charts with matplotlib, in a light and a dark theme."""

import io
import math
import re
from typing import Any

import attrs
import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

from lfpipe.bench.results import Chart, Profile, Row, Subject, SubjectResults, short
from lfpipe.bench.stats import front

SIZE_IN, DPI = (9.0, 4.6), 100
MARKERS = "osD^vPX<>h"
PAPER_RED = "#e5484d"


@attrs.frozen
class Theme:
    """Colours. curves: distinguishable with a colour vision deficiency, and by their markers."""

    paper: str
    ink: str
    soft: str
    grid: str
    curves: tuple[str, ...]


LIGHT = Theme("#ffffff", "#1b1f24", "#57606a", "#e4e7eb",
              ("#0072b2", "#d55e00", "#008a63", "#b1548f", "#8a6d00", "#4b4fc4", "#7a7f86"))  # fmt: skip
DARK = Theme("#14171c", "#e8eaed", "#a4abb5", "#2b3038",
             ("#56b4e9", "#ff9150", "#3ccf9f", "#e58fc6", "#e8c547", "#9aa0ff", "#b5bac2"))  # fmt: skip


@attrs.frozen
class Point:
    """A row on a chart. zero: whether x and y are exactly 0; they are drawn at the edge, as a logarithmic axis has no 0."""

    row: Row
    x: float
    y: float
    zero: tuple[bool, bool]


def points(found: SubjectResults, chart: Chart) -> list[Point]:
    """The rows that have both figures. 0 is drawn at a third of the smallest other value."""
    rows = [(row, row.value(chart.x), row.value(chart.y)) for row in found.rows]
    rows = [(row, x, y) for row, x, y in rows if x >= 0 and y >= 0]
    floors = [min((v for v in axis if v > 0), default=1.0) / 3 for axis in ([x for _, x, _ in rows], [y for *_, y in rows])]
    return [Point(row, x or floors[0], y or floors[1], (x == 0, y == 0)) for row, x, y in rows]


def on_front(found: SubjectResults, chart: Chart) -> list[Row]:
    """The rows on the Pareto front of a chart, from left to right; what ties within its intervals ties."""
    rows = [point.row for point in points(found, chart)]
    both = [(row.figures[chart.x], row.figures[chart.y]) for row in rows]
    return [rows[k] for k in front([(x.value, x.half, y.value, y.half) for x, y in both])]


def draw(subject: Subject, found: SubjectResults, chart: Chart | Profile) -> str | None:
    """The chart as SVG in the light theme; None if it holds no point."""
    style: Any = {
        "svg.hashsalt": "lfpipe", "svg.fonttype": "none", "font.size": 10, "font.family": "DejaVu Sans", "text.color": LIGHT.ink,
        "axes.labelcolor": LIGHT.ink, "axes.edgecolor": LIGHT.soft, "xtick.color": LIGHT.soft, "ytick.color": LIGHT.soft,
        "axes.facecolor": LIGHT.paper, "figure.facecolor": LIGHT.paper, "savefig.facecolor": LIGHT.paper,
    }  # fmt: skip
    with mpl.rc_context(style):
        canvas = Canvas(figsize=SIZE_IN, dpi=DPI, layout="constrained")
        axes = canvas.add_subplot()
        filled = _scatter(axes, subject, found, chart) if isinstance(chart, Chart) else _profile(axes, subject, found, chart)
        if not filled:
            return None
        axes.set_title(chart.title, loc="left", fontsize=12, fontweight="bold", color=LIGHT.ink)
        axes.grid(True, which="major", color=LIGHT.grid, linewidth=0.8)
        axes.set_axisbelow(True)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
        handles, labels = axes.get_legend_handles_labels()
        canvas.legend(handles, labels, loc="outside right upper", frameon=False, fontsize=9, labelcolor=LIGHT.ink)
        out = io.StringIO()
        canvas.savefig(out, format="svg", metadata={"Date": None, "Creator": "lfpipe bench"})  # equal results, equal files
        return out.getvalue()


def in_dark(svg: str) -> str:
    """A chart in the dark theme."""
    pairs = [(getattr(LIGHT, name), getattr(DARK, name)) for name in ("paper", "ink", "soft", "grid")]
    colours = dict([*pairs, *zip(LIGHT.curves, DARK.curves, strict=True)])
    return re.sub("|".join(colours), lambda match: colours[match[0]], svg)


def _scatter(axes: Axes, subject: Subject, found: SubjectResults, chart: Chart) -> bool:
    drawn = points(found, chart)
    curves = list(dict.fromkeys(point.row.curve for point in drawn))
    for k, curve in enumerate(curves):
        colour, marker = LIGHT.curves[k % len(LIGHT.curves)], MARKERS[k % len(MARKERS)]
        of = [point for point in drawn if point.row.curve == curve]
        for j, line in enumerate(dict.fromkeys(point.row.line for point in of)):
            xs, ys = zip(*((p.x, p.y) for p in of if p.row.line == line), strict=True)
            axes.plot(xs, ys, marker=marker, color=colour, linewidth=1.4, markersize=6, label=None if j else curve)
    best = {row.name for row in on_front(found, chart)}
    marks = (("best: nothing is better in both", "o", best), ("in use", "s", {p.row.name for p in drawn if p.row.used}),
             ("the paper", "*", {p.row.name for p in drawn if p.row.paper}))  # fmt: skip
    for label, marker, names in marks:
        if some := [(point.x, point.y) for point in drawn if point.row.name in names]:
            face, edge_colour = (PAPER_RED, LIGHT.paper) if marker == "*" else ("none", LIGHT.ink)
            xs, ys = zip(*some, strict=True)
            axes.scatter(xs, ys, s={"o": 110}.get(marker, 190), marker=marker, facecolors=face, zorder=4,
                         edgecolors=edge_colour, label=label)  # fmt: skip
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.margins(0.09, 0.12)
    for at, (axis, key) in enumerate(((axes.xaxis, chart.x), (axes.yaxis, chart.y))):
        low, high = axis.get_view_interval()
        locator = LogLocator(subs=(1.0,) if high / max(low, 1e-300) > 60 else (1.0, 2.0, 5.0))
        axis.set_major_locator(locator)
        axis.set_major_formatter(FuncFormatter(lambda value, _: short(value)))
        axis.set_minor_formatter(NullFormatter())
        axis.set_label_text(subject.figure(key).axis)
        edge = next(((p.x, p.y)[at] for p in drawn if p.zero[at]), None)
        if edge is not None:  # no tick closer to the edge that stands for 0 than a factor of 1.8
            above = [float(tick) for tick in locator.tick_values(low, high) if edge * 1.8 < tick <= high]
            axis.set_ticks([edge, *above], labels=["0", *map(short, above)])
            axis.set_minor_locator(NullLocator())
    return bool(drawn)


def _profile(axes: Axes, subject: Subject, found: SubjectResults, profile: Profile) -> bool:
    rows = [row for row in found.rows if row.knob in profile.knobs]
    for k, row in enumerate(rows):
        ys = [row.value(key) for _, key in profile.keys]
        colour, marker = LIGHT.curves[k % len(LIGHT.curves)], MARKERS[k % len(MARKERS)]
        label = f"{row.name} (the paper)" if row.paper else row.curve + (" (in use)" if row.used else "")
        axes.plot([x for x, _ in profile.keys], ys, marker=marker, color=PAPER_RED if row.paper else colour, linewidth=1.6,
                  linestyle="--" if row.paper else "-", label=label)  # fmt: skip
    if all(row.value(key) > 0 for row in rows for _, key in profile.keys if math.isfinite(row.value(key))):
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: short(value)))
        axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel(profile.x_axis)
    axes.set_ylabel(profile.y_axis)
    return any(math.isfinite(row.value(key)) for row in rows for _, key in profile.keys)
