"""Writes the results of a sweep: one line per finished cell, then a table, a page and JUnit XML."""

import csv
import html
import io
import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

from lfpipe.bench.report import STYLE
from lfpipe.errors import UserError, plain
from lfpipe.files.line_file import LineFile
from lfpipe.files.safe_files import reason, replaced
from lfpipe.sweep.cell import DIFFERS, FAILED, LEFT_OUT, OK, Outcome, parsed

LINES, TABLE, PAGE, JUNIT = "results.jsonl", "table.csv", "report.html", "junit.xml"
PLACE = "name a folder that you may write to, on a disk with free space: --out DIR"
STATES = (OK, DIFFERS, FAILED, LEFT_OUT)
COLOURS = {OK: "ok", DIFFERS: "failed", FAILED: "failed", LEFT_OUT: "degraded"}
ABOUT = ("state", "subject", "sequence", "scene", "config", "options", "seconds", "host", "reason")


class Store:
    """results.jsonl of a folder: outcomes by key; the last line of a key counts. A partial last line is ignored."""

    def __init__(self, folder: Path, read_only: bool = False) -> None:
        """Raises UserError if the folder cannot be read or written."""
        self.path = folder / LINES
        self.outcomes: dict[str, Outcome] = {}
        try:
            if not read_only:
                folder.mkdir(parents=True, exist_ok=True)
                self._file = LineFile(self.path)
            with self.path.open("rb") as file:
                for line in file:
                    try:
                        found = parsed(json.loads(line))
                    except (ValueError, TypeError):  # a line of another version: the cell is measured again
                        continue
                    self.outcomes[found.key] = found
        except OSError as error:
            raise UserError(f"{self.path}: {reason(error)}", "name a folder that a sweep wrote" if read_only else PLACE) from None

    def append(self, found: Outcome) -> None:
        """Raises UserError if the disk is full; earlier lines stay intact."""
        try:
            self._file.append(found.line())
        except OSError as error:
            what = f"{self.path}: {reason(error)}; finished cells are kept"
            raise UserError(what, "free disk space, then run the same command") from None
        self.outcomes[found.key] = found

    def close(self) -> None:
        self._file.close()


def figure_names(outcomes: Sequence[Outcome]) -> list[str]:
    """Figures of all outcomes, in the order in which they first appear."""
    return list(dict.fromkeys(name for one in outcomes for name in one.figures))


def about(one: Outcome) -> list[str]:
    """The columns ABOUT of a cell."""
    names = (Path(path).name for path in (one.sequence, one.scene))
    options = " ".join(f"{name}={value}" for name, value in one.options)
    return [one.state, one.subject, *names, " ".join(one.sets), options, f"{one.seconds:.2f}", one.host, one.reason]


def rows(outcomes: Sequence[Outcome]) -> list[list[str]]:
    """A table with its header: the columns ABOUT of each cell, and its figures."""
    figures = figure_names(outcomes)
    body = [[*about(one), *(shown(one.figures.get(name, "")) for name in figures)] for one in outcomes]
    return [[*ABOUT, *figures], *body]


def shown(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.6g}"


def verdict(outcomes: Sequence[Outcome]) -> str:
    """Counts by state, in words."""
    counts = Counter(one.state for one in outcomes)
    return f"{len(outcomes)} cells: " + ", ".join(f"{counts[state]} {state}" for state in STATES if counts[state])


def write(outcomes: Sequence[Outcome], folder: Path, junit: Path | None) -> Path:
    """table.csv, the page, and JUnit; returns the path of the page. Raises UserError if the disk is full."""
    table = rows(outcomes)
    text = io.StringIO()
    csv.writer(text).writerows([[plain(cell, 4000) for cell in row] for row in table])
    try:
        for path, content in (
            (folder / TABLE, text.getvalue().encode()),
            (folder / PAGE, _page(outcomes, table).encode()),
            (junit or folder / JUNIT, _junit(outcomes)),
        ):
            with replaced(path, 0o644) as file:
                file.write(content)
    except OSError as error:
        raise UserError(f"{error.filename or folder}: cannot be written: {reason(error)}", PLACE) from None
    return folder / PAGE


def _page(outcomes: Sequence[Outcome], table: list[list[str]]) -> str:
    sections = []
    for subject in dict.fromkeys(one.subject for one in outcomes):
        some = rows([one for one in outcomes if one.subject == subject])
        body = "".join(f"<th>{html.escape(name)}</th>" for name in some[0])
        for row in some[1:]:
            state = f'<td class="{COLOURS[row[0]]}">{row[0]}</td>'
            cells = [state, *(f"<td>{html.escape(plain(cell, 400))}</td>" for cell in row[1:])]
            body += f"<tr>{''.join(cells)}</tr>"
        sections.append(f'<h2>{html.escape(subject)}</h2><div class="wide"><table>{body}</table></div>')
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>lfpipe sweep</title><style>{STYLE}</style></head><body><h1>Sweep</h1><p>{html.escape(verdict(outcomes))}</p>"
        f"{''.join(sections)}</body></html>"
    )


def _junit(outcomes: Sequence[Outcome]) -> bytes:
    counts = Counter(one.state for one in outcomes)
    numbers = {"tests": len(outcomes), "failures": counts[DIFFERS], "errors": counts[FAILED], "skipped": counts[LEFT_OUT]}
    suite = ElementTree.Element("testsuite", {"name": "lfpipe sweep", **{name: str(value) for name, value in numbers.items()}})
    kinds = {DIFFERS: "failure", FAILED: "error", LEFT_OUT: "skipped"}
    for one in outcomes:
        about = {"classname": f"lfpipe.sweep.{one.subject}", "name": plain(one.name, 500), "time": f"{one.seconds:.3f}"}
        case = ElementTree.SubElement(suite, "testcase", about)
        if one.state in kinds:
            said = ElementTree.SubElement(case, kinds[one.state], {"message": plain(one.reason.partition("\n")[0], 1000)})
            said.text = plain(one.reason, 20_000)
    return bytes(ElementTree.tostring(suite, "utf-8", xml_declaration=True))
