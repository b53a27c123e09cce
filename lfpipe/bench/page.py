"""The report of a run: one HTML page that begins with a summary and holds its tables as files."""

import base64
import html
import math
from pathlib import Path

from lfpipe.bench.benchmarks import BENCHMARKS, TABLE, Benchmark
from lfpipe.bench.results import STATES, Column, Results, Row, short
from lfpipe.bench.style import document, html_table
from lfpipe.bench.summary import chart, has_charts, summary
from lfpipe.files.safe_files import write_output
from lfpipe.host.worker import install_command

# Errors that differ by less than this share, or by less than a benchmark's `Choice.difference`, are
# equal for a verdict: noise of short sequences, and invisible differences.
TIE = 0.05
HOW = (
    "<h2>Method of measurement</h2><p class=soft>Times are CPU times of the thread, which other"
    " programs hardly affect. Each is the median of repetitions, interleaved in random order, with"
    " its 95 % interval, or with the range of fewer than five; of many repetitions, the first"
    " does not count. Errors of sequences have 95 % intervals by resampling; ratios over scripts,"
    " by resampling of the pairs. Metrics of cameras and screens have their range over the phases"
    " of the camera against the screen. results.json has every repetition. Lower left is better."
    "</p>"
)
WHAT_FAILED = (
    "<h2>Failures</h2><p class=soft>An exception, NaN, infinity, or a metric beyond the limit of"
    " its table. Cases that only other settings reach do not concern sessions with the defaults."
    "</p>"
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
    comparable = [row for row in measured if used is None or row.parameter == used.parameter]
    if not comparable:
        return None
    fitting = [row for row in comparable if row.values[cost.key].high <= choice.limit]
    unsure = [
        row for row in comparable if row.values[cost.key].low <= choice.limit and row not in fitting
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
        best = min(comparable, key=lambda row: row.value(cost.key))
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
    facts = f"{about['started']} · {about['machine']} · {wall_s:.0f} s of wall time"
    body = f"<p class=soft>{html.escape(facts)}</p>"
    body += "" if has_charts() else NO_CHARTS
    shown, text = next(
        ((one.name, text) for one, results in pairs if (text := summary(one, results))), ("", "")
    )
    body += text
    body += f"<p>Tables below, each as CSV.</p>{_verdicts(pairs)}<nav>{links}</nav>"
    sections = (_section(*pair, charts_from=int(pair[0].name == shown)) for pair in pairs)
    body += f"{''.join(sections)}{_failures(pairs)}{HOW}"
    page = document("Error against run time", body)
    write_output(out / "report.html", page.encode(), label="--out")
    return out / "report.html"


def _verdicts(pairs: Pairs) -> str:
    rows = [one for pair in pairs if (one := verdict(*pair))]
    head = ("setting", "for this machine and these inputs", "reason", "cost")
    text = html_table(head, rows, of="cards") if rows else ""
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
    rows += [
        (table.title, row.name, f"{column} {value.text}", f"only with {value.only}")
        if value.only
        else (table.title, row.name, f"{column} {value.text}", "yes: in use")
        for _, results in pairs
        for table, row, column, value in results.judged()
        if value.state == "failed"
    ]
    rows.sort(key=lambda row: row[3].startswith("only"))
    if not rows:
        return "<h2>Failures</h2><p>None.</p>"
    return WHAT_FAILED + html_table(("where", "case", "result", "relevant"), rows)


def _section(benchmark: Benchmark, results: Results, charts_from: int) -> str:
    """charts_from: the first chart that is not in the summary."""
    text = f'<h2 id="{benchmark.name}">{html.escape(benchmark.title)}</h2>'
    text += f"<p>{html.escape(benchmark.question)}</p>"
    text += (
        f'<p class="soft">The paper: {html.escape(benchmark.paper)}.</p>' if benchmark.paper else ""
    )
    text += f"<p><code>{html.escape(results.about['command'])}</code></p>"
    text += "".join(
        chart(benchmark, results.rows, *axes) for axes in benchmark.charts[charts_from:]
    )
    if results.left_out:
        reasons = "".join(f"<li>{html.escape(reason)}</li>" for reason in results.left_out)
        text += f"<p>Left out:</p><ul>{reasons}</ul>"
    for number, table in enumerate(results.tables, 1):
        data = base64.b64encode(table.csv().encode()).decode()
        file = f'<a download="{benchmark.name}-{number}.csv" href="data:text/plain;base64,{data}">'
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
        text += f"<details><summary>{title}</summary><p class=soft>{note} {file}CSV</a></p>"
        text += f"{html_table(head, body, classes)}</details>"
    facts = [(name, value) for name, value in results.about.items() if name != "command"]
    facts.append(("time", f"{results.wall_s:.0f} s"))
    return text + f"<details><summary>Conditions</summary>{html_table((), facts)}</details>"
