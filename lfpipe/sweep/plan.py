"""PLAN.toml: the contents of a sweep, as cells with keys.

sequences = ["recordings/*"]             # folders of `lfpipe record`, relative to the plan; patterns allowed
scenes = ["scenes/buddha", "lytro/*"]
subjects = ["replay", "truth", "quality", "table", "synthesis"]

[config]                                 # every combination of the lists
"render.method" = ["warp", "warp2"]

[table]                                  # options of quality and table, as for `lfpipe bench table`
keep = [2, 3]
crop = ["central", "top-left"]
border = [22]
"""

import difflib
import glob
import hashlib
import itertools
import json
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import attrs

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.safe_files import read_text
from lfpipe.files.untrusted import parse_toml
from lfpipe.host.files import exists
from lfpipe.scene.open_scene import open_scene
from lfpipe.sequence.folder import FILES, MANIFEST, is_sequence
from lfpipe.sweep.cell import BENCH, NEEDS_SCENE, NEEDS_SEQUENCE, QUALITY, SUBJECTS, TABLE, Cell

PLAN_BYTES = 1 << 20
MAX_CELLS = 100_000
PROTOCOL: dict[str, list[Any]] = {"keep": [2], "crop": ["central"], "border": [22]}
ALLOWED: dict[str, Callable[[Any], bool]] = {
    "keep": lambda value: value in (2, 3) and value is not True,
    "crop": lambda value: value in ("central", "top-left"),
    "border": lambda value: isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= 1000,
}
KEYS = ("sequences", "scenes", "subjects", "config", "table")
REMEDY = "see `lfpipe sweep --help` for the form of a plan"


@attrs.frozen
class Plan:
    """Paths are absolute, or patterns that match nothing."""

    sequences: tuple[str, ...]
    scenes: tuple[str, ...]
    subjects: tuple[str, ...]
    configs: tuple[tuple[str, ...], ...]
    protocols: tuple[tuple[tuple[str, str], ...], ...]


def read_plan(path: Path) -> Plan:
    """Raises UserError with the key, the value and the remedy."""
    table = parse_toml(read_text(path, PLAN_BYTES, str(path), REMEDY), str(path), REMEDY)
    for key in table:
        if key not in KEYS:
            raise UserError(f"{path}: {key}: no such key", _suggestion(key, KEYS))
    texts = {key: _texts(path, key, table.get(key, [])) for key in ("sequences", "scenes", "subjects")}
    for subject in texts["subjects"]:
        if subject not in SUBJECTS:
            raise UserError(f"{path}: subjects: {subject!r}", _suggestion(subject, SUBJECTS))
    if not texts["subjects"]:
        raise UserError(f"{path}: subjects: the list is empty", f"name at least one of {', '.join(SUBJECTS)}")
    protocol = PROTOCOL | _lists(path, "table", table.get("table", {}))
    for name, values in protocol.items():
        if name not in ALLOWED:
            raise UserError(f"{path}: table.{name}: no such key", _suggestion(name, tuple(ALLOWED)))
        for value in values:
            if not ALLOWED[name](value):
                raise UserError(f"{path}: table.{name}: {value!r}", "see the values in `lfpipe bench table --help`")
    settings = _lists(path, "config", table.get("config", {}))
    sets = {key: [f"{key}={_toml(value)}" for value in values] for key, values in settings.items()}
    combined = tuple(itertools.product(*sets.values()))
    for each in combined:
        config.load(None, each)  # refuses wrong keys and values before anything runs
    count = len(combined) * len(texts["subjects"])
    if count > MAX_CELLS:
        raise UserError(f"{path}: {count} combinations of configurations and subjects", f"reduce them to at most {MAX_CELLS}")
    plan = Plan(
        _expanded(path, texts["sequences"]), _expanded(path, texts["scenes"]), texts["subjects"], combined,
        tuple(tuple(zip(protocol, map(str, each), strict=True)) for each in itertools.product(*protocol.values())),
    )  # fmt: skip
    needed = {"sequences": (NEEDS_SEQUENCE, plan.sequences), "scenes": (NEEDS_SCENE, plan.scenes)}
    for key, (subjects, paths) in needed.items():
        for subject in plan.subjects:
            if subject in subjects and not paths:
                raise UserError(f"{path}: subject {subject} needs {key}", f"add {key} = [...]")
    return plan


def _suggestion(word: str, known: tuple[str, ...]) -> str:
    close = difflib.get_close_matches(word, known, 1, 0.5)
    return f"did you mean {close[0]!r}?" if close else f"use one of {', '.join(known)}"


def _texts(path: Path, key: str, values: Any) -> tuple[str, ...]:
    if not isinstance(values, list) or not all(isinstance(value, str) and value for value in values):
        raise UserError(f"{path}: {key}: {values!r:.100}", f'write a list of strings: {key} = ["..."]')
    return tuple(dict.fromkeys(values))


def _lists(path: Path, key: str, table: Any) -> dict[str, list[Any]]:
    """A table of values or lists of values, nested tables as dotted keys."""
    if not isinstance(table, dict):
        raise UserError(f"{path}: {key}: {table!r:.100}", f"write a table: [{key}]")
    found: dict[str, list[Any]] = {}
    for name, value in table.items():
        if isinstance(value, dict):
            found |= {f"{name}.{inner}": values for inner, values in _lists(path, f"{key}.{name}", value).items()}
        else:
            found[name] = value if isinstance(value, list) else [value]
            if not found[name]:
                raise UserError(f"{path}: {key}.{name}: an empty list", "give at least one value, or leave the key out")
    return found


def _toml(value: Any) -> str:
    """A value in the syntax of `--set`."""
    return value if isinstance(value, str) else json.dumps(value)


def _expanded(plan: Path, patterns: tuple[str, ...]) -> tuple[str, ...]:
    """Paths that the patterns match, in order. A pattern without a match is kept, so that it is reported as missing."""
    found: dict[str, None] = {}
    for pattern in patterns:
        whole = str(plan.resolve().parent / Path(pattern).expanduser())
        matches = sorted(glob.glob(whole)) if any(sign in pattern for sign in "*?[") else []  # noqa: PTH207
        found |= dict.fromkeys(matches or [whole])
    return tuple(found)


def cells(plan: Plan, version: str) -> Iterator[Cell]:
    """Every cell of a plan. version: hash of the code and the versions of its libraries."""
    for subject, sets in itertools.product(plan.subjects, plan.configs):
        sequences = plan.sequences if subject in (*NEEDS_SEQUENCE, *BENCH) else ()
        protocols = plan.protocols if subject in (QUALITY, TABLE) else ((),)
        for sequence, scene, options in itertools.product(sequences or ("",), plan.scenes or ("",), protocols):
            cell = Cell(subject, sequence, scene, sets, options)
            try:
                parts = [version, cell.name, sequence_id(sequence), scene_id(scene, sets)]
            except UserError as error:
                yield attrs.evolve(cell, key=_hash(version, cell.name), why_not=error.message)
            else:
                yield attrs.evolve(cell, key=_hash(*parts))


def _hash(*parts: str) -> str:
    return hashlib.blake2b(json.dumps(parts).encode(), digest_size=12).hexdigest()


@lru_cache(maxsize=100_000)
def sequence_id(path: str) -> str:
    """Hash of a recording by its manifest, which holds checksums, and the sizes of its files. Raises UserError if missing."""
    if not path:
        return ""
    folder = Path(path)
    try:
        if not is_sequence(folder):
            state = folder.stat()
            return _hash(folder.name, str(state.st_size), str(state.st_mtime_ns))
        sizes = [str(file.stat().st_size) if exists(file := folder / name) else "" for name in FILES]
        return _hash(folder.name, (folder / MANIFEST).read_bytes().decode(errors="replace"), *sizes)
    except OSError as error:
        raise UserError(f"{path}: {error.strerror}", "check the path") from None


@lru_cache(maxsize=100_000)
def scene_id(path: str, sets: tuple[str, ...]) -> str:
    """Hash of a scene's contents under the scene settings of a configuration; packs it if needed. Raises UserError."""
    if not path:
        return ""
    settings = config.load(None, [each for each in sets if each.startswith("scene.")]).scene
    return Path(open_scene(path, settings).folder).name
