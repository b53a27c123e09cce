"""The runner interleaves repetitions and keeps failures; the report begins with verdicts."""

import itertools
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

from lfpipe.bench import runner
from lfpipe.bench.benchmarks import BENCHMARKS, Benchmark, Choice
from lfpipe.bench.inputs import Inputs
from lfpipe.bench.page import verdict, write_report
from lfpipe.bench.results import (
    Column,
    Results,
    Row,
    Table,
    Value,
    judged_table,
    read,
    write,
)
from lfpipe.bench.runner import Offer, Prepared, Variant, run
from lfpipe.errors import UserError
from tests.bench.inputs import inputs, wall

COLUMNS = (Column("error_px", "error", "px"), Column("time_ms", "time", "ms"))
CHOICE = Choice("track.fake", 11.0, "a third of a frame", 0.5)
FAKE = Benchmark(
    name="fake",
    title="Fake benchmark",
    question="?",
    columns=COLUMNS,
    charts=(("time_ms", "error_px"),),
    choice=CHOICE,
    rounds=(7, 7),
)


class FakeModule(ModuleType):
    """The module of FAKE."""

    def measure(self, _inputs: Inputs) -> list[Offer]:
        return ["colour: the scene is grey"]


def measured() -> tuple[Results, list[str]]:
    """Four variants: two sound, one that raises, one that gives NaN in its third repetition; and
    the repetitions that were taken.
    """
    repetitions: list[str] = []

    def variant(name: str) -> Variant:
        count = itertools.count()

        def repetition() -> dict[str, float]:
            repetitions.append(name)
            return {
                "time_ms": float("nan")
                if name == "nan" and next(count) == 2
                else 1.0 + 0.5 * (len(repetitions) % 2)
            }

        def prepare() -> Prepared:
            if name == "throws":
                raise ArithmeticError("no root")
            return {"error_px": Value(3.5)}, repetition

        return Variant(
            curve=name, parameter="", prepare=prepare, paper=name == "one", used=name == "two"
        )

    offers: list[Offer] = [
        "colour: the scene is grey",
        *map(variant, ("one", "two", "throws", "nan")),
    ]
    return run(FAKE, offers, True, print), repetitions


def test_failures_are_kept_with_their_reason_and_repetitions_are_interleaved() -> None:
    results, repetitions = measured()
    assert results.failures == {
        "throws": "ArithmeticError: no root",
        "nan": "ValueError: not finite: time_ms",
    }
    assert [(row.name, row.paper, row.used) for row in results.rows] == [
        ("one", True, False),
        ("two", False, True),
    ]
    assert results.rows[0].value("error_px") == 3.5
    assert results.left_out == ["colour: the scene is grey"]
    sound = [name for name in repetitions if name in ("one", "two")]
    assert len(sound) == 14 and all(
        {"one", "two"} == set(sound[k : k + 2]) for k in range(0, 14, 2)
    )


def row(name: str, time_ms: float, error_px: float, paper: bool = False, used: bool = False) -> Row:
    values = {"time_ms": Value(time_ms, time_ms * 0.9, time_ms * 1.1), "error_px": Value(error_px)}
    return Row(name, values, name, "", paper, used)


OURS = row("ours", 4.0, 6.0, used=True)
# rows, the verdict, and words of its reason
VERDICTS: dict[str, tuple[tuple[Row, ...], str, list[str]]] = {
    "what ties is kept": (
        (
            row("old", 2.0, 9.0, paper=True),
            row("ours", 4.0, 3.05, used=True),
            row("best", 5.0, 3.0),
            row("slow", 50.0, 1.0),
        ),
        "ours (in use)",
        ["(old)", "11 ms"],
    ),
    "what is better costs": (
        (row("old", 2.0, 9.0, paper=True), OURS, row("best", 5.0, 3.0), row("slow", 50.0, 1.0)),
        "best",
        ["(ours)", "11 ms"],
    ),
    # the same run beside other work gives the same verdict
    "a limit within an interval": (
        (OURS, row("near", 11.0, 3.0), row("slow", 50.0, 1.0)),
        "undecided: near",
        ["9.9 to 12.1", "11 ms"],
    ),
    "a difference that nobody sees": (
        (row("old", 2.0, 9.0, paper=True), row("ours", 4.0, 0.9, used=True), row("best", 5.0, 0.5)),
        "ours (in use)",
        ["within 0.5 of the least"],
    ),
    "undecided, but no better": (
        (OURS, row("near", 11.0, 5.9), row("slow", 50.0, 1.0)),
        "ours (in use)",
        [],
    ),
}


@pytest.mark.parametrize("kind", VERDICTS)
def test_verdict_keeps_what_ties_and_names_the_cost(kind: str) -> None:
    rows, choice, words = VERDICTS[kind]
    found = verdict(FAKE, Results("fake", [Table("method", COLUMNS, rows)]))
    assert found is not None and found[:2] == ("track.fake", choice)
    assert all(word in found[2] for word in words) and found[3].endswith(") ms: time")


def test_report_stands_alone_and_reads_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    results, _ = measured()
    results.about = {"command": "lfpipe bench fake --quick", "started": "now", "machine": "<p>"}
    monkeypatch.setitem(BENCHMARKS, "fake", FAKE)
    write({"fake": results}, tmp_path)
    assert read(tmp_path) == {"fake": results}, "as they were"
    text = write_report({"fake": results}, tmp_path).read_text()
    assert "two (in use)" in text.partition("<nav>")[0] and "&lt;p&gt;" in text
    assert "ArithmeticError: no root" in text and "the scene is grey" in text
    assert not re.search("https?://|<script|<link", re.sub(r'"data:[^"]*"', "", text))
    failed = judged_table(
        "", "", "case", {"a": 0}, {"b": 0}, lambda row, column: (f"{row / column}", "ok")
    )
    assert failed.rows[0].values["b"].state == "failed"


def test_nothing_that_lfpipe_did_not_write_is_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(BENCHMARKS, "fake", FAKE)
    monkeypatch.setitem(sys.modules, "lfpipe.bench.fake", FakeModule("fake"))
    given = inputs(wall(2, 2), tmp_path)
    for name in runner.FILES:
        mine = tmp_path / name
        mine.write_text("my own notes")
        with pytest.raises(UserError, match=name):
            runner.measure(["fake"], given, tmp_path, print)
        assert mine.read_text() == "my own notes"
        mine.unlink()
    for _ in range(2):  # its own files are replaced
        write_report(runner.measure(["fake"], given, tmp_path, print), tmp_path)
