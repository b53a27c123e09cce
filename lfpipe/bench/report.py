"""The report of a run: a self-contained HTML page, the diagrams as PNG and SVG, and a Markdown summary."""

import base64
import html
import math
import re
from collections.abc import Iterator
from pathlib import Path

from lfpipe.bench.conclusion import conclusion
from lfpipe.bench.diagrams import draw, points, short, write
from lfpipe.bench.model import Diagram, Figure, Subject, Table
from lfpipe.bench.results import Measured, Results, SubjectResults, empty_diagrams
from lfpipe.bench.stats import pareto
from lfpipe.bench.subjects import SUBJECTS

STYLE = """
:root { color-scheme: light dark; --paper: #ffffff; --ink: #1b1f24; --soft: #57606a; --line: #d8dde3; --mark: #f4f6f8;
  --red: #c62a2f; --ok: #d9f2e4; --degraded: #fdeccb; --failed: #fbd5d5; }
@media (prefers-color-scheme: dark) { :root { --paper: #14171c; --ink: #e8eaed; --soft: #a4abb5; --line: #333943; --mark: #1c2027;
  --red: #ff7b7f; --ok: #173c2b; --degraded: #4a3710; --failed: #561d20; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1.5rem; max-width: 64rem; background: var(--paper); color: var(--ink);
  font: 16px/1.5 system-ui, "DejaVu Sans", sans-serif; }
h1 { font-size: 1.7rem; margin: 0 0 .2rem; }
h2 { margin: 2.6rem 0 .3rem; border-top: 1px solid var(--line); padding-top: 1.2rem; }
h3 { margin: 1.4rem 0 .3rem; font-size: 1rem; } p { margin: .3rem 0 .8rem; } .soft { color: var(--soft); }
nav a { margin-right: .9rem; } a { color: inherit; }
img { width: 100%; height: auto; display: block; margin: .6rem 0 1rem; border: 1px solid var(--line); border-radius: 6px; }
.wide { overflow-x: auto; } table { border-collapse: collapse; font-size: .84rem; margin: .3rem 0 1rem; }
th, td { text-align: left; padding: .22rem .6rem; border-bottom: 1px solid var(--line); vertical-align: top; }
th { background: var(--mark); font-weight: 600; }
td.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
.front { font-weight: 600; } .paper { color: var(--red); } .ok { background: var(--ok); }
.degraded { background: var(--degraded); }
.failed { background: var(--failed); } summary { cursor: pointer; } code { font-size: .9em; overflow-wrap: anywhere; }
"""


def write_report(results: Results, out: Path) -> Path:
    """Writes report.html, summary.md and the diagrams to out; returns the path of the page."""
    pictures = out / "diagrams"
    pictures.mkdir(exist_ok=True)
    sections = [_section(SUBJECTS[name], found, pictures) for name, found in results.subjects.items()]
    links = " ".join(f'<a href="#{name}">{html.escape(SUBJECTS[name].title)}</a>' for name in results.subjects)
    page = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>lfpipe bench</title><style>{STYLE}</style></head><body><h1>Error against run time</h1>{_conclusions(results)}"
        f"<nav>{links}</nav>{''.join(sections)}<h2>How it was measured</h2>{_about(results)}</body></html>"
    )
    path = out / "report.html"
    path.write_text(page)
    (out / "summary.md").write_text(summary(results))
    return path


def _conclusions(results: Results) -> str:
    """The findings, before all figures."""
    lines = [
        f'<li><a href="#{name}">{html.escape(SUBJECTS[name].title)}</a>: {html.escape(conclusion(SUBJECTS[name], found))}</li>'
        for name, found in results.subjects.items()
    ]
    return f"<ul>{''.join(lines)}</ul>"


def _about(results: Results) -> str:
    about = results.about
    machine = about["machine"]
    rows = {
        "command": f"<code>{html.escape(about['command'])}</code>",
        "scene": html.escape("; ".join(about["scenes"])),
        "sequence": html.escape(about["sequence"]),
        "machine": html.escape(f"{machine['processor']}, {machine['cores']} cores, {machine['system']}, load {machine['load']}"),
        "versions": html.escape(", ".join(f"{name} {version}" for name, version in about["versions"].items())),
        "commit": html.escape(about["commit"]),
        "started": html.escape(about["started"]),
    }
    body = "".join(f"<tr><th>{key}</th><td>{value}</td></tr>" for key, value in rows.items())
    how = (
        "Times are medians. After a warm-up, methods take turns in random order until the 95 % interval of the median is narrower"
        " than 5 % or the time budget is spent; ± is half that interval (of whole sessions: over parts of half a second)."
        " If there are too few turns for an interval, their number and range are shown. Whiskers end at the 95th percentile."
        " Both axes are logarithmic; an exact 0 is drawn at the edge. Lower left is better. Rings: no other point is better in"
        " both. Red star: what the paper does."
    )
    return f'<div class="wide"><table>{body}</table></div><p class="soft">{how}</p>'


def _section(subject: Subject, found: SubjectResults, pictures: Path) -> str:
    parts = [f'<h2 id="{subject.name}">{html.escape(subject.title)}</h2><p>{_prose(subject.question)}</p>']
    if subject.paper:
        parts.append(f'<p class="soft">The paper: {_prose(subject.paper)}.</p>')
    empty = empty_diagrams(subject, found)
    for diagram in subject.diagrams:
        if diagram.name not in empty:
            parts.append(_picture(*write(draw(subject, found, diagram), pictures / diagram.name), diagram.title))
    parts += [_cells(table) for table in found.tables]
    parts += _omitted(found, empty)
    if found.measured:
        parts.append(_figures(subject, found))
    return "".join(parts)


def _prose(text: str) -> str:
    """Escaped, with backticks as code."""
    return re.sub("`([^`]*)`", r"<code>\1</code>", html.escape(text))


def _picture(light: str, dark: str, title: str) -> str:
    data = ["data:image/svg+xml;base64," + base64.b64encode(svg.encode()).decode() for svg in (light, dark)]
    source = f'<source media="(prefers-color-scheme: dark)" srcset="{data[1]}">'
    return f'<picture>{source}<img alt="{html.escape(title)}" src="{data[0]}"></picture>'


def _omitted(found: SubjectResults, empty: dict[str, str]) -> Iterator[str]:
    failed = [f"{name}: {reason}" for name, reason in found.omissions.items()]
    yield _list("Failures", failed) if failed else "<h3>Failures</h3><p>None: no method raised an exception or returned NaN.</p>"
    if hurried := [f"{item.what}: {item.why}" for item in found.skipped if item.for_speed]:
        yield _list("Left out for speed", hurried)
    if reasons := [f"{item.what}: {item.why}" for item in found.skipped if not item.for_speed] + list(empty.values()):
        yield _list("Makes no sense here", reasons)


def _list(title: str, items: list[str]) -> str:
    return f"<h3>{title}</h3><ul>{''.join(f'<li>{html.escape(item)}</li>' for item in items)}</ul>"


def fronts(subject: Subject, found: SubjectResults) -> set[str]:
    """Names of the candidates on the Pareto front of any diagram."""
    names = set()
    for diagram in subject.diagrams:
        if isinstance(diagram, Diagram):
            shown = points(subject, found, diagram)
            names |= {shown[k].one.name for k in pareto([(p.x, p.y) for p in shown])}
    return names


def number(one: Measured, figure: Figure) -> str:
    """The figure of a candidate as text. Timed figures include half their interval, or the number and range of turns if there are
    too few for an interval."""
    value = one.value(figure)
    if not math.isfinite(value):
        return ""
    if figure.key not in one.turns:
        return short(value)
    spread, turns = one.noise(figure.key) / 2, one.turns[figure.key]
    if math.isfinite(spread):
        return f"{short(value)} ± {100 * spread:.0f} %"
    spread_of = "1 run" if len(turns) == 1 else f"{len(turns)} runs, {short(min(turns))} to {short(max(turns))}"
    return f"{short(value)} ({spread_of})"


def _used(subject: Subject, found: SubjectResults) -> list[Figure]:
    return [f for f in subject.figures if any(math.isfinite(one.value(f)) for one in found.measured.values())]


def _figures(subject: Subject, found: SubjectResults) -> str:
    figures, front = _used(subject, found), fronts(subject, found)
    head = "".join(f"<th>{html.escape(figure.axis)}</th>" for figure in figures)
    rows = []
    for one in found.measured.values():
        kind = ("front" if one.name in front else "") + (" paper" if one.paper else "")
        cells = "".join(f'<td class="n">{number(one, figure)}</td>' for figure in figures)
        name = html.escape(one.name) + (" ★" if one.paper else "")
        rows.append(f'<tr class="{kind}"><td>{name}</td>{cells}</tr>')
    what = f"All figures of {len(found.measured)} methods ({found.seconds:.0f} s). Bold: on a front. ★: the paper."
    body = f'<div class="wide"><table><tr><th>method</th>{head}</tr>{"".join(rows)}</table></div>'
    return f"<details><summary>{what}</summary>{body}</details>"


def _cells(table: Table) -> str:
    head = "".join(f"<th>{html.escape(text)}</th>" for text in table.head)
    rows = "".join(
        "<tr>" + "".join(f'<td class="{cell.state}">{html.escape(cell.text)}</td>' for cell in row) + "</tr>"
        for row in table.rows
    )
    counted = _counted(table)
    return (
        f"<h3>{html.escape(table.title)}</h3><p class='soft'>{html.escape(table.note)} {counted and f'<b>{counted}</b>.'}</p>"
        f'<div class="wide"><table><tr>{head}</tr>{rows}</table></div>'
    )


def counts(table: Table) -> dict[str, int]:
    """The number of cells that are ok, degraded and failed."""
    cells = [cell.state for row in table.rows for cell in row]
    return {state: cells.count(state) for state in ("ok", "degraded", "failed")}


def _counted(table: Table) -> str:
    return ", ".join(f"{count} {state}" for state, count in counts(table).items() if count)


def summary(results: Results) -> str:
    """The run in Markdown, for a pull request: candidates on a front, the paper's, and failures."""
    about = results.about
    lines = ["## lfpipe bench", "", f"`{about['command']}` at {about['commit']}, {about['machine']['processor']},"]
    lines += [f"{about['machine']['cores']} cores. {'; '.join(about['scenes'])}. {about['sequence']}.", ""]
    for name, found in results.subjects.items():
        subject = SUBJECTS[name]
        lines += [f"### {subject.title}", "", f"{conclusion(subject, found)}.", ""]
        if found.measured:
            front = fronts(subject, found)
            keys = list(dict.fromkeys(key for d in subject.diagrams if isinstance(d, Diagram) for key in (d.y, d.x)))
            figures = [f for f in _used(subject, found) if f.key in keys]
            lines.append("| method | " + " | ".join(figure.axis for figure in figures) + " |")
            lines.append("|---|" + "---:|" * len(figures))
            for one in found.measured.values():
                if one.name in front or one.paper or not front:
                    cells = " | ".join(number(one, figure) for figure in figures)
                    lines.append(f"| {one.name}{' ★' if one.paper else ''} | {cells} |")
            lines.append("")
        lines += [f"- {table.title}: {_counted(table) or 'see the report'}" for table in found.tables]
        lines += [f"- failed: {name}: {reason}" for name, reason in found.omissions.items()]
        lines += [f"- {'for speed' if item.for_speed else 'makes no sense'}: {item.what}: {item.why}" for item in found.skipped]
        lines += [f"- makes no sense: {text}" for text in empty_diagrams(subject, found).values()]
        lines.append("")
    return "\n".join([*lines, "★ what the paper does. The others are on a Pareto front of their subject.", ""])
