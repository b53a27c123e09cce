"""The first screen of a report: one chart, three sentences and the headline figures."""

import html

from lfpipe.bench.benchmarks import Benchmark
from lfpipe.bench.charts import chart
from lfpipe.bench.results import Results, Row
from lfpipe.bench.style import html_table

# (column, that of the paper's pipeline, text, unit) of HEADLINE_ROW: (table, row)
HEADLINES = (
    ("lag_ms", "plain_lag_ms", "lag behind a moving head", "ms"),
    ("error_views", "plain_error", "error of the viewpoint", "views"),
)
HEADLINE_ROW = "screen", "60 Hz"  # that most people have
LESS = "of 30 Hz and a screen of 60 Hz; less is better"


def summary(benchmark: Benchmark, results: Results) -> str:
    """HTML; "" for a benchmark without a chart, or whose default was not measured."""
    if not (texts := sentences(benchmark, results)):
        return ""
    lead, *others = map(html.escape, texts)
    text = f"<p class=lead><b>{lead}</b> {' '.join(others)}</p>"
    shown, _ = _alternatives(benchmark, results)
    return text + chart(benchmark, shown, *benchmark.charts[0]) + _headlines(results)


def _alternatives(benchmark: Benchmark, results: Results) -> tuple[list[Row], Row | None]:
    """The paper's methods and those that differ from the default in one setting; the default."""
    keys = {key for axes in benchmark.charts[:1] for key in axes}
    rows = [row for row in results.rows if keys and keys <= row.values.keys()]
    used = next((row for row in rows if row.used), None)
    curve, parameter = (used.curve, used.parameter) if used else ("", "")
    return [
        row for row in rows if row.paper or row.curve == curve or row.parameter == parameter
    ], used


def sentences(benchmark: Benchmark, results: Results) -> list[str]:
    """What the first chart shows; nothing where there is none, or no default was measured."""
    rows, used = _alternatives(benchmark, results)
    if used is None:
        return []
    cost, error = (benchmark.column(key) for key in benchmark.charts[0])

    def times(row: Row, base: Row) -> str:
        return f"{row.value(cost.key) / max(base.value(cost.key), 1e-9):.2g} times"

    own = f"{error.label[0].upper()}{error.label[1:]}: {used.values[error.key].text} {error.unit}"
    own = f"{own.rstrip()} by default"
    for paper in (row for row in rows if row.paper):
        own += f", {paper.values[error.key].text} by the paper's method"
        own += f", at {times(used, paper)} its {cost.label}"
    texts = [f"{own}."]
    others = [row for row in rows if not (row.used or row.paper)]
    if others:
        best = min(others, key=lambda row: row.value(error.key))
        texts.append(
            f"The alternative with the least error, {best.name}, has"
            f" {best.values[error.key].text} at {times(best, used)} that of the default."
        )
    tie = benchmark.choice.difference if benchmark.choice else 0.0
    better = [
        row.name
        for row in others
        if row.value(error.key) < used.value(error.key) - tie
        and row.value(cost.key) < used.value(cost.key)
    ]
    texts.append(
        f"Better in both: {', '.join(better)}."
        if better
        else "Nothing in this chart is better in both."
    )
    return texts


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
