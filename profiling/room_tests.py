"""The tests of each room under one Python with one host. Results stay in one table, which a run of any part completes."""

from __future__ import annotations

import collections
import os
import platform
import re
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path

import attrs

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "profiling" / "results" / "hosts-rooms.md"
LOOSE = "(others)"  # tests of no room
COLUMNS = ("3.11 native", "3.11 portable", "3.12 native", "3.12 portable", "3.13 native", "3.13 portable")
OPTIONS = ("-p", "no:cacheprovider")


def rooms() -> list[str]:
    """Folders of tests that need no virtual machine, and the loose files."""
    folders = {path.parent.name for path in (ROOT / "tests").glob("*/test_*.py")}
    return [*sorted(folders - {"camera_vm"}), LOOSE]


@attrs.frozen
class Tally:
    """Outcome of a room's tests. failed, again: names of those that failed, and of those that passed only when they ran again;
    skipped: reason -> how many.
    """

    passed: int
    failed: list[str]
    again: list[str]
    skipped: dict[str, int]

    @classmethod
    def read(cls, path: Path) -> Tally:
        """From a report in JUnit's format; a test that ran twice has two entries."""
        found, tries, skipped = {}, collections.Counter[tuple[str, str]](), collections.Counter[str]()
        for case in ElementTree.parse(path).iter("testcase"):
            reason = case.find("skipped")
            if reason is not None:
                skipped[reason.get("message", "")] += 1
                continue
            key = case.get("classname", ""), case.get("name", "")
            found[key] = case.find("failure") is None and case.find("error") is None
            tries[key] += 1
        failed = [name for (place, name), passed in found.items() if not passed]
        again = [name for (place, name), passed in found.items() if passed and tries[place, name] > 1]
        return cls(len(found) - len(failed), failed, again, dict(sorted(skipped.items())))

    @property
    def cell(self) -> str:
        parts = ((self.passed, "passed"), (len(self.failed), "failed"), (sum(self.skipped.values()), "skipped"))
        return ", ".join(f"{count} {word}" for count, word in parts if count) or "none"

    @property
    def notes(self) -> list[str]:
        failed = [f"failed: `{name}`" for name in self.failed]
        again = [f"passed when it ran again: `{name}`" for name in self.again]
        return [*failed, *again, *(f"skipped {n}: {why}" for why, n in self.skipped.items())]


def run(room: str, python: Path, env: dict[str, str]) -> Tally:
    """Runs the tests of a room. A run that ends without a report counts as one failure."""
    where = [ROOT / "tests" / room] if room != LOOSE else sorted((ROOT / "tests").glob("test_*.py"))
    with tempfile.TemporaryDirectory(prefix="lfr") as name:
        report = Path(name) / "report.xml"
        done = subprocess.run([python, "-m", "pytest", *OPTIONS, f"--junitxml={report}", *where], cwd=ROOT, env=env)
        return Tally.read(report) if report.exists() else Tally(0, [f"pytest itself, exit code {done.returncode}"], [], {})


class Table:
    """The table in RESULTS, and the notes below it."""

    def __init__(self) -> None:
        text = RESULTS.read_text() if RESULTS.exists() else ""
        rows = [[cell.strip() for cell in line.strip("| ").split("|")] for line in text.splitlines() if line.startswith("| ")]
        self._cells = {(row[0], column): cell for row in rows[1:] for column, cell in zip(rows[0][1:], row[1:], strict=False)}
        self._notes = collections.defaultdict[tuple[str, str], list[str]](list)
        for column, room, note in re.findall(r"^- (\S+ \S+), (\S+): (.*)$", text, re.MULTILINE):
            self._notes[room, column].append(note)

    def put(self, room: str, column: str, tally: Tally) -> None:
        self._cells[room, column] = tally.cell
        self._notes[room, column] = tally.notes
        RESULTS.write_text(self._text())

    def _text(self) -> str:
        columns = [name for name in COLUMNS if any(column == name for _, column in self._cells)]
        lines = ["| room | " + " | ".join(columns) + " |", "|---" * (1 + len(columns)) + "|"]
        for room in rooms():
            lines.append(f"| {room} | " + " | ".join(self._cells.get((room, column), "not run") for column in columns) + " |")
        notes = [f"- {column}, {room}: {note}" for column in columns for room in rooms() for note in self._notes[room, column]]
        machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores beside other programs"
        hosts = "native: Linux's own host; portable: `LFPIPE_HOST=portable`"
        head = f"# Tests by room, Python and host\n\n`python profiling/hosts.py --rooms` on {machine}. {hosts}."
        return "\n".join([head, "", *lines, "", "## Failures, and reasons of skips", "", *(notes or ["None."]), ""])


def run_all(version: str, python: Path, env: dict[str, str], wanted: Sequence[str]) -> bool:
    """Runs these rooms, or all; enters each result at once. Returns whether all passed."""
    column = f"{version} {env.get('LFPIPE_HOST') or 'native'}"
    passed = True
    for room in wanted or rooms():
        tally = run(room, python, env)
        Table().put(room, column, tally)
        print(f"{column}, {room}: {tally.cell}", file=sys.stderr, flush=True)
        passed &= not tally.failed
    return passed
