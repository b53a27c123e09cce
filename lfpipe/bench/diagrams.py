"""Diagrams with matplotlib, in a light and a dark theme."""

import io
import math
import re
from pathlib import Path
from typing import Any

import attrs
import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.patheffects import Normal, Stroke
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

from lfpipe.bench.model import Diagram, Profile, Subject
from lfpipe.bench.results import Measured, SubjectResults
from lfpipe.bench.stats import pareto

SIZE_IN, DPI = (9.0, 5.4), 110
ABOVE_EDGE = 1.8  # no tick closer than this factor to the edge that represents 0
MARKERS = "osD^vPX<>h"


@attrs.frozen
class Theme:
    """Colours. curves: distinguishable with a colour vision deficiency, and by their markers."""

    name: str
    paper: str
    ink: str
    soft: str
    grid: str
    curves: tuple[str, ...]
    front: str


LIGHT = Theme("light", "#ffffff", "#1b1f24", "#57606a", "#e4e7eb",
              ("#0072b2", "#d55e00", "#008a63", "#b1548f", "#8a6d00", "#4b4fc4", "#7a7f86"), "#1b1f24")  # fmt: skip
DARK = Theme("dark", "#14171c", "#e8eaed", "#a4abb5", "#2b3038",
             ("#56b4e9", "#ff9150", "#3ccf9f", "#e58fc6", "#e8c547", "#9aa0ff", "#b5bac2"), "#e8eaed")  # fmt: skip


def short(value: float) -> str:
    """A number in short form: 0.05, 3.2, 120, 2e-06."""
    if value != 0 and not 1e-3 <= abs(value) < 1e5:
        return f"{value:.0e}"
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


@attrs.frozen
class Point:
    """A candidate on a diagram. x95: end of its whisker, or NaN. zero: whether x and y are exactly 0; they are then drawn at the
    edge, because a logarithmic axis has no 0."""

    one: Measured
    x: float
    y: float
    x95: float
    zero: tuple[bool, bool]


def points(subject: Subject, found: SubjectResults, diagram: Diagram) -> list[Point]:
    """The candidates that have both figures. 0 is drawn at a third of the smallest other value."""
    fx, fy = subject.figure(diagram.x), subject.figure(diagram.y)
    some = [(one, one.value(fx), one.value(fy)) for one in found.measured.values()]
    some = [(one, x, y) for one, x, y in some if math.isfinite(x) and math.isfinite(y) and x >= 0 and y >= 0]
    floors = [
        min((value for value in axis if value > 0), default=1.0) / 3 for axis in ([x for _, x, _ in some], [y for *_, y in some])
    ]
    whisker = subject.figure(diagram.whisker) if diagram.whisker else None
    return [
        Point(one, x or floors[0], y or floors[1], one.value(whisker) if whisker else math.nan, (x == 0, y == 0))
        for one, x, y in some
    ]


def draw(subject: Subject, found: SubjectResults, diagram: Diagram | Profile, theme: Theme = LIGHT) -> Canvas:
    """The diagram as a matplotlib figure. It must hold a point (see `results.empty_diagrams`)."""
    style: Any = {
        "svg.hashsalt": "lfpipe", "font.size": 10, "font.family": "DejaVu Sans", "text.color": theme.ink,
        "axes.labelcolor": theme.ink, "axes.edgecolor": theme.soft, "xtick.color": theme.soft, "ytick.color": theme.soft,
        "axes.facecolor": theme.paper, "figure.facecolor": theme.paper, "savefig.facecolor": theme.paper,
    }  # fmt: skip
    with mpl.rc_context(style):
        canvas = Canvas(figsize=SIZE_IN, dpi=DPI, layout="constrained")
        axes = canvas.add_subplot()
        labelled, shown = list[Point](), list[Point]()
        if isinstance(diagram, Diagram):
            labelled, shown = _work_precision(axes, subject, found, diagram, theme)
        else:
            _profile(axes, subject, found, diagram, theme)
        axes.set_title(diagram.title, loc="left", fontsize=12, fontweight="bold", color=theme.ink)
        axes.grid(True, which="major", color=theme.grid, linewidth=0.8)
        axes.set_axisbelow(True)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
        handles, labels = axes.get_legend_handles_labels()
        canvas.legend(handles, labels, loc="outside right upper", frameon=False, fontsize=9, labelcolor=theme.ink)
        canvas.draw_without_rendering()  # from here on the positions of points in px are known
        canvas.set_layout_engine("none")
        _label(axes, labelled, shown, theme)
        return canvas


def _work_precision(
    axes: Axes, subject: Subject, found: SubjectResults, diagram: Diagram, theme: Theme
) -> tuple[list[Point], list[Point]]:
    """Draws the points. Returns the points to label with their knobs, most important first, and all points."""
    shown = points(subject, found, diagram)
    curves: dict[str, list[Point]] = {}
    for point in shown:
        curves.setdefault(point.one.curve, []).append(point)
    for k, (name, of) in enumerate(curves.items()):
        colour, marker = theme.curves[k % len(theme.curves)], MARKERS[k % len(MARKERS)]
        xs, ys = [p.x for p in of], [p.y for p in of]
        whiskers = [max(0.0, p.x95 - p.x) if math.isfinite(p.x95) else 0.0 for p in of]
        if any(whiskers):
            axes.errorbar(
                xs, ys, xerr=[[0.0] * len(xs), whiskers], fmt="none", ecolor=colour, elinewidth=0.9, capsize=2, alpha=0.6
            )
        lines = list(dict.fromkeys(p.one.line for p in of))
        for line in lines:
            part = [(p.x, p.y) for p in of if p.one.line == line]
            label = name if line == lines[0] else None
            axes.plot(*zip(*part, strict=True), marker=marker, color=colour, linewidth=1.4, markersize=6, label=label, alpha=0.95)
    front = [shown[i] for i in pareto([(p.x, p.y) for p in shown])]
    xs, ys = [p.x for p in front], [p.y for p in front]
    axes.step(xs, ys, where="post", color=theme.front, linewidth=1.0, linestyle=(0, (1, 2)), zorder=1)
    axes.scatter(xs, ys, s=110, facecolors="none", edgecolors=theme.front, linewidths=1.2, zorder=4, label="Pareto front")
    paper = [p for p in shown if p.one.paper]
    if paper:
        axes.scatter([p.x for p in paper], [p.y for p in paper], s=230, marker="*", color="#e5484d", edgecolors=theme.paper,
                     linewidths=0.8, zorder=5, label="the paper")  # fmt: skip
    if diagram.guide:
        figure = subject.figure(diagram.guide[0])
        values = [v for v in (one.value(figure) for one in found.measured.values()) if math.isfinite(v)]
        if values:
            axes.axvline(float(np.median(values)), color=theme.soft, linewidth=1, linestyle="--", label=diagram.guide[1])
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.margins(0.09, 0.12)
    for axis, key in ((axes.xaxis, diagram.x), (axes.yaxis, diagram.y)):
        low, high = axis.get_view_interval()
        wide = high / max(low, 1e-300) > 60
        locator = LogLocator(subs=(1.0,) if wide else (1.0, 2.0, 5.0))
        axis.set_major_locator(locator)
        axis.set_major_formatter(FuncFormatter(lambda value, _: short(value)))
        axis.set_minor_formatter(NullFormatter())
        axis.set_label_text(subject.figure(key).axis)
        edge = next(((p.x, p.y)[key == diagram.y] for p in shown if p.zero[key == diagram.y]), None)
        if edge is not None:
            above = [float(tick) for tick in locator.tick_values(low, high) if edge * ABOVE_EDGE < tick <= high]
            axis.set_ticks([edge, *above], labels=["0", *map(short, above)])
            axis.set_minor_locator(NullLocator())
    return [*paper, *(p for p in front if not p.one.paper)], shown


def _label(axes: Axes, wanted: list[Point], shown: list[Point], theme: Theme) -> None:
    """Labels points with their knobs (with curve names if there is only one knob), each at the first of a few positions that
    overlaps no other label and no point; without a free position there is no label."""
    several = len({point.one.knob for point in wanted}) > 1
    occupied: list[tuple[float, float, float, float]] = []
    points_px = [axes.transData.transform((p.x, p.y)) for p in shown]
    spots = [axes.transData.transform((p.x, p.y)) for p in wanted]
    left, bottom, right, top = (float(v) for v in axes.get_window_extent().extents)
    for point, (x, y) in zip(wanted, spots, strict=True):
        text = point.one.knob if several else point.one.curve
        width, height = 5.9 * len(text), 13.0
        sides = [(9, y) for y in (7, -18, 22, -33)], [(-9 - width, y) for y in (7, -18, 22, -33)]
        for dx, dy in (*sides[0][:2], *sides[1][:2], *sides[0][2:], *sides[1][2:], (-width / 2, 26), (-width / 2, -39)):
            box = (x + dx, y + dy, x + dx + width, y + dy + height)
            free = all(box[2] < b[0] or b[2] < box[0] or box[3] < b[1] or b[3] < box[1] for b in occupied)
            free &= not any(box[0] - 5 < sx < box[2] + 5 and box[1] - 5 < sy < box[3] + 5 for sx, sy in points_px)
            if free and box[0] >= left and box[2] <= right + 20 and box[1] >= bottom and box[3] <= top + 10:
                occupied.append(box)
                scale = 72 / DPI
                halo = [Stroke(linewidth=2.6, foreground=theme.paper), Normal()]  # keeps letters readable on lines
                axes.annotate(text, (point.x, point.y), (dx * scale, dy * scale), textcoords="offset points", fontsize=8,
                              color=theme.ink, zorder=7, path_effects=halo)  # fmt: skip
                break


def _profile(axes: Axes, subject: Subject, found: SubjectResults, profile: Profile, theme: Theme) -> None:
    figures = [(x, subject.figure(key)) for x, key in profile.keys]
    for k, one in enumerate(one for one in found.measured.values() if one.knob in profile.knobs):
        ys = [one.value(figure) for _, figure in figures]
        colour = "#e5484d" if one.paper else theme.curves[k % len(theme.curves)]
        label = f"{one.curve}, {one.knob} (the paper)" if one.paper else one.curve
        marker = "*" if one.paper else MARKERS[k % len(MARKERS)]
        axes.plot([x for x, _ in figures], ys, marker=marker, markersize=10 if one.paper else 6, color=colour, linewidth=1.6,
                  linestyle="--" if one.paper else "-", label=label)  # fmt: skip
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: short(value)))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel(profile.x_axis)
    axes.set_ylabel(profile.y_axis)


def as_svg(canvas: Canvas) -> str:
    """The figure as SVG, without a date: equal results give equal files."""
    out = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": "lfpipe"}):
        canvas.savefig(out, format="svg", metadata={"Date": None, "Creator": "lfpipe bench"})
    return out.getvalue()


def in_theme(svg: str, theme: Theme) -> str:
    """Recolours a diagram drawn in LIGHT."""
    fields = [(getattr(LIGHT, f.name), getattr(theme, f.name)) for f in attrs.fields(Theme) if f.name not in ("name", "curves")]
    colours = dict([*fields, *zip(LIGHT.curves, theme.curves, strict=True)])
    return re.sub("|".join(colours), lambda found: colours[found[0]], svg)


def write(canvas: Canvas, path: Path) -> tuple[str, str]:
    """Writes path.png, path.svg and path-dark.svg of a diagram drawn in LIGHT; returns both SVGs."""
    canvas.savefig(path.with_suffix(".png"), metadata={"Software": "lfpipe bench"})
    svg = as_svg(canvas)
    dark = in_theme(svg, DARK)
    path.with_suffix(".svg").write_text(svg)
    path.with_name(f"{path.name}-dark.svg").write_text(dark)
    return svg, dark
