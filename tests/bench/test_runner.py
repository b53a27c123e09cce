"""The runner: turns are interleaved, failures are kept by name, an interrupted run continues."""

import itertools
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from lfpipe.bench.diagrams import draw
from lfpipe.bench.inputs import Inputs
from lfpipe.bench.model import Candidate, Diagram, Figure, Prepared, Skipped, Subject
from lfpipe.bench.report import number, write_report
from lfpipe.bench.results import Measured, Results, SubjectResults, empty_diagrams, read
from lfpipe.bench.runner import run
from tests.bench.inputs import inputs, wall

FIGURES = (Figure("error_px", "error", "px", "rms"), Figure("time_ms", "time", "ms"))
DIAGRAM = Diagram("fake", "Fake", "time_ms", "error_px")


class FakeSubject:
    """A subject of four candidates: two sound, one that throws, one that gives NaN in its third turn."""

    def __init__(self, interrupted_after: int = 10**9) -> None:
        self.turns: list[str] = []
        self.measured: list[str] = []
        self.closed: list[str] = []
        self._left = interrupted_after
        self.subject = Subject(
            "fake", "FakeSubject", "?", FIGURES, (DIAGRAM,), self.candidates, budget_s=(0.2, 0.2), turns=(4, 4)
        )

    def candidates(self, _: Inputs) -> Iterator[Candidate | Skipped]:
        yield Skipped("colour", "the scene is grey")
        for name in ("one", "two", "throws", "nan"):
            yield Candidate(name, "", lambda name=name: self.prepare(name), name == "one")  # type: ignore[misc]

    def prepare(self, name: str) -> Prepared:
        count = itertools.count()

        def errors() -> dict[str, list[float]]:
            self.measured.append(name)
            if name == "throws":
                raise ArithmeticError("no root")
            return {"error_px": [3.0, 4.0]}

        def turn() -> dict[str, float]:
            self._left -= 1
            if self._left < 0:
                raise KeyboardInterrupt
            self.turns.append(name)
            return {"time_ms": float("nan") if name == "nan" and next(count) == 2 else 1.0 + 0.5 * (len(self.turns) % 2)}

        return Prepared(errors, turn, lambda: self.closed.append(name))


def quiet(*_: object) -> None:
    pass


def test_failures_are_omissions_with_their_reason(tmp_path: Path) -> None:
    fake, found = FakeSubject(), SubjectResults("fake")
    run(fake.subject, inputs(wall(2, 2), tmp_path), found, quiet, quiet)  # type: ignore[arg-type]
    assert found.omissions == {"throws": "ArithmeticError: no root", "nan": "ValueError: not finite: time_ms"}
    assert set(found.measured) == {"one", "two"}
    assert found.measured["one"].paper and not found.measured["two"].paper
    assert found.measured["one"].value(FIGURES[0]) == pytest.approx(12.5**0.5)
    assert found.skipped == [Skipped("colour", "the scene is grey")]
    assert {"one", "two"} <= set(fake.closed)
    assert all(len(one.turns["time_ms"]) >= 4 for one in found.measured.values())


def test_turns_are_interleaved_and_warmed_up(tmp_path: Path) -> None:
    fake, found = FakeSubject(), SubjectResults("fake")
    run(fake.subject, inputs(wall(2, 2), tmp_path), found, quiet, quiet)  # type: ignore[arg-type]
    sound = [name for name in fake.turns if name in ("one", "two")]
    for k in range(0, 10, 2):  # the warm-up and the fewest rounds
        assert set(sound[k : k + 2]) == {"one", "two"}
    assert len(sound) == 2 + sum(len(one.turns["time_ms"]) for one in found.measured.values())  # the first does not count


def test_an_interrupted_run_continues(tmp_path: Path) -> None:
    results = Results({"identity": {}})
    found = results.subjects.setdefault("fake", SubjectResults("fake"))
    fake, given = FakeSubject(interrupted_after=11), inputs(wall(2, 2), tmp_path)
    with pytest.raises(KeyboardInterrupt):
        run(fake.subject, given, found, quiet, lambda: results.write(tmp_path))
    kept = read(tmp_path).subjects["fake"]
    before = {name: list(one.turns["time_ms"]) for name, one in kept.measured.items()}
    assert before and not kept.done
    again = FakeSubject()
    run(again.subject, given, kept, quiet, quiet)  # type: ignore[arg-type]
    assert again.measured == []  # errors are known, and what threw is not tried again
    assert kept.done and kept.omissions["throws"] == "ArithmeticError: no root"
    for name, turns in before.items():
        if name in kept.measured:
            assert kept.measured[name].turns["time_ms"][: len(turns)] == turns


def test_noise_is_stated_however_few_the_turns(tmp_path: Path) -> None:
    """A long turn gives the samples of its parts; of too few turns the number is shown."""
    turns = iter([[3.0, 5.0, 4.0, 4.0, 3.0, 5.0], [4.0, 4.0, 4.0, 4.0, 4.0, 4.0]])

    def turn() -> dict[str, float | list[float]]:
        time.sleep(0.4)  # the budget ends in the second one
        return {"time_ms": next(turns), "first_s": 2.0}

    prepared = Prepared(dict, turn)
    figures = (FIGURES[1], Figure("first_s", "start", "s"))
    subject = Subject("long", "Long", "?", figures, (), lambda _: iter([Candidate("one", "", lambda: prepared)]), turns=(2, 2),
                      budget_s=(0.5, 0.5))  # fmt: skip
    found = SubjectResults("long")
    run(subject, inputs(wall(2, 2), tmp_path), found, quiet, quiet)  # type: ignore[arg-type]
    one = found.measured["one"]
    assert one.turns["time_ms"] == [4.0, 4.0] and len(one.parts["time_ms"]) == 12
    assert number(one, figures[0]) == "4 ± 0 %" and number(one, figures[1]) == "2 (2 runs, 2 to 2)"
    one.parts.clear()
    assert number(one, figures[0]) == "4 (2 runs, 4 to 4)"
    one.turns["time_ms"].pop()
    assert number(one, figures[0]) == "4 (1 run)"


def test_a_diagram_without_its_figure_is_left_out_with_the_reason() -> None:
    only_timed = {"one": Measured("one", "", False, {}, {"time_ms": [1.0]})}
    found = SubjectResults("fake", only_timed)
    assert empty_diagrams(FakeSubject().subject, found)["fake"].endswith("nothing measured of error")
    only_timed["one"].errors["error_px"] = [2.0]
    assert empty_diagrams(FakeSubject().subject, found) == {}


def test_an_exact_zero_stands_where_the_axis_says_so() -> None:
    errors = {"none": [0.0], "some": [2.0], "more": [9.0]}
    found = SubjectResults(
        "fake", {name: Measured(name, "", False, {"error_px": e, "time_ms": [1.0]}) for name, e in errors.items()}
    )
    axes = draw(FakeSubject().subject, found, DIAGRAM).axes[0]
    ticks = {label.get_text(): place for label, place in zip(axes.get_yticklabels(), axes.get_yticks(), strict=True)}
    heights = {str(line.get_label()): float(np.ravel(line.get_ydata())[0]) for line in axes.get_lines()}
    assert heights["none"] == ticks["0"] < heights["some"] == 2.0
    assert [text for text, place in ticks.items() if place < 1.0] == ["0"]


def test_report_stands_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake, found = FakeSubject(), SubjectResults("fake")
    run(fake.subject, inputs(wall(2, 2), tmp_path), found, quiet, quiet)  # type: ignore[arg-type]
    monkeypatch.setitem(__import__("lfpipe.bench.subjects", fromlist=["SUBJECTS"]).SUBJECTS, "fake", fake.subject)
    machine = {"processor": "<p>", "cores": 2, "system": "s", "load": 0.1}
    about = {"command": "lfpipe bench", "scenes": ["s"], "sequence": "q", "machine": machine, "versions": {}, "commit": "c"}
    page = write_report(Results(about | {"started": "now"}, {"fake": found}), tmp_path).read_text()
    assert "ArithmeticError: no root" in page and "the scene is grey" in page and "&lt;p&gt;" in page
    first, rest = page.partition("<nav>")[::2]
    assert "2 failed" in first and "least error" in first and "the paper" in first and "<table" not in first, "the conclusion"
    assert "Makes no sense here" in rest and "Left out for speed" not in rest
    assert rest.index("How it was measured") > rest.index("grey")
    assert "prefers-color-scheme: dark" in page and "the paper" in (tmp_path / "summary.md").read_text().lower()
    for reference in ("http://", "https://", "<script", "<link"):
        assert reference not in page
    names = {path.name for path in (tmp_path / "diagrams").iterdir()}
    assert names == {"fake.png", "fake.svg", "fake-dark.svg"}
    light, dark = ((tmp_path / "diagrams" / name).read_text() for name in ("fake.svg", "fake-dark.svg"))
    assert "#0072b2" in light and "#0072b2" not in dark and "#56b4e9" in dark
