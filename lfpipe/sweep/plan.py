"""PLAN.toml: the contents of a sweep, as cells with keys.

sequences = ["recordings/*"]             # folders of `lfpipe record`, relative to the plan; patterns allowed
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
from functools import lru_cache
from pathlib import Path
from typing import Any

import attrs

from lfpipe import config
from lfpipe.config.check import closest, flat
from lfpipe.errors import UserError
from lfpipe.files.safe_files import read_text
from lfpipe.files.untrusted import toml_table
from lfpipe.scene.open_scene import open_scene
from lfpipe.sequence.folder import MANIFEST, is_sequence

QUALITY, TABLE, REPLAY, TRUTH = "quality", "table", "replay", "truth"
BENCH = ("tracker", "filters", "synthesis", "anaglyph", "stability")  # as `lfpipe bench` names them
SUBJECTS = (REPLAY, TRUTH, QUALITY, TABLE, *BENCH)
NEEDS = {"sequences": (REPLAY, TRUTH), "scenes": (QUALITY, TABLE)}
TIMED = (TABLE, *BENCH)  # run alone on a host
PLAN_BYTES = 1 << 20
MAX_CELLS = 100_000
PROTOCOL: dict[str, tuple[Collection[int], int]] = {"keep": ((2, 3), 2), "border": (range(1001), 22)}  # allowed values, default
REMEDY = "see `lfpipe sweep --help` for the form of a plan"


@attrs.frozen
class Cell:
    """sequence, scene: paths, "" for none. sets: KEY=VALUE texts of the configuration. options: of the subject, by name.

    key: hash of everything that affects the outcome. why_not: why the cell cannot be measured, "" if it can.
    """

    subject: str
    sequence: str
    scene: str
    sets: tuple[str, ...] = ()
    options: tuple[tuple[str, str], ...] = ()
    key: str = ""
    why_not: str = ""

    @property
    def timed(self) -> bool:
        return self.subject in TIMED

    @property
    def name(self) -> str:
        """Equal for the same cell of two versions: contains names of files, not hashes."""
        words = [self.subject, *(Path(path).name for path in (self.sequence, self.scene) if path), *self.sets]
        return " ".join([*words, *(f"{name}={value}" for name, value in self.options)])

    @property
    def folder(self) -> str:
        """Name of its reference: readable, and unique by a hash of the name."""
        return re.sub(r"[^\w.=-]+", "_", self.name)[:80] + "-" + hashlib.blake2b(self.name.encode(), digest_size=4).hexdigest()


def read_plan(path: Path) -> list[Cell]:
    """The cells of a plan, without keys. Paths are absolute, or patterns that match nothing.

    Raises UserError with the key, the value and the remedy.
    """
    table = toml_table(read_text(path, PLAN_BYTES, str(path), REMEDY), str(path), REMEDY)
    _check_names(f"{path}: ", table, ("sequences", "scenes", "subjects", "config", "table"))
    sequences, scenes, subjects = (_texts(path, key, table.get(key, [])) for key in ("sequences", "scenes", "subjects"))
    _check_names(f"{path}: subjects: ", subjects, SUBJECTS)
    if not subjects:
        raise UserError(f"{path}: subjects: the list is empty", f"name at least one of {', '.join(SUBJECTS)}")
    options = {name: [default] for name, (_, default) in PROTOCOL.items()} | _lists(path, "table", table.get("table", {}))
    _check_names(f"{path}: table.", options, PROTOCOL)
    for name, value in ((name, value) for name, values in options.items() for value in values):
        if isinstance(value, bool | float) or value not in PROTOCOL[name][0]:
            raise UserError(f"{path}: table.{name}: {value!r}", "see the values in `lfpipe bench table --help`")
    sets = [
        [f"{key}={value if isinstance(value, str) else json.dumps(value)}" for value in values]
        for key, values in _lists(path, "config", table.get("config", {})).items()
    ]
    if (count := len(subjects) * math.prod(map(len, sets))) > MAX_CELLS:
        raise UserError(f"{path}: {count} combinations of configurations and subjects", f"reduce them to at most {MAX_CELLS}")
    configs = list(itertools.product(*sets))
    for texts in configs:
        config.load(None, texts)  # refuses wrong keys and values before anything runs
    protocols = [tuple(zip(options, map(str, values), strict=True)) for values in itertools.product(*options.values())]
    inputs = {"sequences": _expanded(path, sequences), "scenes": _expanded(path, scenes)}
    for key, names in NEEDS.items():
        if (needy := next((name for name in subjects if name in names), "")) and not inputs[key]:
            raise UserError(f"{path}: subject {needy} needs {key}", f"add {key} = [...]")
    return [
        Cell(subject, *values)
        for subject in subjects
        for values in itertools.product(
            (inputs["sequences"] if subject not in (QUALITY, TABLE) else ()) or [""],
            inputs["scenes"] or [""],
            configs,
            protocols if subject in (QUALITY, TABLE) else [()],
        )
    ]


def _check_names(where: str, names: Collection[str], known: Collection[str]) -> None:
    for name in names:
        if name not in known:
            close = closest(name, known, 0.5)
            raise UserError(
                f"{where}{name}: no such name", f"did you mean {close!r}?" if close else f"use one of {', '.join(known)}"
            )


def _texts(path: Path, key: str, values: Any) -> tuple[str, ...]:
    if not isinstance(values, list) or not all(isinstance(value, str) and value for value in values):
        raise UserError(f"{path}: {key}: {values!r:.100}", f'write a list of strings: {key} = ["..."]')
    return tuple(dict.fromkeys(values))


def _lists(path: Path, key: str, table: Any) -> dict[str, list[Any]]:
    """A table of values or lists of values, nested tables as dotted keys."""
    if not isinstance(table, dict):
        raise UserError(f"{path}: {key}: {table!r:.100}", f"write a table: [{key}]")
    lists = {str(name): value if isinstance(value, list) else [value] for name, value in flat(table)}
    if empty := [name for name, values in lists.items() if not values]:
        raise UserError(f"{path}: {key}.{empty[0]}: an empty list", "give at least one value, or leave the key out")
    return lists


def _expanded(plan: Path, patterns: tuple[str, ...]) -> list[str]:
    """Paths that the patterns match, in order. A pattern without a match is kept, so that it is reported as missing."""
    paths: dict[str, None] = {}
    for pattern in patterns:
        whole = str(plan.resolve().parent / Path(pattern).expanduser())
        matches = sorted(glob.glob(whole)) if any(sign in pattern for sign in "*?[") else []  # noqa: PTH207
        paths |= dict.fromkeys(matches or [whole])
    return list(paths)


def keyed(cell: Cell, version: str) -> Cell:
    """The cell with its key. version: hash of the code and the versions of its libraries."""
    try:
        return attrs.evolve(cell, key=_hash(version, cell.name, sequence_id(cell.sequence), scene_id(cell.scene, cell.sets)))
    except UserError as error:
        return attrs.evolve(cell, key=_hash(version, cell.name), why_not=error.message)


def _hash(*parts: str) -> str:
    return hashlib.blake2b(json.dumps(parts).encode(), digest_size=12).hexdigest()


@lru_cache(maxsize=MAX_CELLS)
def sequence_id(path: str) -> str:
    """Hash of a recording by its manifest, which holds checksums, or of a video by its size. Raises UserError if missing."""
    if not path:
        return ""
    folder = Path(path)
    try:
        if not is_sequence(folder):
            state = folder.stat()
            return _hash(folder.name, str(state.st_size), str(state.st_mtime_ns))
        return _hash(folder.name, (folder / MANIFEST).read_bytes().decode(errors="replace"))
    except OSError as error:
        raise UserError(f"{path}: {error.strerror}", "check the path") from None


@lru_cache(maxsize=MAX_CELLS)
def scene_id(path: str, sets: tuple[str, ...]) -> str:
    """Hash of a scene's contents under the scene settings of a configuration; packs it if needed. Raises UserError."""
    if not path:
        return ""
    settings = config.load(None, [text for text in sets if text.startswith("scene.")]).scene
    return Path(open_scene(path, settings).folder).name
