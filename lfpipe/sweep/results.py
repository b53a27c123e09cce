"""Results of a sweep: one line per finished cell, references to compare with, a table, a page and JUnit XML."""

import contextlib
import csv
import hashlib
import io
import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import attrs

from lfpipe.bench.style import document, html_table
from lfpipe.errors import UserError, plain
from lfpipe.files.output import check_output, write_output
from lfpipe.files.safe_files import LineFile, reason
from lfpipe.host.files import is_dir, is_file
from lfpipe.sweep.plan import QUALITY, REPLAY, Cell

OK, DIFFERS, FAILED, LEFT_OUT = "ok", "differs", "failed", "left out"
DONE = (OK, DIFFERS, LEFT_OUT)  # not measured again
DIED = "died"  # of a cell whose process died: it runs again, alone; never stored
LINES, TABLE, PAGE, JUNIT = "results.jsonl", "table.csv", "report.html", "junit.xml"
REFERENCE = "figures.json"  # of a cell without pictures
CLOSE = 1e-3  # relative tolerance of figures, for rounding on other processors
PLACE = "name a folder that you may write to, on a disk with free space: --out DIR"
STATES = {OK: "ok", DIFFERS: "failed", FAILED: "failed", LEFT_OUT: "degraded"}  # with the class of the page's style
ABOUT = ("state", "subject", "sequence", "scene", "config", "options", "seconds", "host", "reason")
FORMULA = ("=", "+", "-", "@", "\t", "\r")  # a spreadsheet would compute a text that begins so


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


def parsed(line: bytes) -> Outcome:
    """An outcome from its line. Raises TypeError, KeyError or ValueError for other lines."""
    values = json.loads(line)
    del values["name"]
    cell = Cell(**{field.name: values.pop(field.name) for field in attrs.fields(Cell)})
    pairs = tuple((str(name), str(value)) for name, value in cell.options)
    outcome = Outcome(attrs.evolve(cell, sets=tuple(map(str, cell.sets)), options=pairs), **values)
    if not isinstance(cell.key, str) or outcome.state not in STATES or not isinstance(outcome.figures, dict):
        raise ValueError("not an outcome")
    return outcome


class Store:
    """results.jsonl of a folder: outcomes by key; the last line of a key counts. A partial last line is ignored."""

    def __init__(self, folder: Path) -> None:
        """Raises UserError if the folder cannot be read or written, or has files of these names that are not ours."""
        self.path = folder / LINES
        self.outcomes: dict[str, Outcome] = {}
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for name in (LINES, TABLE, PAGE, JUNIT):
                check_output(folder / name)
            self._file = LineFile(self.path)
            lines = self.path.read_bytes().splitlines()
        except OSError as error:
            raise UserError(f"{self.path}: {reason(error)}", PLACE) from None
        for line in lines:
            with contextlib.suppress(ValueError, TypeError, KeyError):  # a line of another version: the cell is measured again
                outcome = parsed(line)
                self.outcomes[outcome.cell.key] = outcome

    def append(self, outcome: Outcome) -> None:
        """Raises UserError if the disk is full; earlier lines stay intact."""
        try:
            self._file.append(outcome.line())
        except OSError as error:
            what = f"{self.path}: {reason(error)}; finished cells are kept"
            raise UserError(what, "free disk space, then run the same command") from None
        self.outcomes[outcome.cell.key] = outcome

    def close(self) -> None:
        self._file.close()


@attrs.frozen
class Order:
    """How to measure a cell. reference: folder to compare a replay with, "" for none; update: write it instead."""

    limit_s: float
    reference: str = ""
    update: bool = False


@attrs.frozen
class References:
    """folder: with a folder for each replay and quality cell; None compares nothing. update: they are written instead."""

    folder: Path | None = None
    update: bool = False

    def place(self, cell: Cell) -> Path | None:
        """Where the reference of a cell is; None for a subject without."""
        return self.folder / cell.folder if self.folder is not None and cell.subject in (REPLAY, QUALITY) else None

    def order(self, limit_s: float, cell: Cell) -> Order:
        """`lfpipe replay` compares and writes its own references."""
        place = self.place(cell)
        if place is None or cell.subject != REPLAY or not (self.update or is_dir(place)):
            return Order(limit_s)
        place.parent.mkdir(parents=True, exist_ok=True)
        return Order(limit_s, str(place.resolve()), self.update)

    def marked(self, cell: Cell) -> Cell:
        """The cell with a key that also depends on its reference: on its files, or, with update, on whether there are any."""
        if (place := self.place(cell)) is None:
            return cell
        files = sorted(path for path in place.rglob("*") if is_file(path)) if is_dir(place) else []
        content = [f"update {bool(files)}".encode()] if self.update else [path.read_bytes() for path in files]
        return attrs.evolve(cell, key=cell.key + hashlib.blake2b(b"".join(content), digest_size=4).hexdigest())

    def judged(self, outcome: Outcome) -> Outcome:
        """The outcome; `differs` if it differs from its reference. Without a reference it fails; with update it is stored.

        Raises UserError if the disk is full.
        """
        place = self.place(outcome.cell)
        if place is None or outcome.state != OK or (self.update and outcome.cell.subject == REPLAY):
            return outcome
        if self.update:
            place.mkdir(parents=True, exist_ok=True)
            write_output(place / REFERENCE, json.dumps(outcome.figures, indent=1).encode(), label="--expect")
            return outcome
        if not is_dir(place):
            return attrs.evolve(outcome, state=FAILED, reason=f"no reference {place.name}: write it with --update")
        if outcome.cell.subject == REPLAY:
            return outcome
        try:
            reference = json.loads((place / REFERENCE).read_text())
            wrong = [
                f"{name}: {value} in the reference, now {outcome.figures.get(name)}"
                for name, value in reference.items()
                if not abs(float(outcome.figures.get(name, "nan")) - float(value)) <= CLOSE * abs(float(value))
            ]
        except (OSError, ValueError, AttributeError) as error:
            return attrs.evolve(outcome, state=FAILED, reason=f"reference {place.name}: {error}")
        return attrs.evolve(outcome, state=DIFFERS, reason="\n".join(wrong)) if wrong else outcome


def rows(outcomes: Sequence[Outcome]) -> list[list[str]]:
    """A table with its header: the columns ABOUT of each cell, and its figures in the order in which they first appear."""
    figures = list(dict.fromkeys(name for outcome in outcomes for name in outcome.figures))
    body = []
    for outcome in outcomes:
        cell = outcome.cell
        options = " ".join(f"{name}={value}" for name, value in cell.options)
        about = [outcome.state, cell.subject, Path(cell.sequence).name, Path(cell.scene).name, " ".join(cell.sets), options,
                 f"{outcome.seconds:.2f}", outcome.host, outcome.reason]  # fmt: skip
        values = (outcome.figures.get(name, "") for name in figures)
        body.append([*about, *(value if isinstance(value, str) else f"{value:.6g}" for value in values)])
    return [[*ABOUT, *figures], *body]


def verdict(outcomes: Sequence[Outcome]) -> str:
    """Counts by state, in words."""
    counts = Counter(outcome.state for outcome in outcomes)
    return f"{len(outcomes)} cells: " + ", ".join(f"{counts[state]} {state}" for state in STATES if counts[state])


def write(outcomes: Sequence[Outcome], folder: Path, junit: Path | None) -> Path:
    """table.csv, the page, and JUnit; returns the path of the page. Raises UserError if the disk is full."""
    text = io.StringIO()
    csv.writer(text).writerows([[_quoted(cell, k) for k, cell in enumerate(row)] for row in rows(outcomes)])
    page = f"<p>{verdict(outcomes)}</p>"
    for subject in dict.fromkeys(outcome.cell.subject for outcome in outcomes):
        head, *body = rows([outcome for outcome in outcomes if outcome.cell.subject == subject])
        texts = [[plain(text, 400) for text in row] for row in body]
        page += f"<h2>{subject}</h2>" + html_table(head, texts, [[STATES[row[0]]] for row in body])
    write_output(folder / TABLE, text.getvalue().encode())
    write_output(folder / PAGE, document("Sweep", page).encode())
    write_output(junit or folder / JUNIT, _junit(outcomes))
    return folder / PAGE


def _quoted(cell: str, column: int) -> str:
    """A text for a spreadsheet: names come from files. Figures stay as they are."""
    text = plain(cell, 4000)
    return f"'{text}" if column < len(ABOUT) and text.startswith(FORMULA) else text


def _junit(outcomes: Sequence[Outcome]) -> bytes:
    counts = Counter(outcome.state for outcome in outcomes)
    numbers = {"tests": len(outcomes), "failures": counts[DIFFERS], "errors": counts[FAILED], "skipped": counts[LEFT_OUT]}
    suite = ElementTree.Element("testsuite", {"name": "lfpipe sweep", **{name: str(value) for name, value in numbers.items()}})
    kinds = {DIFFERS: "failure", FAILED: "error", LEFT_OUT: "skipped"}
    for outcome in outcomes:
        about = {"classname": f"lfpipe.sweep.{outcome.cell.subject}", "name": plain(outcome.cell.name, 500)}
        case = ElementTree.SubElement(suite, "testcase", {**about, "time": f"{outcome.seconds:.3f}"})
        if outcome.state in kinds:
            first = plain(outcome.reason.partition("\n")[0], 1000)
            ElementTree.SubElement(case, kinds[outcome.state], {"message": first}).text = plain(outcome.reason, 20_000)
    return bytes(ElementTree.tostring(suite, "utf-8", xml_declaration=True))
