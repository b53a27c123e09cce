"""The report of a run: one HTML page that begins with verdicts."""

import base64
import html
import re
from pathlib import Path

import attrs

from lfpipe.bench.charts import draw, front
from lfpipe.bench.results import STATES, Results, Row, short
from lfpipe.bench.style import document, html_table
from lfpipe.bench.subjects import SUBJECTS, TABLE, Subject
from lfpipe.files.output import write_output

TIE = 0.05  # errors that differ by less than this share are equal for a verdict
HOW = (
    "<h2>How it was measured</h2><p class=soft>Times are medians. After a warm-up, methods take turns in random order until"
    " the time budget is spent; ± is half the 95 % interval of the median. If there are too few turns for an interval, their"
    " number and range are shown. Both axes are logarithmic; an exact 0 is drawn at the edge. Lower left is better. Circles:"
    " nothing else is better in one figure and as good in the other; what differs by less than the intervals is equal."
    " Square: in use by default. Star: the paper.</p>"
)
Pairs = list[tuple[Subject, Results]]


@attrs.frozen
class Verdict:
    """What to use for this machine and these inputs, why, and its cost."""

    setting: str
    choice: str
    why: str
    cost: str


def verdict(subject: Subject, results: Results) -> Verdict | None:
    """The choice of a subject: the least error among what fits its limit of cost; what is in use, if that ties."""
    choice = subject.choice
    timed = [row for row in results.rows if choice is not None and subject.charts[0].x in row.values]
    if choice is None or not timed:
        return None
    x, y = subject.column(subject.charts[0].x), subject.column(subject.charts[0].y)
    used = next((row for row in timed if row.used), None)
    rows = [row for row in timed if used is None or row.knob == used.knob]
    known = [row for row in rows if y.key in row.values]

    def beside(row: Row) -> str:
        return f"({row.name}): {short(row.value(y.key))} for {short(row.value(x.key))} {x.unit}"

    if known:
        fitting = [row for row in known if row.value(x.key) <= choice.limit] or known
        least = min(row.value(y.key) for row in fitting)
        ties = [row for row in fitting if row.value(y.key) <= least * (1 + TIE)]
        best = used if used is not None and used in ties else min(ties, key=lambda row: row.value(x.key))
        why = f"{y.label} {short(best.value(y.key))}{f' {y.unit}' if y.unit else ''}"
        why += ", the least" if best.value(y.key) <= least else f", within {TIE:.0%} of the least"
        why += f" of what takes at most {short(choice.limit)} {x.unit} ({choice.reason})"
        paper = next((row for row in timed if row.paper and row is not best), None)
        why += f"; the paper's way {beside(paper)}" if paper else ""
        why += f"; in use now {beside(used)}" if used in known and used is not best and used else ""
    else:
        best = used or min(rows, key=lambda row: row.value(x.key))
        why = f"no error can be measured: {'; '.join(results.left_out) or 'see below'}"
    return Verdict(choice.key, best.name + " (in use)" * best.used, why, f"{best.values[x.key].text} {x.unit}: {x.label}")


def write_report(results: dict[str, Results], out: Path) -> Path:
    """Writes report.html and returns its path. Raises UserError."""
    subjects = SUBJECTS | {TABLE.name: TABLE}
    pairs = [(subjects[name], one) for name, one in results.items()]
    links = " ".join(f'<a href="#{subject.name}">{html.escape(subject.title)}</a>' for subject, _ in pairs)
    wall_s, cpu_s = sum(one.wall_s for one in results.values()), sum(one.cpu_s for one in results.values())
    body = f"<p class=soft>Measured in {wall_s:.0f} s of wall time, {cpu_s:.0f} s of CPU.</p>{_verdicts(pairs)}{_failures(pairs)}"
    body += f"<nav>{links}</nav>{''.join(_section(*pair) for pair in pairs)}{HOW}"
    write_output(out / "report.html", document("Error against run time", body).encode(), label="--out")
    return out / "report.html"


def _verdicts(pairs: Pairs) -> str:
    rows = [attrs.astuple(one) for pair in pairs if (one := verdict(*pair))]
    text = html_table(("setting", "for this machine and these inputs", "why", "what it costs"), rows) if rows else ""
    for subject, results in pairs:
        judged = [value for *_, value in results.judged()]
        used = [value.state for value in judged if not value.only]
        others = sum(value.state != "ok" for value in judged if value.only)
        counts = ", ".join(f"{used.count(state)} {state}" for state in STATES)
        others_text = f"; {others} not ok, reached only with other settings" if others else ""
        text += f"<p>{html.escape(subject.title)}: of what is in use {counts}{others_text}.</p>" if judged else ""
    return f"<h2>Verdicts</h2>{text}" if text else ""


def _failures(pairs: Pairs) -> str:
    """What failed: methods that raised an exception, and judged values, each with whether it matters."""
    rows = [(subject.title, one, why, "yes") for subject, results in pairs for one, why in results.failures.items()]
    grouped: dict[tuple[str, str, str], list[str]] = {}  # title, case of a failure or "", setting -> what
    for _, results in pairs:
        for table, row, column, value in results.judged():
            if value.state != "ok":
                case = row.name if value.state == "failed" else ""
                grouped.setdefault((table.title, case, value.only), []).append(f"{column} {value.text}" if case else row.name)
    for (title, case, only), what in grouped.items():
        words = f"failed: {'; '.join(what)}" if case else f"degraded in {len(what)} of the table below"
        rows.append((title, case or ", ".join(dict.fromkeys(what)), words, f"only with {only}" if only else "yes: in use"))
    rows.sort(key=lambda row: (not row[3].startswith("yes"), not row[2].startswith("failed")))
    return f"<h2>What failed</h2>{html_table(('where', 'case', 'what', 'does it matter?'), rows) if rows else '<p>Nothing.</p>'}"


def _section(subject: Subject, results: Results) -> str:
    text = f'<h2 id="{subject.name}">{html.escape(subject.title)}</h2><p>{_prose(subject.question)}</p>'
    text += f'<p class="soft">The paper: {_prose(subject.paper)}.</p>' if subject.paper else ""
    text += f"<p><code>{html.escape(results.about.get('command', ''))}</code></p>"
    if choice := verdict(subject, results):
        text += f"<p><b>{html.escape(choice.choice)}</b>: {html.escape(choice.why)}.</p>"
    for chart in subject.charts:
        if svg := draw(subject, results.rows, chart):
            data = base64.b64encode(svg.encode()).decode()
            text += f'<img alt="{html.escape(chart.title)}" src="data:image/svg+xml;base64,{data}">'
    if results.left_out:
        text += f"<p>Left out:</p><ul>{''.join(f'<li>{html.escape(reason)}</li>' for reason in results.left_out)}</ul>"
    best = {row.name for chart in subject.charts for row in front(results.rows, chart)}
    for table in results.tables:
        head, body = table.texts()
        classes = [
            ["", *(row.values[column.key].state for column in table.columns)] if not row.curve
            else [" ".join(["front"] * (row.name in best or row.used) + ["paper"] * row.paper)] for row in table.rows
        ]  # fmt: skip
        note = table.note or "Bold: best of a chart, or ■ in use, ★ the paper."
        title = table.title or f"All figures of {len(table.rows)} methods"
        text += f"<details><summary>{html.escape(title)}</summary><p class=soft>{html.escape(note)}</p>"
        text += f"{html_table(head, body, classes)}</details>"
    facts = [(name, value) for name, value in results.about.items() if name != "command"]
    facts.append(("time", f"{results.wall_s:.0f} s of wall time, {results.cpu_s:.0f} s of CPU"))
    return text + f"<details><summary>Conditions</summary>{html_table((), facts)}</details>"


def _prose(text: str) -> str:
    """Escaped, with backticks as code."""
    return re.sub("`([^`]*)`", r"<code>\1</code>", html.escape(text))
