"""PLAN.toml: the contents of a sweep, as cells.

sequences = ["recordings/*"]             # folders of `lfpipe record`, relative to the plan
scenes = ["scenes/buddha", "lytro/*"]
subjects = ["replay", "truth", "quality", "table", "synthesis"]

[config]                                 # every combination of the lists
"render.method" = ["warp", "warp2"]

[table]                                  # options of quality and table, as for `lfpipe bench table`
keep = [2, 3]
border = [22]
"""

import glob
import hashlib
import itertools
import json
import math
import re
from collections.abc import Collection
from pathlib import Path
from typing import Any

import attrs

from lfpipe import config
from lfpipe.config.check import closest, flat
from lfpipe.errors import UserError
from lfpipe.files.safe_files import read_text, toml_table

QUALITY, TABLE, REPLAY, TRUTH = "quality", "table", "replay", "truth"
BENCH = ("tracker", "synthesis", "stability")  # as `lfpipe bench` names them
SUBJECTS = (REPLAY, TRUTH, QUALITY, TABLE, *BENCH)
NEEDS = {REPLAY: "sequences", TRUTH: "sequences", QUALITY: "scenes", TABLE: "scenes"}
TIMED = (TABLE, *BENCH)  # run alone
MAX_CELLS = 100_000  # a day on a cluster; more is probably an error
# allowed values, default
PROTOCOL: dict[str, tuple[Collection[int], int]] = {
    "keep": ((2, 3), 2),
    "border": (range(1001), 22),
}
REMEDY = "see `lfpipe sweep --help` for the form of a plan"


@attrs.frozen(kw_only=True)
class Cell:
    """One measurement of a plan."""

    subject: str
    sequence: str
    scene: str
    """A path, as sequence; "" for none."""
    sets: tuple[str, ...] = ()
    options: tuple[str, ...] = ()
    """KEY=VALUE texts of quality and table; sets are those of the configuration."""
    key: str = ""
    """Hash of everything that affects the outcome."""

    @property
    def name(self) -> str:
        """Equal for the same cell of two versions: contains names of files, not hashes."""
        paths = (Path(path).name for path in (self.sequence, self.scene) if path)
        return " ".join([self.subject, *paths, *self.sets, *self.options])

    @property
    def folder(self) -> str:
        """Name of its reference: readable, and unique by a hash of the name."""
        return (
            re.sub(r"[^\w.=-]+", "_", self.name)[:80]
            + "-"
            + hashlib.blake2b(self.name.encode(), digest_size=4).hexdigest()
        )


def read_plan(path: Path) -> list[Cell]:
    """The cells of a plan, without keys. Paths are absolute, or patterns that match nothing.

    Raises UserError with the key, the value and the remedy.
    """
    table = toml_table(read_text(path, str(path), REMEDY), str(path), REMEDY)
    _check_names(f"{path}: ", table, ("sequences", "scenes", "subjects", "config", "table"))
    texts = {key: table.get(key, []) for key in ("sequences", "scenes", "subjects")}
    for key, values in texts.items():
        if not isinstance(values, list) or not all(
            isinstance(value, str) and value for value in values
        ):
            raise UserError(
                f"{path}: {key}: {values!r:.100}", f'write a list of strings: {key} = ["..."]'
            )
    _check_names(f"{path}: subjects: ", texts["subjects"], SUBJECTS)
    if not texts["subjects"]:
        raise UserError(
            f"{path}: subjects: the list is empty", f"name at least one of {', '.join(SUBJECTS)}"
        )
    options = {name: [default] for name, (_, default) in PROTOCOL.items()} | _lists(
        path, "table", table
    )
    _check_names(f"{path}: table.", options, PROTOCOL)
    for name, value in ((name, value) for name, values in options.items() for value in values):
        if isinstance(value, bool | float) or value not in PROTOCOL[name][0]:
            raise UserError(
                f"{path}: table.{name}: {value!r}", "see the values in `lfpipe bench table --help`"
            )
    sets = _lists(path, "config", table)
    if (count := len(texts["subjects"]) * math.prod(map(len, sets.values()))) > MAX_CELLS:
        raise UserError(
            f"{path}: {count} combinations of configurations and subjects",
            f"reduce them to at most {MAX_CELLS}",
        )
    configs = _combinations(sets)
    for words in configs:
        config.load(None, words)  # refuses wrong keys and values before anything runs
    inputs = {key: _expanded(path, texts[key]) for key in ("sequences", "scenes")}
    cells = []
    for subject in dict.fromkeys(texts["subjects"]):
        if not inputs.get(key := NEEDS.get(subject, ""), [key]):
            raise UserError(f"{path}: subject {subject} needs {key}", f"add {key} = [...]")
        of_views = NEEDS.get(subject) == "scenes"
        sequences, protocols = (
            ([""], _combinations(options)) if of_views else (inputs["sequences"] or [""], [()])
        )
        product = itertools.product(sequences, inputs["scenes"] or [""], configs, protocols)
        cells += [
            Cell(subject=subject, sequence=sequence, scene=scene, sets=sets, options=chosen)
            for sequence, scene, sets, chosen in product
        ]
    return cells


def _check_names(where: str, names: Collection[str], allowed: Collection[str]) -> None:
    for name in names:
        if name not in allowed:
            close = closest(name, allowed, 0.5)
            remedy = f"did you mean {close!r}?" if close else f"use one of {', '.join(allowed)}"
            raise UserError(f"{where}{name}: no such name", remedy)


def _lists(path: Path, key: str, plan: dict[str, Any]) -> dict[str, list[Any]]:
    """A table of values or lists of values, nested tables as dotted keys."""
    table = plan.get(key, {})
    if not isinstance(table, dict):
        raise UserError(f"{path}: {key}: {table!r:.100}", f"write a table: [{key}]")
    lists = {
        str(name): value if isinstance(value, list) else [value] for name, value in flat(table)
    }
    if empty := [name for name, values in lists.items() if not values]:
        raise UserError(
            f"{path}: {key}.{empty[0]}: an empty list",
            "give at least one value, or leave the key out",
        )
    return lists


def _combinations(lists: dict[str, list[Any]]) -> list[tuple[str, ...]]:
    """Every combination of one value from each list, as KEY=VALUE texts."""
    texts = [
        [f"{k}={one if isinstance(one, str) else json.dumps(one)}" for one in values]
        for k, values in lists.items()
    ]
    return list(itertools.product(*texts))


def _expanded(plan: Path, patterns: list[str]) -> list[str]:
    """Paths that the patterns match, in order.

    A pattern without a match is kept, so that it is reported as missing.
    """
    paths: dict[str, None] = {}
    for pattern in patterns:
        whole = str(plan.resolve().parent / Path(pattern).expanduser())
        is_pattern = any(sign in pattern for sign in "*?[")
        matches = sorted(glob.glob(whole)) if is_pattern else []  # noqa: PTH207
        paths |= dict.fromkeys(matches or [whole])
    return list(paths)
