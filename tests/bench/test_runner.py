"""The runner: turns are interleaved, failures are kept by name; the report begins with verdicts."""

import itertools
import re
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from lfpipe.bench import runner
from lfpipe.bench.inputs import Inputs
from lfpipe.bench.page import verdict, write_report
from lfpipe.bench.results import (
    Candidate,
    Cell,
    Chart,
    Choice,
    Figure,
    Prepared,
    Row,
    Skipped,
    Subject,
    SubjectResults,
    Table,
    Value,
    read,
    write,
)
from lfpipe.bench.runner import run
from lfpipe.bench.stats import front
from lfpipe.errors import UserError
from tests.bench.inputs import inputs, wall

FIGURES = (Figure("error_px", "error", "px", "rms"), Figure("time_ms", "time", "ms"))
CHART = Chart("fake", "Fake", "time_ms", "error_px")
CHOICE = Choice("track.fake", "time_ms", "error_px", 11.0, "a third of a frame")


class FakeSubject:
    """A subject of four candidates: two sound, one that throws, one that gives NaN in its third turn."""

    def __init__(self) -> None:
        self.turns: list[str] = []
        self.closed: list[str] = []
        self.subject = Subject("fake", "Fake subject", "?", FIGURES, (CHART,), self.candidates, budget_s=(0.2, 0.2), turns=(4, 4))

    def candidates(self, _: Inputs) -> Iterator[Candidate | Skipped]:
        yield Skipped("colour", "the scene is grey")
        for name in ("one", "two", "throws", "nan"):
            yield Candidate(name, "", lambda name=name: self.prepare(name), name == "one", name == "two")  # type: ignore[misc]

    def prepare(self, name: str) -> Prepared:
        count = itertools.count()

        def errors() -> dict[str, list[float]]:
            if name == "throws":
                raise ArithmeticError("no root")
            return {"error_px": [3.0, 4.0]}

        def turn() -> dict[str, float]:
            self.turns.append(name)
            return {"time_ms": float("nan") if name == "nan" and next(count) == 2 else 1.0 + 0.5 * (len(self.turns) % 2)}

        return Prepared(errors, turn, lambda: self.closed.append(name))


def quiet(*_: object) -> None:
    pass


def test_failures_are_kept_with_their_reason_and_turns_are_interleaved(tmp_path: Path) -> None:
    fake = FakeSubject()
    found = run(fake.subject, inputs(wall(2, 2), tmp_path), quiet)
    assert found.failures == {"throws": "ArithmeticError: no root", "nan": "ValueError: not finite: time_ms"}
    one, two = found.rows
    assert (one.name, one.paper, one.used) == ("one", True, False) and (two.name, two.paper, two.used) == ("two", False, True)
    assert one.value("error_px") == pytest.approx(12.5**0.5) and one.figures["time_ms"].turns >= 4
    assert found.skipped == [Skipped("colour", "the scene is grey")] and {"one", "two"} <= set(fake.closed)
    sound = [name for name in fake.turns if name in ("one", "two")]
    for k in range(0, 10, 2):  # the warm-up and the fewest rounds
        assert set(sound[k : k + 2]) == {"one", "two"}
    assert len(sound) == 2 + sum(row.figures["time_ms"].turns for row in found.rows)  # the warm-up does not count


def test_results_come_back_as_they_were(tmp_path: Path) -> None:
    found = run(FakeSubject().subject, inputs(wall(2, 2), tmp_path), quiet)
    found.tables = [Table("t", "n", ("a", "b"), ((Cell("x"), Cell("1", "failed", "render.method=warp")),))]
    write({"fake": found}, tmp_path)
    assert read(tmp_path) == {"fake": found}


def test_noise_is_stated_however_few_the_turns(tmp_path: Path) -> None:
    """A long turn gives the samples of its parts; of too few turns the number and the range are shown."""
    turns = iter([[3.0, 5.0, 4.5, 4.5, 3.0, 5.0], [3.0, 5.0, 4.0, 4.0, 3.0, 5.0]])

    def turn() -> dict[str, float | list[float]]:
        time.sleep(0.4)  # the budget ends in the second one
        return {"time_ms": next(turns), "first_s": 2.0}

    subject = Subject("long", "Long", "?", (FIGURES[1], Figure("first_s", "start", "s")), (),
                      lambda _: iter([Candidate("one", "", lambda: Prepared(dict, turn))]), turns=(2, 2),
                      budget_s=(0.5, 0.5))  # fmt: skip
    figures = run(subject, inputs(wall(2, 2), tmp_path), quiet).rows[0].figures
    assert figures["time_ms"].text == "4.25 ± 24 %" and figures["first_s"].text == "2 (2 runs, 2 to 2)"
    assert Value(4.0, 4.0, 4.0, 1).text == "4 (1 run, 4 to 4)" and Value(4.0, 4.0, 4.0).text == "4"


def row(name: str, time_ms: float, half: float, error: float, **more: bool) -> Row:
    time_value = Value(time_ms, time_ms - half, time_ms + half, 9)
    return Row(name, name, "", more.get("paper", False), more.get("used", False), "",
               {"time_ms": time_value, "error_px": Value(error, error, error)})  # fmt: skip


def test_what_ties_within_its_noise_is_beaten_by_the_better_error() -> None:
    """Three settings of one code differ by 0.2 % of time and 2 % of noise: only the most exact is on the front."""
    points = [(10.02, 0.1, 5.0, 0.0), (10.0, 0.1, 6.0, 0.0), (9.98, 0.1, 7.0, 0.0), (1.0, 0.1, 9.0, 0.0)]
    assert front(points) == [3, 0]


def test_a_verdict_keeps_what_ties_and_names_the_cost() -> None:
    subject = Subject("fake", "Fake", "?", FIGURES, (CHART,), choice=CHOICE)
    found = SubjectResults("fake", rows=[row("old", 2.0, 0.1, 9.0, paper=True), row("ours", 4.0, 0.1, 3.05, used=True),
                                         row("best", 5.0, 0.1, 3.0), row("slow", 50.0, 1.0, 1.0)])  # fmt: skip
    kept = verdict(subject, found)
    assert kept is not None and kept.choice == "ours (in use)" and "old" in kept.why and kept.cost.startswith("4 ± 2 % ms")
    found.rows[1] = row("ours", 4.0, 0.1, 6.0, used=True)
    other = verdict(subject, found)
    assert other is not None and other.choice == "best" and "ours" in other.why and "11 ms" in other.why


def test_report_stands_alone_and_begins_with_verdicts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake = FakeSubject()
    subject = Subject(
        **{**{a: getattr(fake.subject, a) for a in ("name", "title", "question", "figures", "charts")}, "choice": CHOICE}
    )
    found = run(fake.subject, inputs(wall(2, 2), tmp_path), quiet)
    found.about = {"command": "lfpipe bench fake --quick", "machine": "<p>"}
    cells = ((Cell("a"), Cell("9", "failed"), Cell("8", "degraded", "render.method=blend")),)
    found.tables = [Table("Extreme", "note", ("case", "b", "c"), cells)]
    monkeypatch.setitem(runner.SUBJECTS, "fake", subject)
    page = write_report({"fake": found}, tmp_path).read_text()
    first, rest = page.partition("<nav>")[::2]
    assert "two (in use)" in first and "wall time" in first and "CPU" in first
    matters = [re.sub("<[^>]+>", "|", line) for line in first.split("<tr") if "Extreme" in line]
    assert len(matters) == 2 and "yes: in use" in matters[0] and "only with render.method=blend" in matters[1]
    assert "ArithmeticError: no root" in first and "the scene is grey" in rest and "&lt;p&gt;" in page
    assert "lfpipe bench fake --quick" in rest and "prefers-color-scheme: dark" in page
    for reference in ("http://", "https://", "<script", "<link"):
        assert reference not in re.sub(r'"data:[^"]*"', "", page)
    text = (tmp_path / "summary.md").read_text()
    assert "two ■" in text and "one ★" in text and (tmp_path / "charts" / "fake.svg").stat().st_size > 1000


def test_an_exact_zero_stands_where_the_axis_says_so() -> None:
    from lfpipe.bench.charts import points

    found = SubjectResults("fake", rows=[row("none", 1.0, 0.1, 0.0), row("some", 1.0, 0.1, 2.0), row("more", 1.0, 0.1, 9.0)])
    zero, some, _ = points(found, CHART)
    assert zero.zero == (False, True) and 0 < zero.y < some.y == 2.0


def test_nothing_that_lfpipe_did_not_write_is_replaced(tmp_path: Path) -> None:
    given = inputs(wall(2, 2), tmp_path)
    for name in ("results.json", "report.html", "summary.md"):
        mine = tmp_path / name
        mine.write_text("my own notes")
        with pytest.raises(UserError, match=name):
            runner.measure(["judder"], given, tmp_path, quiet)
        assert mine.read_text() == "my own notes"
        mine.unlink()
    write_report(runner.measure([], given, tmp_path, quiet), tmp_path)
    write_report(runner.measure([], given, tmp_path, quiet), tmp_path)  # its own files are replaced
