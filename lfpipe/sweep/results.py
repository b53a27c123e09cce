"""Writes the results of a sweep: one line per finished cell, then a table, a page and JUnit XML."""

import csv
import html
import io
import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

from lfpipe.bench.style import STYLE
from lfpipe.errors import UserError, plain
from lfpipe.files.line_file import LineFile
from lfpipe.files.output import check_output
from lfpipe.files.safe_files import reason, replaced
from lfpipe.sweep.cell import DIFFERS, FAILED, LEFT_OUT, OK, Outcome, parsed

LINES, TABLE, PAGE, JUNIT = "results.jsonl", "table.csv", "report.html", "junit.xml"
PLACE = "name a folder that you may write to, on a disk with free space: --out DIR"
STATES = {OK: "ok", DIFFERS: "failed", FAILED: "failed", LEFT_OUT: "degraded"}  # with the class of the page's style
ABOUT = ("state", "subject", "sequence", "scene", "config", "options", "seconds", "host", "reason")
FORMULA = ("=", "+", "-", "@", "\t", "\r")  # a spreadsheet would compute a text that begins so


class Store:
    """results.jsonl of a folder: outcomes by key; the last line of a key counts. A partial last line is ignored."""

    def __init__(self, folder: Path, read_only: bool = False) -> None:
        """Raises UserError if the folder cannot be read or written."""
        self.path = folder / LINES
        self.outcomes: dict[str, Outcome] = {}
        try:
            if not read_only:
                folder.mkdir(parents=True, exist_ok=True)
                for name in (LINES, TABLE, PAGE, JUNIT):
                    check_output(folder / name)
                self._file = LineFile(self.path)
            with self.path.open("rb") as file:
                for line in file:
                    try:
                        outcome = parsed(json.loads(line))
                    except (ValueError, TypeError, KeyError):  # a line of another version: the cell is measured again
                        continue
                    self.outcomes[outcome.cell.key] = outcome
        except OSError as error:
            raise UserError(f"{self.path}: {reason(error)}", "name a folder that a sweep wrote" if read_only else PLACE) from None

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


def rows(outcomes: Sequence[Outcome]) -> list[list[str]]:
    """A table with its header: the columns ABOUT of each cell, and its figures in the order in which they first appear."""
    figures = list(dict.fromkeys(name for outcome in outcomes for name in outcome.figures))
    body = []
    for outcome in outcomes:
        cell = outcome.cell
        names = (Path(path).name for path in (cell.sequence, cell.scene))
        options = " ".join(f"{name}={value}" for name, value in cell.options)
        about = [cell.subject, *names, " ".join(cell.sets), options, f"{outcome.seconds:.2f}", outcome.host, outcome.reason]
        values = (outcome.figures.get(name, "") for name in figures)
        body.append([outcome.state, *about, *(value if isinstance(value, str) else f"{value:.6g}" for value in values)])
    return [[*ABOUT, *figures], *body]


def verdict(outcomes: Sequence[Outcome]) -> str:
    """Counts by state, in words."""
    counts = Counter(outcome.state for outcome in outcomes)
    return f"{len(outcomes)} cells: " + ", ".join(f"{counts[state]} {state}" for state in STATES if counts[state])


def write(outcomes: Sequence[Outcome], folder: Path, junit: Path | None) -> Path:
    """table.csv, the page, and JUnit; returns the path of the page. Raises UserError if the disk is full."""
    table, text = rows(outcomes), io.StringIO()
    csv.writer(text).writerows([[_quoted(cell, k) for k, cell in enumerate(row)] for row in table])
    try:
        for path, content in (
            (folder / TABLE, text.getvalue().encode()),
            (folder / PAGE, _page(outcomes).encode()),
            (junit or folder / JUNIT, _junit(outcomes)),
        ):
            with replaced(path, 0o644) as file:
                file.write(content)
    except OSError as error:
        raise UserError(f"{error.filename or folder}: cannot be written: {reason(error)}", PLACE) from None
    return folder / PAGE


def _quoted(cell: str, column: int) -> str:
    """A text for a spreadsheet: names come from files. Figures stay as they are."""
    text = plain(cell, 4000)
    return f"'{text}" if column < len(ABOUT) and text.startswith(FORMULA) else text


def _page(outcomes: Sequence[Outcome]) -> str:
    sections = ""
    for subject in dict.fromkeys(outcome.cell.subject for outcome in outcomes):
        head, *body = rows([outcome for outcome in outcomes if outcome.cell.subject == subject])
        lines = "".join(f"<th>{html.escape(name)}</th>" for name in head)
        for row in body:
            cells = "".join(f"<td>{html.escape(plain(cell, 400))}</td>" for cell in row[1:])
            lines += f'<tr><td class="{STATES[row[0]]}">{row[0]}</td>{cells}</tr>'
        sections += f'<h2>{html.escape(subject)}</h2><div class="wide"><table>{lines}</table></div>'
    return (
        '<!doctype html><!-- written by lfpipe --><html lang="en">'
        '<head><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>lfpipe sweep</title><style>{STYLE}</style></head><body><h1>Sweep</h1><p>{html.escape(verdict(outcomes))}</p>"
        f"{sections}</body></html>"
    )


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
