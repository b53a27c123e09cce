"""The report of a run: one HTML page that begins with verdicts, with charts of error against run time."""

import base64
import html
import io
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from lfpipe.bench.results import STATES, Results, short
from lfpipe.bench.style import document, html_table
from lfpipe.bench.subjects import SUBJECTS, TABLE, Subject
from lfpipe.files.output import write_output

TIE = 0.05  # errors that differ by less than this share are equal for a verdict: the noise of short sequences
MARKERS = "osD^vPX<>h"
COLOURS = (
    "#0072b2",
    "#d55e00",
    "#008a63",
    "#b1548f",
    "#8a6d00",
    "#4b4fc4",
    "#7a7f86",
)  # for a colour vision deficiency, too
HOW = (
    "<h2>How it was measured</h2><p class=soft>Times are medians of turns that the methods take in random order, with the 95 %"
    " interval of the median, or the range if there are too few turns. Axes are logarithmic; an exact 0 is drawn at the edge."
    " Lower left is better. Square, bold: in use by default. Star, red: the paper.</p>"
)
Pairs = list[tuple[Subject, Results]]


def verdict(subject: Subject, results: Results) -> tuple[str, str, str, str] | None:
    """The choice of a subject: the least error among what fits its limit of cost; what is in use, if that ties. Returns the key
    of the configuration, what to use for this machine and these inputs, why, and its cost."""
    choice = subject.choice
    timed = [
        row for row in results.rows if choice is not None and subject.charts[0][0] in row.values
    ]
    if choice is None or not timed:
        return None
    x, y = (subject.column(key) for key in subject.charts[0])
    used = next((row for row in timed if row.used), None)
    rows = [row for row in timed if used is None or row.knob == used.knob]
    best, why = (
        used or rows[0],
        f"no error can be measured: {'; '.join(results.left_out) or 'see below'}",
    )
    if known := [row for row in rows if y.key in row.values]:
        fitting = [row for row in known if row.value(x.key) <= choice.limit] or known
        least = min(row.value(y.key) for row in fitting)
        ties = [row for row in fitting if row.value(y.key) <= least * (1 + TIE)]
        best = (
            used
            if used is not None and used in ties
            else min(ties, key=lambda row: row.value(x.key))
        )
        why = f"{y.label} {short(best.value(y.key))} {y.unit}".rstrip()
        why += ", the least" if best.value(y.key) <= least else f", within {TIE:.0%} of the least"
        why += f" of what takes at most {short(choice.limit)} {x.unit} ({choice.reason})"
        for what, row in (
            ("the paper's way", next((row for row in timed if row.paper), None)),
            ("in use now", used),
        ):
            if row is not None and row is not best:
                why += f"; {what} ({row.name}): {short(row.value(y.key))} for {short(row.value(x.key))} {x.unit}"
    return (
        choice.key,
        best.name + " (in use)" * best.used,
        why,
        f"{best.values[x.key].text} {x.unit}: {x.label}",
    )


def write_report(results: dict[str, Results], out: Path) -> Path:
    """Writes report.html and returns its path. Raises UserError."""
    subjects = SUBJECTS | {TABLE.name: TABLE}
    pairs = [(subjects[name], one) for name, one in results.items()]
    links = " ".join(
        f'<a href="#{subject.name}">{html.escape(subject.title)}</a>' for subject, _ in pairs
    )
    wall_s, cpu_s = (
        sum(one.wall_s for one in results.values()),
        sum(one.cpu_s for one in results.values()),
    )
    body = f"<p class=soft>Measured in {wall_s:.0f} s of wall time, {cpu_s:.0f} s of CPU.</p>{_verdicts(pairs)}{_failures(pairs)}"
    body += f"<nav>{links}</nav>{''.join(_section(*pair) for pair in pairs)}{HOW}"
    write_output(
        out / "report.html", document("Error against run time", body).encode(), label="--out"
    )
    return out / "report.html"


def _verdicts(pairs: Pairs) -> str:
    rows = [one for pair in pairs if (one := verdict(*pair))]
    text = (
        html_table(("setting", "for this machine and these inputs", "why", "what it costs"), rows)
        if rows
        else ""
    )
    for subject, results in pairs:
        judged = [value for *_, value in results.judged()]
        used = [value.state for value in judged if not value.only]
        others = sum(value.state != "ok" for value in judged if value.only)
        counts = ", ".join(f"{used.count(state)} {state}" for state in STATES)
        others_text = f"; {others} not ok, reached only with other settings" if others else ""
        text += (
            f"<p>{html.escape(subject.title)}: of what is in use {counts}{others_text}.</p>"
            if judged
            else ""
        )
    return f"<h2>Verdicts</h2>{text}" if text else ""


def _failures(pairs: Pairs) -> str:
    """What failed: methods that raised an exception, and judged values, each with whether it matters."""
    rows = [
        (subject.title, one, why, "yes")
        for subject, results in pairs
        for one, why in results.failures.items()
    ]
    grouped: dict[
        tuple[str, str, str], list[str]
    ] = {}  # title, case of a failure or "", setting -> what
    for _, results in pairs:
        for table, row, column, value in results.judged():
            if value.state != "ok":
                case = row.name if value.state == "failed" else ""
                grouped.setdefault((table.title, case, value.only), []).append(
                    f"{column} {value.text}" if case else row.name
                )
    for (title, case, only), what in grouped.items():
        words = (
            f"failed: {'; '.join(what)}" if case else f"degraded in {len(what)} of the table below"
        )
        rows.append(
            (
                title,
                case or ", ".join(dict.fromkeys(what)),
                words,
                f"only with {only}" if only else "yes: in use",
            )
        )
    rows.sort(key=lambda row: (not row[3].startswith("yes"), not row[2].startswith("failed")))
    return f"<h2>What failed</h2>{html_table(('where', 'case', 'what', 'does it matter?'), rows) if rows else '<p>Nothing.</p>'}"


def _section(subject: Subject, results: Results) -> str:
    text = f'<h2 id="{subject.name}">{html.escape(subject.title)}</h2><p>{html.escape(subject.question)}</p>'
    text += f'<p class="soft">The paper: {html.escape(subject.paper)}.</p>' if subject.paper else ""
    text += f"<p><code>{html.escape(results.about.get('command', ''))}</code></p>"
    text += "".join(chart(subject, results, *axes) for axes in subject.charts)
    if results.left_out:
        text += f"<p>Left out:</p><ul>{''.join(f'<li>{html.escape(reason)}</li>' for reason in results.left_out)}</ul>"
    for table in results.tables:
        head, body = table.texts()
        classes = [
            [" ".join(["used"] * row.used + ["paper"] * row.paper)] if row.curve
            else ["", *(row.values[column.key].state for column in table.columns)] for row in table.rows
        ]  # fmt: skip
        note = table.note or "■ in use, ★ the paper."
        title = table.title or f"All figures of {len(table.rows)} methods"
        text += (
            f"<details><summary>{html.escape(title)}</summary><p class=soft>{html.escape(note)}</p>"
        )
        text += f"{html_table(head, body, classes)}</details>"
    facts = [(name, value) for name, value in results.about.items() if name != "command"]
    facts.append(("time", f"{results.wall_s:.0f} s of wall time, {results.cpu_s:.0f} s of CPU"))
    return text + f"<details><summary>Conditions</summary>{html_table((), facts)}</details>"


def chart(subject: Subject, results: Results, x: str, y: str) -> str:
    """The chart of two columns on logarithmic axes, an image of HTML; "" if it holds no point."""
    rows = [row for row in results.rows if row.value(x) >= 0 and row.value(y) >= 0]
    if not rows:
        return ""
    title = f"{subject.column(y).label} against {subject.column(x).label}"
    style: Any = {
        "svg.fonttype": "none",
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.formatter.min_exponent": 3,
    }
    with mpl.rc_context(style):
        figure = Figure(figsize=(9.0, 4.6), layout="constrained")
        axes = figure.add_subplot(
            xlabel=subject.column(x).axis, ylabel=subject.column(y).axis, title=title
        )
        for k, curve in enumerate(dict.fromkeys(row.curve for row in rows)):
            places = [(row.value(x), row.value(y)) for row in rows if row.curve == curve]
            axes.plot(
                *zip(*places, strict=True),
                marker=MARKERS[k % len(MARKERS)],
                color=COLOURS[k % len(COLOURS)],
                label=curve,
            )
        for label, marker, face, marked in (
            ("in use", "s", "none", [row for row in rows if row.used]),
            ("the paper", "*", "#e5484d", [row for row in rows if row.paper]),
        ):
            values = [row.value(x) for row in marked], [row.value(y) for row in marked]
            axes.scatter(
                *values,
                s=190,
                marker=marker,
                facecolors=face,
                edgecolors="#1b1f24",
                zorder=4,
                label=label,
            )
        for set_scale, key in ((axes.set_xscale, x), (axes.set_yscale, y)):
            above = [row.value(key) for row in rows if row.value(key) > 0]
            if len(above) == len(rows):
                set_scale("log")
            else:
                set_scale("symlog", linthresh=min(above, default=1.0), linscale=0.4)
        axes.grid(True, color="#e4e7eb")
        figure.legend(loc="outside right upper", frameon=False)
        out = io.StringIO()
        figure.savefig(out, format="svg", metadata={"Date": None})
    data = base64.b64encode(out.getvalue().encode()).decode()
    return f'<img alt="{html.escape(title)}" src="data:image/svg+xml;base64,{data}">'
