"""The report of a run: one HTML page with verdicts first, then charts of error against run time."""

import base64
import html
import importlib.util
import io
import math
from pathlib import Path
from typing import Any

from lfpipe.bench.benchmarks import BENCHMARKS, TABLE, Benchmark
from lfpipe.bench.results import STATES, Column, Results, Row, short
from lfpipe.bench.style import document, html_table
from lfpipe.files.output import write_output
from lfpipe.host.machine import install_command

# Errors that differ by less than this share, or by less than a benchmark's `Choice.difference`, are
# equal for a verdict: noise of short sequences, and invisible differences.
TIE = 0.05
MARKERS = "osD^vPX<>h"
# distinguishable with a colour vision deficiency
COLOURS = ("#0072b2", "#d55e00", "#008a63", "#b1548f", "#8a6d00", "#4b4fc4", "#7a7f86")
HOW = (
    "<h2>Method of measurement</h2><p class=soft>Times are CPU times of the thread, which other"
    " programs hardly affect. Each is the median of repetitions, interleaved in random order, with"
    " its 95 % interval, or with the range of fewer than five; of many repetitions, the first"
    " does not count. Errors of sequences have 95 % intervals by resampling; ratios over scripts,"
    " by resampling of the pairs. Metrics of cameras and screens have their range over the phases"
    " of the camera against the screen. results.json has every repetition. Axes are logarithmic;"
    " an exact 0 is drawn at the edge. Lower left is better. Square, bold: in use by default. Star,"
    " red: the paper.</p>"
)
CITE = (
    "<h2>To cite</h2><p class=soft>Cite lfpipe by CITATION.cff of its repository; state the"
    " version, the machine and the command above.</p>"
)
WHAT_FAILED = (
    "<h2>Failures</h2><p class=soft>Failed: an exception, NaN, infinity, or a metric beyond the"
    " limit of its table. Degraded: within that limit, but worse than ok. Cases that only other"
    " settings reach do not concern sessions with the defaults.</p>"
)
NO_CHARTS = (
    "<p>Without charts: matplotlib is not installed"
    f" (<code>{html.escape(install_command('matplotlib'))}</code>).</p>"
)
Pairs = list[tuple[Benchmark, Results]]
Verdict = tuple[str, str, str, str]


def verdict(benchmark: Benchmark, results: Results) -> Verdict | None:
    """The choice of a benchmark: the least error among methods within its limit of cost; the method
    in use if it ties; undecided if an interval contains the limit. Returns the configuration key,
    the recommendation for this machine and these inputs, the reason, and the cost; None if the
    benchmark decides nothing, or no method has both an error and a cost.
    """
    choice = benchmark.choice
    if choice is None:
        return None
    cost, error = (benchmark.column(key) for key in benchmark.charts[0])
    measured = [row for row in results.rows if {cost.key, error.key} <= row.values.keys()]
    used = next((row for row in measured if row.used), None)
    known = [row for row in measured if used is None or row.parameter == used.parameter]
    if not known:
        return None
    fitting = [row for row in known if row.values[cost.key].high <= choice.limit]
    unsure = [
        row for row in known if row.values[cost.key].low <= choice.limit and row not in fitting
    ]
    least = min((row.value(error.key) for row in fitting), default=math.inf)
    tie = max(TIE * least, choice.difference) if fitting else 0.0
    better = [row for row in unsure if row.value(error.key) < least - tie]
    limit = f"{short(choice.limit)} {cost.unit} ({choice.reason})"
    if better:
        best = min(better, key=lambda row: row.value(error.key))
        why = (
            f"{_cost(best, cost)}: the interval contains the limit, {limit}; measure it separately"
        )
        return choice.key, f"undecided: {_named(best)}", why, _cost(best, cost)
    if not fitting:
        best = min(known, key=lambda row: row.value(cost.key))
        why = f"the cheapest: none takes at most {limit}"
    else:
        ties = [row for row in fitting if row.value(error.key) <= least + tie]
        best = used if used in ties and used else min(ties, key=lambda row: row.value(cost.key))
        rank = (
            "the least" if best.value(error.key) <= least else f"within {short(tie)} of the least"
        )
        at = f" at {best.parameter}" if best.parameter else ""
        why = f"{error.label} {best.values[error.key].text} {error.unit}".rstrip()
        why += f", {rank} of the {len(fitting)} methods{at} that take at most {limit}"
        paper = next((row for row in measured if row.paper), None)
        for what, row in (("the paper's method", paper), ("in use now", used)):
            if row is not None and row is not best:
                figures = f"{short(row.value(error.key))} for {short(row.value(cost.key))}"
                why += f"; {what} ({row.name}): {figures} {cost.unit}"
    return choice.key, _named(best), why, _cost(best, cost)


def _named(row: Row) -> str:
    return row.name + " (in use)" * row.used


def _cost(row: Row, cost: Column) -> str:
    return f"{row.values[cost.key].text} {cost.unit}: {cost.label}"


def write_report(results: dict[str, Results], out: Path) -> Path:
    """Writes report.html and returns its path. Raises UserError."""
    benchmarks = BENCHMARKS | {TABLE.name: TABLE}
    pairs = [(benchmarks[name], one) for name, one in results.items()]
    links = " ".join(
        f'<a href="#{benchmark.name}">{html.escape(benchmark.title)}</a>' for benchmark, _ in pairs
    )
    about = pairs[0][1].about
    wall_s = sum(one.wall_s for one in results.values())
    facts = f"{about['started']}; {about['machine']}; {wall_s:.0f} s of wall time"
    body = f"<p class=soft>{html.escape(facts)}.</p>"
    body += "" if importlib.util.find_spec("matplotlib") else NO_CHARTS
    body += f"{_verdicts(pairs)}<nav>{links}</nav>"
    body += f"{''.join(_section(*pair) for pair in pairs)}{_failures(pairs)}{HOW}{CITE}"
    page = document("Error against run time", body)
    write_output(out / "report.html", page.encode(), label="--out")
    return out / "report.html"


def _verdicts(pairs: Pairs) -> str:
    rows = [one for pair in pairs if (one := verdict(*pair))]
    head = ("setting", "for this machine and these inputs", "reason", "cost")
    text = html_table(head, rows) if rows else ""
    for benchmark, results in pairs:
        judged = [value for *_, value in results.judged()]
        used = [value.state for value in judged if not value.only]
        others = sum(value.state != "ok" for value in judged if value.only)
        counts = ", ".join(f"{used.count(state)} {state}" for state in STATES)
        if others:
            counts += f"; {others} not ok, reached only with other settings"
        if judged:
            text += f"<p>{html.escape(benchmark.title)}: of the defaults, {counts}.</p>"
    return f"<h2>Verdicts</h2>{text}" if text else ""


def _failures(pairs: Pairs) -> str:
    """Failures: methods that raised an exception, and judged values, each with its relevance."""
    rows = [
        (benchmark.title, name, why, "yes")
        for benchmark, results in pairs
        for name, why in results.failures.items()
    ]
    degraded: dict[tuple[str, str], list[str]] = {}
    for _, results in pairs:
        for table, row, column, value in results.judged():
            matters = f"only with {value.only}" if value.only else "yes: in use"
            if value.state == "failed":
                rows.append((table.title, row.name, f"failed: {column} {value.text}", matters))
            elif value.state == "degraded":
                degraded.setdefault((table.title, matters), []).append(row.name)
    for (title, matters), cases in degraded.items():
        what = f"degraded: {len(cases)} values of the table"
        rows.append((title, "; ".join(dict.fromkeys(cases)), what, matters))
    rows.sort(key=lambda row: (row[3].startswith("only"), row[2].startswith("degraded")))
    if not rows:
        return "<h2>Failures</h2><p>None.</p>"
    return WHAT_FAILED + html_table(("where", "case", "result", "relevant"), rows)


def _section(benchmark: Benchmark, results: Results) -> str:
    text = f'<h2 id="{benchmark.name}">{html.escape(benchmark.title)}</h2>'
    text += f"<p>{html.escape(benchmark.question)}</p>"
    text += (
        f'<p class="soft">The paper: {html.escape(benchmark.paper)}.</p>' if benchmark.paper else ""
    )
    text += f"<p><code>{html.escape(results.about['command'])}</code></p>"
    text += "".join(chart(benchmark, results, *axes) for axes in benchmark.charts)
    if results.left_out:
        reasons = "".join(f"<li>{html.escape(reason)}</li>" for reason in results.left_out)
        text += f"<p>Left out:</p><ul>{reasons}</ul>"
    for table in results.tables:
        head, body = table.texts()
        classes = []
        for row in table.rows:
            marks = "used " * row.used + "paper " * row.paper
            states = (
                row.values[one.key].state if one.key in row.values else "" for one in table.filled
            )
            classes.append([marks, *(marks + state for state in states)])
        title = html.escape(table.title or f"All metrics of {len(table.rows)} methods")
        note = html.escape(table.note or "■ in use, ★ the paper.")
        text += f"<details><summary>{title}</summary><p class=soft>{note}</p>"
        text += f"{html_table(head, body, classes)}</details>"
    facts = [(name, value) for name, value in results.about.items() if name != "command"]
    facts.append(("time", f"{results.wall_s:.0f} s"))
    return text + f"<details><summary>Conditions</summary>{html_table((), facts)}</details>"


def chart(benchmark: Benchmark, results: Results, x: str, y: str) -> str:
    """The chart of two columns on logarithmic axes, as an HTML image; "" if it has no points, or
    without matplotlib.
    """
    rows = [row for row in results.rows if row.value(x) >= 0 and row.value(y) >= 0]
    if not rows or not importlib.util.find_spec("matplotlib"):
        return ""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    title = f"{benchmark.column(y).label} against {benchmark.column(x).label}"
    style: Any = {
        "svg.fonttype": "none",
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.formatter.min_exponent": 3,
    }
    with mpl.rc_context(style):
        figure = Figure(figsize=(9.0, 4.8), layout="constrained")
        axes = figure.add_subplot(
            xlabel=benchmark.column(x).axis,
            ylabel=benchmark.column(y).axis,
            title=title,
        )
        for k, curve in enumerate(dict.fromkeys(row.curve for row in rows)):
            points = [row for row in rows if row.curve == curve]
            axes.errorbar(
                [row.value(x) for row in points],
                [row.value(y) for row in points],
                xerr=_bars(points, x),
                yerr=_bars(points, y),
                marker=MARKERS[k % len(MARKERS)],
                color=COLOURS[k % len(COLOURS)],
                label=curve,
                capsize=2,
                linewidth=1,
            )
        for label, marker, face, marked in (
            ("in use", "s", "none", [row for row in rows if row.used]),
            ("the paper", "*", "#e5484d", [row for row in rows if row.paper]),
        ):
            axes.scatter(
                [row.value(x) for row in marked],
                [row.value(y) for row in marked],
                s=190,
                marker=marker,
                facecolors=face,
                edgecolors="#1b1f24",
                zorder=4,
                label=label,
            )
        for set_scale, key in ((axes.set_xscale, x), (axes.set_yscale, y)):
            above = [row.value(key) for row in rows if row.value(key) > 0]
            set_scale("symlog", linthresh=min(above, default=1.0), linscale=0.4)
        axes.grid(True, color="#e4e7eb")
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
        out = io.StringIO()
        figure.savefig(out, format="svg", metadata={"Date": None})
    data = base64.b64encode(out.getvalue().encode()).decode()
    return f'<img alt="{html.escape(title)}" src="data:image/svg+xml;base64,{data}">'


def _bars(rows: list[Row], key: str) -> tuple[list[float], list[float]]:
    """The lengths of error bars, down and up."""
    values = [row.values[key] for row in rows]
    return [one.value - one.low for one in values], [one.high - one.value for one in values]
