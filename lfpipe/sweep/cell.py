"""A cell of a sweep, one subject on one sequence and one scene with one configuration; and its outcome."""

import hashlib
import json
import re
from pathlib import Path
from typing import Any

import attrs

QUALITY, TABLE, REPLAY, TRUTH = "quality", "table", "replay", "truth"
BENCH = ("tracker", "filters", "synthesis", "anaglyph", "stability")  # as `lfpipe bench` names them
SUBJECTS = (REPLAY, TRUTH, QUALITY, TABLE, *BENCH)
NEEDS_SEQUENCE, NEEDS_SCENE = (REPLAY, TRUTH), (QUALITY, TABLE)
TIMED = (TABLE, *BENCH)  # run alone on a host

OK, DIFFERS, FAILED, LEFT_OUT = "ok", "differs", "failed", "left out"
DONE = (OK, DIFFERS, LEFT_OUT)  # not measured again
DIED = "died"  # of a cell whose process died: it runs again, alone; never stored


@attrs.frozen
class Cell:
    """sequence, scene: paths, "" for none. sets: KEY=VALUE texts of the configuration. options: of the subject, by name.

    key: hash of everything that affects the outcome. why_not: why the cell cannot be measured, "" if it can.
    """

    subject: str
    sequence: str
    scene: str
    sets: tuple[str, ...]
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


@attrs.frozen
class Outcome:
    """The outcome of a cell. figures: numbers and digests by name. seconds: of its process. began_s: Unix time."""

    cell: Cell
    state: str
    reason: str = ""
    figures: dict[str, float | str] = attrs.Factory(dict)
    seconds: float = 0.0
    host: str = ""
    began_s: float = 0.0

    def line(self) -> bytes:
        """As a line of results.jsonl: the fields of the cell beside those of the outcome."""
        outcome = attrs.asdict(self)
        return json.dumps({**outcome.pop("cell"), "name": self.cell.name, **outcome}).encode() + b"\n"


def parsed(values: dict[str, Any]) -> Outcome:
    """An outcome from its line. Raises TypeError, KeyError or ValueError for other lines."""
    values = {name: value for name, value in values.items() if name != "name"}
    cell = Cell(**{field.name: values.pop(field.name) for field in attrs.fields(Cell)})
    pairs = tuple((str(name), str(value)) for name, value in cell.options)
    found = Outcome(attrs.evolve(cell, sets=tuple(map(str, cell.sets)), options=pairs), **values)
    if not isinstance(cell.key, str) or found.state not in (*DONE, FAILED) or not isinstance(found.figures, dict):
        raise ValueError("not an outcome")
    return found
