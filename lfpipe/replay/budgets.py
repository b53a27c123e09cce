"""Budgets of a replay: limits on figures of its report, from a TOML file.

[[budget]]
figure = "counts.dropped.track"        # a number in report.json, by its dotted path
most = 0                               # or least
machine = "any"                        # the machines for which the limit was set ...

[[budget]]
figure = "latency.render.busy.p95_ms"
over = "latency.track.busy.p95_ms"     # ... or a ratio to another figure, nearly independent of the machine;
most = 2.0                             # over = "reference" is the same figure of the reference
"""

from pathlib import Path
from typing import Any

import attrs

from lfpipe.errors import UserError, shown
from lfpipe.files.safe_files import read_text
from lfpipe.files.untrusted import Fields, parse_toml
from lfpipe.supervisor.process_table import NAMES

FILE_BYTES = 128 << 10
MAX_BUDGETS = 1000
SHOWN = 5  # problems listed at most
KEYS = {"figure", "over", "most", "least", "machine"}


@attrs.frozen
class Budget:
    """One bound. over: "" for the figure itself. most, least: the bounds, at least one of them."""

    figure: str
    over: str
    most: float | None
    least: float | None
    machine: str


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def read_budgets(path: Path) -> list[Budget]:
    """The budgets in path. Raises UserError with every wrong entry."""
    where, remedy = f"--budget {path}", "see the example in docs/replay.md"
    tree = parse_toml(read_text(path, FILE_BYTES, where, remedy), where, remedy)
    listed = set(tree) == {"budget"} and isinstance(tree["budget"], list)
    entries = Fields(tree, where, remedy).items("budget", MAX_BUDGETS) if listed else []
    if not entries:
        raise UserError(f"{where}: expected [[budget]] entries and nothing else", remedy)
    found, wrong = [], []
    for number, entry in enumerate(entries, 1):
        try:
            found.append(_budget(entry, f"entry {number}"))
        except UserError as error:
            wrong.append(error)
    if wrong:
        said = [error.message for error in wrong[:SHOWN]] + [f"and {len(wrong) - SHOWN} more"] * (len(wrong) > SHOWN)
        raise UserError(f"{where}: " + "\n  ".join(said), wrong[0].remedy)
    return found


def _budget(entry: Any, where: str) -> Budget:
    if not isinstance(entry, dict):
        raise UserError(f"{where} is {shown(entry)}, not a table", "begin each entry with [[budget]]")
    strange = sorted(set(entry) - KEYS)
    if strange or not isinstance(entry.get("figure"), str):
        what = f"unknown key {shown(strange[0])}" if strange else "no figure"
        raise UserError(f"{where}: {what}", f"keys: {', '.join(sorted(KEYS))}")
    where = f"{where} ({entry['figure'][:80]})"
    bounds = {name: entry[name] for name in ("most", "least") if name in entry}
    if not bounds or not all(map(_number, bounds.values())):
        raise UserError(f"{where}: needs a number as most or least", "for example: most = 20")
    words = {name: entry.get(name, "") for name in ("over", "machine")}
    if not all(isinstance(word, str) for word in words.values()) or bool(words["over"]) == bool(words["machine"]):
        raise UserError(f"{where}: needs over or machine", 'add machine = "any", or over = "reference"')
    return Budget(entry["figure"], words["over"], bounds.get("most"), bounds.get("least"), words["machine"])


def figure(report: dict[str, Any], path: str) -> float:
    """The number at a dotted path. Raises UserError if it does not exist."""
    value: Any = report
    for part in path.split("."):
        value = value.get(part) if isinstance(value, dict) else None
    if not _number(value):
        what = f"budget: {path[:200]} is not a figure of this report"
        raise UserError(what, "report.json of `lfpipe replay --out` contains all figures")
    return float(value)


def _stage(path: str) -> str:
    """The stage that a figure belongs to; the first word of the message."""
    names = [part for part in path.split(".") if part in (*NAMES, "end_to_end")]
    return names[0] if names else "run"


def broken(budgets: list[Budget], report: dict[str, Any], reference: dict[str, Any] | None) -> list[str]:
    """One line per budget that report exceeds. Raises UserError for a missing figure."""
    lines = []
    for budget in budgets:
        value, unit = figure(report, budget.figure), f"on {budget.machine}" if budget.machine else f"x {budget.over}"
        if budget.over:
            if budget.over == "reference" and reference is None:
                raise UserError(f'budget {budget.figure}: over = "reference" needs a reference', "give one with --expect")
            whole = figure(reference, budget.figure) if reference and budget.over == "reference" else figure(report, budget.over)
            value = value / whole if whole else float("inf") if value else 0.0
        if budget.most is not None and value > budget.most:
            lines.append(f"{_stage(budget.figure)}: {budget.figure} is {value:g}, above the limit {budget.most:g} ({unit})")
        if budget.least is not None and value < budget.least:
            lines.append(f"{_stage(budget.figure)}: {budget.figure} is {value:g}, below the limit {budget.least:g} ({unit})")
    return lines
