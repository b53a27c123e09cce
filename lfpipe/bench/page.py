"""The report of a run: one HTML page that begins with verdicts, and a summary in Markdown."""

import base64
import html
import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import attrs

from lfpipe.bench.charts import draw, in_dark, on_front
from lfpipe.bench.results import Chart, Choice, Row, Subject, SubjectResults, Table, short
from lfpipe.bench.runner import SUBJECTS
from lfpipe.bench.style import STYLE
from lfpipe.errors import UserError

TIE = 0.05  # errors that differ by less than this share are equal for a verdict


@attrs.frozen
class Verdict:
    """What to use for this machine and these inputs, why, and its cost."""

    question: str
    choice: str
    why: str
    cost: str


def verdict(subject: Subject, found: SubjectResults) -> Verdict | None:
    """The choice of a subject: the least error among what fits its limit of cost; what is in use, if that ties."""
    if subject.choice is None:
        return None
    choice, x, y = subject.choice, subject.figure(subject.choice.x), subject.figure(subject.choice.y)
    every = [row for row in found.rows if math.isfinite(row.value(x.key))]
    used = next((row for row in every if row.used), None)
    rows = [row for row in every if used is None or row.knob == used.knob]
    known = [row for row in rows if math.isfinite(row.value(y.key))]
    if not rows:
        return None
    if not known:
        cheapest = used or min(rows, key=lambda row: row.value(x.key))
        return Verdict(
            choice.key, _named(cheapest), f"no error can be measured: {_reasons(found)}", _cost(cheapest, subject, choice)
        )
    fitting = [row for row in known if row.value(x.key) <= choice.limit] or known
    least = min(row.value(y.key) for row in fitting)
    ties = [row for row in fitting if row.value(y.key) <= least * (1 + TIE)]
    best = used if used in ties and used is not None else min(ties, key=lambda row: row.value(x.key))
    why = f"{y.label} {short(best.value(y.key))}{f' {y.unit}' if y.unit else ''}"
    why += ", the least" if best.value(y.key) <= least else f", within {TIE:.0%} of the least"
    if math.isfinite(choice.limit):
        why += f" of what takes at most {short(choice.limit)} {x.unit} ({choice.reason})"
    for row in every:
        if row.paper and row is not best:
            why += f"; the paper's way ({row.name}): {short(row.value(y.key))} for {short(row.value(x.key))} {x.unit}"
            break
    if used is not None and best is not used and used in known:
        why += f"; in use now ({used.name}): {short(used.value(y.key))} for {short(used.value(x.key))} {x.unit}"
    return Verdict(choice.key, _named(best), why, _cost(best, subject, choice))


def _named(row: Row) -> str:
    return row.name + (" (in use)" if row.used else "")


def _cost(row: Row, subject: Subject, choice: Choice) -> str:
    x = subject.figure(choice.x)
    return f"{row.figures[x.key].text} {x.unit}: {x.label}"


def _reasons(found: SubjectResults) -> str:
    return "; ".join(item.why for item in found.skipped) or "see below"


def write_report(results: dict[str, SubjectResults], out: Path) -> Path:
    """Writes report.html, summary.md and the charts as SVG; returns the path of the page. Raises UserError."""
    try:
        (out / "charts").mkdir(exist_ok=True)
        sections = "".join(_section(SUBJECTS[name], found, out / "charts") for name, found in results.items())
        links = " ".join(f'<a href="#{name}">{html.escape(SUBJECTS[name].title)}</a>' for name in results)
        wall_s, cpu_s = sum(one.wall_s for one in results.values()), sum(one.cpu_s for one in results.values())
        page = (
            '<!doctype html><!-- written by lfpipe --><html lang="en">'
            '<head><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
            f"<title>lfpipe bench</title><style>{STYLE}</style></head><body><h1>Error against run time</h1>"
            f"<p class=soft>Measured in {wall_s:.0f} s of wall time, {cpu_s:.0f} s of CPU.</p>"
            f"{_busy(results)}{_verdicts(results)}{_failures(results)}<nav>{links}</nav>{sections}{_how()}</body></html>"
        )
        path = out / "report.html"
        path.write_text(page)
        (out / "summary.md").write_text(summary(results))
    except OSError as error:
        raise UserError(f"{out}: cannot be written: {error.strerror}", "choose another folder with --out DIR") from None
    return path


def table(head: Sequence[str], rows: Sequence[Sequence[str]], states: Sequence[str] = ()) -> str:
    """An HTML table of texts. states: a class of each row."""
    body = ""
    for k, row in enumerate(rows):
        body += f'<tr class="{states[k] if states else ""}">' + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>"
    return f'<div class="wide"><table><tr>{"".join(f"<th>{html.escape(name)}</th>" for name in head)}</tr>{body}</table></div>'


def _busy(results: dict[str, SubjectResults]) -> str:
    """A warning if the machine did much else: times of such a run say little."""
    texts = [re.search(r"(\d+) cores.*load ([\d.]+)", found.about.get("machine", "")) for found in results.values()]
    if busy := [(int(text[1]), float(text[2])) for text in texts if text and float(text[2]) > 1.5 * int(text[1])]:
        cores, load = max(busy, key=lambda pair: pair[1])
        return f"<p><b>The machine was busy</b> (load {load:g} on {cores} cores): errors hold, times are longer than usual.</p>"
    return ""


def _verdicts(results: dict[str, SubjectResults]) -> str:
    found = [one for name, values in results.items() if (one := verdict(SUBJECTS[name], values))]
    rows = [(one.question, one.choice, one.why, one.cost) for one in found]
    text = table(("setting", "for this machine and these inputs", "why", "what it costs"), rows) if rows else ""
    facts = [f"{SUBJECTS[name].title}: {fact}" for name, values in results.items() if (fact := _fact(values))]
    return f"<h2>Verdicts</h2>{text}<ul>{''.join(f'<li>{html.escape(fact)}</li>' for fact in facts)}</ul>"


def _fact(found: SubjectResults) -> str:
    """A subject without a choice in words: the figures of its chart, or the cells of what is in use."""
    subject = SUBJECTS[found.name]
    charts = [chart for chart in subject.charts if isinstance(chart, Chart)]
    if charts and subject.choice is None:
        keys = [subject.figure(key) for key in dict.fromkeys([*(chart.y for chart in charts), charts[0].x])]
        marked = [row for row in found.rows if row.used or row.paper]
        texts = [f"{row.name} ({'in use' if row.used else 'the paper'}) " + ", ".join(short(row.value(key.key)) for key in keys)
                 for row in marked]  # fmt: skip
        return f"{'; '.join(key.axis for key in keys)}: {'; '.join(texts)}" if marked else ""
    cells = [cell for one in found.tables for row in one.rows for cell in row if cell.state]
    if not cells:
        return ""
    states = [cell.state for cell in cells if not cell.only]
    counts = ", ".join(f"{states.count(state)} {state}" for state in ("ok", "degraded", "failed"))
    others = sum(cell.state != "ok" for cell in cells if cell.only)
    return f"of what is in use {counts}" + (f"; {others} not ok, reached only with other settings" if others else "")


def _failures(results: dict[str, SubjectResults]) -> str:
    """What failed: methods that raised an exception, and cells of tables, each with whether it matters."""
    rows = [(SUBJECTS[name].title, one, why, "yes") for name, found in results.items() for one, why in found.failures.items()]
    for one in (one for found in results.values() for one in found.tables):
        grouped: dict[tuple[str, str, str], list[str]] = {}  # state, row or "", setting -> what
        for row, column, cell in one.failures():
            case = row if cell.state == "failed" else ""
            grouped.setdefault((cell.state, case, cell.only), []).append(f"{column} {cell.text}" if case else row)
        for (_, case, only), what in grouped.items():
            cases = case or ", ".join(dict.fromkeys(what))
            texts = f"failed: {'; '.join(what)}" if case else f"degraded in {len(what)} of the table below"
            rows.append((one.title, cases, texts, f"only with {only}" if only else "yes: in use"))
    if not rows:
        return "<h2>What failed</h2><p>Nothing.</p>"
    rows.sort(key=lambda row: (not row[3].startswith("yes"), not row[2].startswith("failed")))
    return "<h2>What failed</h2>" + table(("where", "case", "what", "does it matter?"), rows)


def _how() -> str:
    return (
        "<h2>How it was measured</h2><p class=soft>Times are medians. After a warm-up, methods take turns in random order until"
        " the 95 % interval of the median is narrower than 5 % or the time budget is spent; ± is half that interval (of whole"
        " sessions: over parts of half a second). If there are too few turns for an interval, their number and range are shown."
        " Both axes are logarithmic; an exact 0 is drawn at the edge. Lower left is better. Circles: nothing else is better"
        " in one figure and as good in the other; what differs by less than the intervals is equal. Square: in use"
        " by default. Star: the paper.</p>"
    )


def _section(subject: Subject, found: SubjectResults, folder: Path) -> str:
    text = f'<h2 id="{subject.name}">{html.escape(subject.title)}</h2><p>{_prose(subject.question)}</p>'
    if subject.paper:
        text += f'<p class="soft">The paper: {_prose(subject.paper)}.</p>'
    text += f"<p><code>{html.escape(found.about.get('command', ''))}</code></p>"
    if choice := verdict(subject, found):
        text += f"<p><b>{html.escape(choice.choice)}</b>: {html.escape(choice.why)}.</p>"
    for chart in subject.charts:
        if svg := draw(subject, found, chart):
            (folder / f"{chart.name}.svg").write_text(svg)
            text += _picture(svg, chart.title)
    text += "".join(_cells(one) for one in found.tables)
    if reasons := [f"{item.what}: {item.why}" for item in found.skipped]:
        text += f"<h3>Left out</h3><ul>{''.join(f'<li>{html.escape(reason)}</li>' for reason in reasons)}</ul>"
    if found.rows:
        text += _figures(subject, found)
    facts = [(name, value) for name, value in found.about.items() if name != "command"]
    facts.append(("time", f"{found.wall_s:.0f} s of wall time, {found.cpu_s:.0f} s of CPU"))
    return text + f"<details><summary>Conditions</summary>{table((), facts)}</details>"


def _prose(text: str) -> str:
    """Escaped, with backticks as code."""
    return re.sub("`([^`]*)`", r"<code>\1</code>", html.escape(text))


def _picture(svg: str, title: str) -> str:
    light, dark = ("data:image/svg+xml;base64," + base64.b64encode(one.encode()).decode() for one in (svg, in_dark(svg)))
    source = f'<source media="(prefers-color-scheme: dark)" srcset="{dark}">'
    return f'<picture>{source}<img alt="{html.escape(title)}" src="{light}"></picture>'


def shown_rows(subject: Subject, found: SubjectResults) -> list[Row]:
    """The rows of the summary: the best of any chart, the paper's, and always what is in use."""
    best = {row.name for chart in subject.charts if isinstance(chart, Chart) for row in on_front(found, chart)}
    return [row for row in found.rows if row.name in best or row.paper or row.used or not best]


def _marked(row: Row) -> str:
    return row.name + (" ■" if row.used else "") + (" ★" if row.paper else "")


def _figures(subject: Subject, found: SubjectResults) -> str:
    figures = [f for f in subject.figures if any(f.key in row.figures for row in found.rows)]
    best = shown_rows(subject, found)
    rows = [[_marked(row), *(row.figures[f.key].text if f.key in row.figures else "" for f in figures)] for row in found.rows]
    states = [("front" if row in best else "") + (" paper" if row.paper else "") for row in found.rows]
    what = f"All figures of {len(found.rows)} methods. Bold: best of a chart, or ■ in use, ★ the paper."
    body = table(("method", *(figure.axis for figure in figures)), rows, states)
    return f"<details><summary>{what}</summary>{body}</details>"


def _cells(one: Table) -> str:
    head = "".join(f"<th>{html.escape(text)}</th>" for text in one.head)
    rows = "".join(
        "<tr>" + "".join(f'<td class="{cell.state}">{html.escape(cell.text)}</td>' for cell in row) + "</tr>" for row in one.rows
    )
    body = f'<div class="wide"><table><tr>{head}</tr>{rows}</table></div>'
    return f"<details><summary>{html.escape(one.title)}</summary><p class=soft>{html.escape(one.note)}</p>{body}</details>"


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in (head, ["---"] * len(head), *rows)]
    return "\n".join(lines) + "\n"


def summary(results: dict[str, SubjectResults]) -> str:
    """The run in Markdown, for a pull request: verdicts, and the best rows, the paper's, and those in use."""
    head = ["<!-- written by lfpipe -->", "## lfpipe bench", ""]
    return "\n".join([*head, *_summary_lines(results), "■ in use by default, ★ what the paper does.", ""])


def _summary_lines(results: dict[str, SubjectResults]) -> Iterator[str]:
    for name, found in results.items():
        subject, about = SUBJECTS[name], found.about
        inputs = "; ".join(about[key] for key in ("scene", "sequence") if key in about)
        where = f"`{about.get('command', '')}` at {about.get('commit', '')}, {about.get('machine', '')}"
        yield from (f"### {subject.title}", "", "; ".join(filter(None, (where, inputs))), "")
        if choice := verdict(subject, found):
            yield from (f"**{choice.question}: {choice.choice}**: {choice.why}. {choice.cost}.", "")
        if found.rows:
            keys = list(dict.fromkeys(key for chart in subject.charts if isinstance(chart, Chart) for key in (chart.y, chart.x)))
            figures = [f for f in subject.figures if f.key in keys and any(f.key in row.figures for row in found.rows)]
            rows = [[_marked(row), *(row.figures[f.key].text if f.key in row.figures else "" for f in figures)]
                    for row in shown_rows(subject, found)]  # fmt: skip
            yield markdown_table(("method", *(figure.axis for figure in figures)), rows)
        if fact := _fact(found):
            yield from (f"- {fact}", "")
        yield from (f"- failed: {one}: {why}" for one, why in found.failures.items())
        yield from (f"- left out: {item.what}: {item.why}" for item in found.skipped)
        yield ""
