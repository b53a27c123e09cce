"""References of a sweep, one folder per replay or quality cell: what --expect compares with and --update writes."""

import hashlib
import json
from pathlib import Path
from typing import Any

import attrs

from lfpipe.errors import UserError
from lfpipe.files.safe_files import reason
from lfpipe.host.files import is_dir, is_file
from lfpipe.sweep.cell import DIFFERS, FAILED, OK, QUALITY, REPLAY, Cell, Outcome

FIGURES = "figures.json"  # reference of a cell without pictures
CLOSE = 1e-3  # relative tolerance of figures, for rounding on other processors


def place_of(cell: Cell, expect: Path | None) -> Path | None:
    """Folder of the reference of a cell; None if its subject has none, or without --expect."""
    return expect / cell.folder if expect is not None and cell.subject in (REPLAY, QUALITY) else None


def marked(cell: Cell, expect: Path | None, update: bool) -> Cell:
    """The cell with a key that also depends on its reference: on its files, or, with update, on whether there are any."""
    if (place := place_of(cell, expect)) is None:
        return cell
    files = sorted(path for path in place.rglob("*") if is_file(path)) if is_dir(place) else []
    digest = hashlib.blake2b(f"update {bool(files)}".encode() if update else b"", digest_size=4)
    for path in [] if update else files:
        digest.update(path.read_bytes())
    return attrs.evolve(cell, key=cell.key + digest.hexdigest())


def judged(outcome: Outcome, expect: Path | None, update: bool) -> Outcome:
    """The outcome; `differs` if it differs from its reference. Without a reference it fails; with update it is stored.

    `lfpipe replay` compares and writes its own references. Raises UserError if the disk is full.
    """
    place = place_of(outcome.cell, expect)
    if place is None or outcome.state != OK or (update and outcome.cell.subject == REPLAY):
        return outcome
    if update:
        try:
            place.mkdir(parents=True, exist_ok=True)
            (place / FIGURES).write_text(json.dumps(outcome.figures, indent=1))
        except OSError as error:
            raise UserError(f"--expect {expect}: {reason(error)}", "use a folder on a disk with free space") from None
        return outcome
    if not is_dir(place):
        return attrs.evolve(outcome, state=FAILED, reason=f"no reference {place.name}: write it with --update")
    if outcome.cell.subject == REPLAY:
        return outcome
    try:
        reference: dict[str, Any] = json.loads((place / FIGURES).read_text())
        wrong = [
            f"{name}: {value} in the reference, now {outcome.figures.get(name)}"
            for name, value in reference.items()
            if abs(float(outcome.figures.get(name, float("inf"))) - float(value)) > CLOSE * abs(float(value))
        ]
    except (OSError, ValueError, AttributeError) as error:
        return attrs.evolve(outcome, state=FAILED, reason=f"reference {place.name}: {error}")
    return attrs.evolve(outcome, state=DIFFERS, reason="\n".join(wrong)) if wrong else outcome
