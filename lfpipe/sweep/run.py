"""Runs a sweep, from its plan to its report."""

import hashlib
import io
import itertools
import json
import shutil
import tarfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import attrs

from lfpipe.bench.results import source_digest
from lfpipe.errors import UserError
from lfpipe.files.safe_files import reason
from lfpipe.host.paths import is_dir, is_file
from lfpipe.host.versions import versions
from lfpipe.sweep.cell import DIFFERS, DONE, FAILED, OK, QUALITY, REPLAY, Cell, Outcome, outcome
from lfpipe.sweep.engine import Job, Sweep, cluster
from lfpipe.sweep.plan import Plan, cells
from lfpipe.sweep.results import Store
from lfpipe.sweep.work import do_cell

FIGURES = "figures.json"  # reference of a cell without pictures
CLOSE = 1e-3  # relative tolerance of figures, for rounding on other processors
Say = Callable[[str, int, int], None]


@attrs.frozen
class References:
    """Folder of --expect. update: write it instead of comparing."""

    folder: Path
    update: bool = False

    def of(self, cell: Cell) -> Path | None:
        """Path of the reference of a cell; None if its subject has none."""
        return self.folder / cell.folder if cell.subject in (REPLAY, QUALITY) else None

    def tar(self, cell: Cell) -> bytes:
        """The reference of a replay, b"" if there is none."""
        place = self.of(cell)
        if cell.subject != REPLAY or self.update or place is None or not is_dir(place):
            return b""
        buffer = io.BytesIO()
        with tarfile.open(fileobj=buffer, mode="w") as tar:
            for path in sorted(place.iterdir()):
                tar.add(path, arcname=path.name)
        return buffer.getvalue()

    def mark(self, cell: Cell) -> str:
        """Part of a cell's key: the digest of its reference."""
        place = self.of(cell)
        if place is None:
            return ""
        files = sorted(path for path in place.rglob("*") if is_file(path)) if is_dir(place) else []
        if self.update:
            return f"update {bool(files)}"
        digest = hashlib.blake2b(digest_size=8)
        for path in files:
            digest.update(path.read_bytes())
        return digest.hexdigest()

    def store(self, found: Outcome, tar: bytes) -> None:
        """Writes the reference of a finished cell. Raises UserError if the disk is full."""
        place = self.folder / _cell_of(found).folder
        new = place.with_name(f".{place.name}.new")
        try:
            shutil.rmtree(new, ignore_errors=True)
            new.mkdir(parents=True)
            if tar:
                with tarfile.open(fileobj=io.BytesIO(tar)) as packed:
                    packed.extractall(new, filter="data")
            else:
                (new / FIGURES).write_text(json.dumps(found.figures, indent=1))
            shutil.rmtree(place, ignore_errors=True)
            new.replace(place)
        except OSError as error:
            raise UserError(f"--expect {self.folder}: {reason(error)}", "use a folder on a disk with free space") from None

    def judged(self, found: Outcome, tar: bytes) -> Outcome:
        """The outcome; `differs` if it differs from its reference. A cell without a reference fails; with update it is stored.

        tar: the cell's new reference. Raises UserError if the disk is full.
        """
        place = self.of(_cell_of(found))
        if place is None or found.state != OK:
            return found
        if self.update:
            self.store(found, tar)
            return found
        if not is_dir(place):
            return attrs.evolve(found, state=FAILED, reason=f"no reference {place.name}: write it with --update")
        if found.subject == REPLAY:
            return found  # `lfpipe replay` has already compared it
        try:
            was = json.loads((place / FIGURES).read_text())
            wrong = [
                f"{name}: {value} in the reference, now {found.figures.get(name)}"
                for name, value in was.items()
                if abs(float(found.figures.get(name, float("inf"))) - float(value)) > CLOSE * abs(float(value))
            ]
        except (OSError, ValueError, AttributeError) as error:
            return attrs.evolve(found, state=FAILED, reason=f"reference {place.name}: {error}")
        return attrs.evolve(found, state=DIFFERS, reason="\n".join(wrong)) if wrong else found


def _cell_of(found: Outcome) -> Cell:
    return Cell(found.subject, found.sequence, found.scene, found.sets, found.options)


def version() -> str:
    """Hash of the code and of the versions of its libraries."""
    return f"{source_digest()} {sorted((name, each) for name, each in versions().items() if name != 'processor')}"


def sweep(
    plan: Plan,
    out: Path,
    address: str,
    jobs: int,
    references: References | None,
    say: Say,
    work: Callable[..., tuple[Outcome, bytes]] = do_cell,
) -> list[Outcome]:
    """Measures the cells that are not yet in out; returns the outcomes of all cells, in the order of the plan.

    Raises UserError if the plan has no cell, out cannot be written, or the cluster is gone. Finished cells are kept.
    """
    every = [_marked(cell, references) for cell in cells(plan, version())]
    store = Store(out)
    todo: dict[str, Job] = {}  # scenes of equal name and content are one cell
    for cell in every:
        known = store.outcomes.get(cell.key)
        if cell.why_not:
            if known is None or known.reason != cell.why_not:
                store.append(outcome(cell, FAILED, cell.why_not))
        elif known is None or known.state not in DONE:
            tar = partial(references.tar, cell) if references is not None else bytes
            todo[cell.key] = Job(cell, tar, references is not None and references.update)
    left = itertools.count(len(every) - len(todo))

    def take(found: Outcome, new: bytes) -> None:
        if references is not None:
            found = references.judged(found, new)
        store.append(found)
        say("cells", next(left), len(every))

    say("cells", next(left), len(every))
    try:
        if todo:
            with cluster(address, jobs) as client:
                Sweep(client, address, take, work).run(todo.values())
    finally:
        store.close()
    return [store.outcomes[cell.key] for cell in every]


def _marked(cell: Cell, references: References | None) -> Cell:
    """The cell with a key that also depends on its reference."""
    if references is None or not (mark := references.mark(cell)):
        return cell
    return attrs.evolve(cell, key=cell.key + hashlib.blake2b(mark.encode(), digest_size=4).hexdigest())
