"""Results of a sweep: one line per finished cell, a table, a page and JUnit XML."""

import contextlib
import csv
import io
import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import attrs

from lfpipe.bench.style import document, html_table
from lfpipe.errors import UserError, plain
from lfpipe.extras.sweep.plan import Cell
from lfpipe.files.safe_files import LineFile, check_output, reason, write_output
from lfpipe.host.files import exists
from lfpipe.replays.run import Kind, TestCase, junit

OK, DIFFERS, FAILED, LEFT_OUT = "ok", "differs", "failed", "left out"
DONE = (OK, DIFFERS, LEFT_OUT)  # not measured again
DIED = "died"  # of a cell whose process died: it runs again, alone; never stored
LINES, TABLE, PAGE, JUNIT = "results.jsonl", "table.csv", "report.html", "junit.xml"
PLACE = "name a folder that you may write to, on a disk with free space: --out DIR"
# with the class of the page's style
STATES = {OK: "ok", DIFFERS: "failed", FAILED: "failed", LEFT_OUT: "degraded"}
KINDS: dict[str, Kind] = {DIFFERS: "failure", FAILED: "error", LEFT_OUT: "skipped"}
ABOUT = ("state", "subject", "sequence", "scene", "config", "options", "seconds", "host", "reason")
FORMULA = ("=", "+", "-", "@", "\t", "\r")  # a spreadsheet would compute a text that begins so


@attrs.frozen
class Outcome:
    """The outcome of a cell."""

    cell: Cell
    state: str
    reason: str = ""
    metrics: dict[str, float | str] = attrs.Factory(dict)
    """Numbers and digests by name."""
    seconds: float = 0.0
    """Of its process."""
    host: str = ""
    began_s: float = 0.0
    """Unix time."""

    def row(self) -> dict[str, str]:
        """As a row of a table: the columns ABOUT, then the figures."""
        cell = self.cell
        about = (
            self.state,
            cell.subject,
            Path(cell.sequence).name,
            Path(cell.scene).name,
            " ".join(cell.sets),
            " ".join(cell.options),
            f"{self.seconds:.2f}",
            self.host,
            self.reason,
        )
        metrics = {
            name: value if isinstance(value, str) else f"{value:.6g}"
            for name, value in self.metrics.items()
        }
        return {**dict(zip(ABOUT, about, strict=True)), **metrics}


class Store:
    """results.jsonl of a folder: finished outcomes by the key of their cell. A partial last line is
    ignored.
    """

    def __init__(self, folder: Path) -> None:
        """Raises UserError if the folder cannot be read or written, or has files of these names,
        but no results.
        """
        self.path = folder / LINES
        self.outcomes: dict[str, Outcome] = {}
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for name in () if exists(self.path) else (LINES, TABLE, PAGE, JUNIT):
                check_output(folder / name)
            self._file = LineFile(self.path)
            lines = self.path.read_bytes().splitlines()
        except OSError as error:
            raise UserError(f"{self.path}: {reason(error)}", PLACE) from None
        for line in lines:
            # a line of another version: the cell is measured again
            with contextlib.suppress(ValueError, TypeError, KeyError):
                fields = json.loads(line)
                cell = Cell(**{name: fields.pop(name) for name in attrs.fields_dict(Cell)})
                cell = attrs.evolve(cell, sets=tuple(cell.sets), options=tuple(cell.options))
                if fields["state"] in DONE:
                    self.outcomes[cell.key] = Outcome(cell, **fields)

    def append(self, outcome: Outcome) -> None:
        """Raises UserError if the disk is full; earlier lines stay intact."""
        fields = attrs.asdict(outcome)
        try:
            self._file.append(json.dumps({**fields.pop("cell"), **fields}).encode() + b"\n")
        except OSError as error:
            what = f"{self.path}: {reason(error)}; finished cells are kept"
            raise UserError(what, "free disk space, then run the same command") from None
        self.outcomes[outcome.cell.key] = outcome

    def close(self) -> None:
        self._file.close()


def verdict(outcomes: Sequence[Outcome]) -> str:
    """Counts by state, in words."""
    counts = Counter(outcome.state for outcome in outcomes)
    return f"{len(outcomes)} cells: " + ", ".join(
        f"{counts[state]} {state}" for state in STATES if counts[state]
    )


def write(outcomes: Sequence[Outcome], folder: Path, junit: Path | None) -> Path:
    """table.csv, the page, and JUnit; returns the path of the page.

    Raises UserError if the disk is full.
    """
    rows = [outcome.row() for outcome in outcomes]
    text = io.StringIO()
    table = csv.DictWriter(
        text, list(dict.fromkeys([*ABOUT, *(name for row in rows for name in row)]))
    )
    table.writeheader()
    table.writerows(
        {name: _quoted(cell) if name in ABOUT else cell for name, cell in row.items()}
        for row in rows
    )
    page = f"<p>{verdict(outcomes)}</p>"
    for subject in dict.fromkeys(row["subject"] for row in rows):
        of_subject = [row for row in rows if row["subject"] == subject]
        head = list(dict.fromkeys(name for row in of_subject for name in row))
        texts = [[plain(row.get(name, ""), 400) for name in head] for row in of_subject]
        page += f"<h2>{subject}</h2>" + html_table(
            head, texts, [[STATES[row["state"]]] * len(head) for row in of_subject]
        )
    write_output(folder / TABLE, text.getvalue().encode())
    write_output(folder / PAGE, document("Sweep", page).encode())
    write_output(junit or folder / JUNIT, _junit(outcomes))
    return folder / PAGE


def _quoted(cell: str) -> str:
    """A text for a spreadsheet: names come from files."""
    text = plain(cell, 4000)
    return f"'{text}" if text.startswith(FORMULA) else text


def _junit(outcomes: Sequence[Outcome]) -> bytes:
    return junit(
        "lfpipe sweep",
        [
            TestCase(
                classname=f"lfpipe.extras.sweep.{outcome.cell.subject}",
                name=outcome.cell.name,
                kind=KINDS.get(outcome.state, ""),
                message=outcome.reason.partition("\n")[0],
                text=outcome.reason,
                seconds=outcome.seconds,
            )
            for outcome in outcomes
        ],
    )
