"""Budgets of a replay: figures of its report that may not be left, from a TOML file.

[[budget]]
figure = "counts.dropped.track"        # a number in report.json, by its dotted path
most = 0                               # or least
machine = "any"                        # for which machines the bound was set ...

[[budget]]
figure = "latency.render.busy.p95_ms"
over = "latency.track.busy.p95_ms"     # ... or a ratio to another figure, which no machine changes much;
most = 2.0                             # over = "reference" is the same figure of the reference
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import attrs

from lfpipe.errors import UserError

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
    """The budgets in path. Raises UserError that names the entry that is wrong."""
    try:
        tree = tomllib.loads(path.read_text())
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else f"not TOML: {error}"
        raise UserError(f"--budget {path}: {why}", "docs/replay.md shows one") from None
    entries = tree.get("budget")
    if set(tree) != {"budget"} or not isinstance(entries, list) or not entries:
        raise UserError(f"--budget {path}: no [[budget]] entries, or something besides", "docs/replay.md shows one")
    found = []
    for number, entry in enumerate(entries):
        where = f"--budget {path}: entry {number + 1}"
        strange = sorted(set(entry) - KEYS)
        if strange or not isinstance(entry.get("figure"), str):
            what = f"unknown key {strange[0]!r}" if strange else "no figure"
            raise UserError(f"{where}: {what}", f"keys: {', '.join(sorted(KEYS))}")
        bounds = {name: entry[name] for name in ("most", "least") if name in entry}
        if not bounds or not all(map(_number, bounds.values())):
            raise UserError(f"{where} ({entry['figure']}): needs a number as most or least", "for example most = 20")
        words = {name: entry.get(name, "") for name in ("over", "machine")}
        if not all(isinstance(word, str) for word in words.values()) or bool(words["over"]) == bool(words["machine"]):
            remedy = 'machine = "any", or over = "reference"'
            raise UserError(f"{where} ({entry['figure']}): needs either over or machine", remedy)
        found.append(Budget(entry["figure"], words["over"], bounds.get("most"), bounds.get("least"), words["machine"]))
    return found


def figure(report: dict[str, Any], path: str) -> float:
    """The number at a dotted path. Raises UserError where there is none."""
    value: Any = report
    for part in path.split("."):
        value = value.get(part) if isinstance(value, dict) else None
    if not _number(value):
        raise UserError(f"budget: {path} is no figure of this report", "report.json of `lfpipe replay --out` holds them all")
    return float(value)


def _stage(path: str) -> str:
    """The stage that a figure is of, for the first word of what is said."""
    names = [part for part in path.split(".") if part in ("capture", "track", "render", "record", "end_to_end")]
    return names[0] if names else "run"


def broken(budgets: list[Budget], report: dict[str, Any], reference: dict[str, Any] | None) -> list[str]:
    """A line for every budget that report breaks. Raises UserError for a figure that is not there."""
    lines = []
    for budget in budgets:
        value, unit = figure(report, budget.figure), f"on {budget.machine}" if budget.machine else f"x {budget.over}"
        if budget.over:
            if budget.over == "reference" and reference is None:
                raise UserError(f'budget {budget.figure}: over = "reference" needs a reference', "give one with --expect")
            whole = figure(reference, budget.figure) if reference and budget.over == "reference" else figure(report, budget.over)
            value = value / whole if whole else float("inf") if value else 0.0
        if budget.most is not None and value > budget.most:
            lines.append(f"{_stage(budget.figure)}: {budget.figure} is {value:g}, {budget.most:g} at most ({unit})")
        if budget.least is not None and value < budget.least:
            lines.append(f"{_stage(budget.figure)}: {budget.figure} is {value:g}, {budget.least:g} at least ({unit})")
    return lines
