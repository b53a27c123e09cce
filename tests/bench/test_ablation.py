"""profiling/ablation.py changes one constant, and its lists name constants that exist."""

import ast
from pathlib import Path

import pytest

from profiling.ablation import ROOT, Trial, line, replaced, trials, value_of
from tools.count_constants import constants

SOURCE = "A, B = 1, (2.0, 3.0)  # é\nC: int = 4\nNAME = 'x'\n\nclass K:\n    D = 5\n"


@pytest.mark.parametrize(
    ("constant", "old", "new"),
    [("A", "1", "9"), ("B", "(2.0, 3.0)", "()"), ("C", "4", "1e9"), ("K.D", "5", "None")],
)
def test_one_constant_is_replaced(constant: str, old: str, new: str) -> None:
    changed = replaced(SOURCE, constant, new)
    assert changed == SOURCE.replace(old, new)
    assert ast.unparse(value_of(SOURCE, constant)) == old
    with pytest.raises(KeyError):
        replaced(SOURCE, "E", new)


@pytest.mark.parametrize("path", sorted((ROOT / "profiling/ablations").glob("*.csv")))
def test_every_line_names_a_constant(path: Path) -> None:
    for trial in trials(path):
        source = (ROOT / "lfpipe" / trial.file).read_text()
        assert replaced(source, trial.constant, trial.neutral) != source, trial


def test_verdict_weighs_all_figures() -> None:
    trial = Trial("eyes.py", "MAX_PREDICTION_S", "1.0", ())
    before = {"a": 1.0, "b": 1.0}
    assert "no effect" in line(trial, before, {"a": 1.005, "b": 1.0})
    assert "| a | 1 | 1.2 | 1, 1 | earns its place: +5.0 % |" in line(
        trial, before, {"a": 1.2, "b": 0.9}
    )
    assert "better without" in line(trial, before, {"a": 1.1, "b": 0.8})


def test_constants_are_counted_by_name() -> None:
    assert constants(SOURCE) == ["A", "B", "C"]
