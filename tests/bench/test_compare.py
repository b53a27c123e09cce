"""Differences beyond noise are always called, others never."""

import contextlib
import math
import os
import random
from pathlib import Path

import numpy as np
import pytest

from lfpipe.bench.builds import is_build
from lfpipe.bench.comparison import Difference, Paired, compare_results, error_ratios, judge, time_ratios
from lfpipe.bench.model import Figure
from lfpipe.bench.results import Measured, Results, SubjectResults, read
from lfpipe.bench.timing import REFERENCE
from lfpipe.errors import UserError
from profiling.attack.mutations import changed_json

TRIES, FIGURES = 20, 40
TIME = Figure("time_ms", "time", "ms")


def times(rng: np.random.Generator, slower: float) -> list[Difference]:
    """Times like those of two builds: 80 rounds with noise of 5 % and outliers, each turn drawn independently."""
    found = []
    for k in range(FIGURES):
        turns = rng.normal(1, 0.05, (2, 80))
        turns[rng.random(turns.shape) < 0.05] *= 1.8
        ratios = turns[1] / turns[0] * (slower if k == 0 else 1.0)
        found.append(Paired("synthesis", f"method {k}", TIME, "time", ratios.tolist()))
    return judge(found, looks=8)


def test_a_build_against_itself_is_never_called_and_a_slower_one_always() -> None:
    rng = np.random.default_rng(11)
    for _ in range(TRIES):
        assert not any(one.called for one in times(rng, 1.0))
        called = [one.candidate for one in times(rng, 1.10) if one.called and one.worse]
        assert called == ["method 0"]


def test_noise_of_a_fifth_of_a_pixel_is_called_every_time() -> None:
    """Tracking errors of 75 frames; the other build has 0.2 px more noise in each coordinate, never the same."""
    rng = np.random.default_rng(3)
    figure = Figure("error_px", "error", "px", "rms")
    for _ in range(TRIES):
        away = rng.normal(0, 0.15, (75, 2, 2))
        noisy = away + rng.normal(0, 0.2, away.shape)
        a, b = (np.linalg.norm(part, axis=2).max(axis=1).tolist() for part in (away, noisy))
        pairs = [Paired("tracker", name, figure, "error", error_ratios(a, other)) for name, other in (("same", a), ("noisy", b))]
        pairs += [Paired("tracker", f"other {k}", figure, "error", [1.0], exact=True) for k in range(FIGURES)]
        assert [one.candidate for one in judge(pairs) if one.called] == ["noisy"]


def test_chance_and_a_difference_below_the_minimum_effect_are_not_called() -> None:
    rng = np.random.default_rng(9)
    surely_small = Paired("synthesis", "2 %", TIME, "time", rng.normal(1.02, 1e-3, 200).tolist())
    few = Paired("synthesis", "few", TIME, "time", [1.5] * 6)
    small, unsure = judge([surely_small, few], looks=8)
    assert not small.called and small.settled  # as sure as can be, and too small
    assert not unsure.called and not unsure.settled and str(unsure).startswith("unsure")
    assert judge([few])[0].called  # six of six suffice for the only figure and the only look


def test_what_repeats_itself_exactly_needs_no_statistics() -> None:
    figure = Figure("psnr_db", "PSNR", "dB", more_is_better=True)
    for ratio, called, worse in ((0.9, True, True), (1.1, True, False), (1.005, False, False)):
        (one,) = judge([Paired("synthesis", "warp", figure, "error", [ratio], exact=True)])
        assert (one.called, one.worse, one.settled) == (called, worse, True)


def test_errors_of_zero_and_of_other_samples() -> None:
    assert error_ratios([0.0, 2.0], [0.0, 1.0]) == [1.0, 0.5]
    assert error_ratios([0.0, 1e-3], [1e-3, 0.0]) == [1e9, 1e-9]
    assert error_ratios([1.0, 2.0], [1.0]) == []


def test_times_are_taken_over_the_machine_s_own() -> None:
    slow_hour = {"time_ms": [2.0, 4.0], "reference_ms": [1.0, 2.0]}
    assert time_ratios({"time_ms": [1.0, 1.0], "reference_ms": [0.5, 0.5]}, slow_hour, "time_ms") == [1.0, 1.0]
    assert time_ratios({"time_ms": [1.0]}, {"time_ms": [1.5, 9.0]}, "time_ms") == [1.5]


def run(rng: np.random.Generator, slower: float = 1.0, key: str = "k") -> Results:
    measured = {}
    for method in ("warp", "blend"):
        machine = rng.normal(1, 0.2) * rng.normal(1, 0.02, 25)
        turns = {"time_ms": (machine * rng.normal(1, 0.02, 25) * (slower if method == "warp" else 1.0)).tolist()}
        turns["reference_ms"] = machine.tolist()
        measured[f"{method}, plain"] = Measured(method, "plain", False, {"rmse": [3.0, 4.0]}, turns)
    about = {"identity": {"scenes": [key], "sequence": ["a", 3, True], "quick": True}}
    return Results(about, {"synthesis": SubjectResults("synthesis", measured, done=True)})


def test_two_runs_are_compared_over_the_machine(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    for _ in range(TRIES):
        first = run(rng)
        first.write(tmp_path)
        before = read(tmp_path)
        assert not any(one.called for one in compare_results(before, run(rng)))
        called = [one for one in compare_results(before, run(rng, 1.25)) if one.called]
        assert [(one.candidate, one.worse) for one in called] == [("warp, plain", True)]
    with pytest.raises(UserError, match="differ in scenes"):
        compare_results(run(rng), run(rng, key="other"))


def test_stored_results_of_earlier_versions_are_still_comparable() -> None:
    """The committed results hold a subject that no longer exists."""
    stored = read(Path(__file__).parents[2] / "profiling" / "results" / "bench-quick")
    stored.subjects.setdefault("storage", SubjectResults("storage", {"PNG": Measured("PNG", "", True, {"rmse": [0.0]})}))
    found = compare_results(stored, stored)
    assert len(found) > 100 and not any(one.called for one in found)
    assert {one.subject for one in found} == {"tracker", "filters", "synthesis", "anaglyph", "pipeline"}


def test_a_folder_without_results_is_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no results"):
        read(tmp_path)
    (tmp_path / "results.json").write_text('{"format": 1, "about": {}}')
    with pytest.raises(UserError, match="subjects is missing"):
        read(tmp_path)
    assert is_build(Path(__file__).parents[2]) and not is_build(tmp_path)


WHOLE = Path(__file__).parents[2] / "profiling" / "results" / "bench-quick" / "results.json"


@pytest.mark.parametrize("seed", range(30))
def test_damaged_results_are_refused_or_compared(tmp_path: Path, seed: int) -> None:
    (tmp_path / "results.json").write_bytes(changed_json(random.Random(seed), WHOLE.read_bytes()))
    with contextlib.suppress(UserError):
        compare_results(read(tmp_path), read(WHOLE))


@pytest.mark.parametrize("text", ["[" * 100_000, "{}", '{"format": 1}', "1e999"])
def test_what_is_no_results_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "results.json").write_text(text)
    with pytest.raises(UserError) as told:
        read(tmp_path)
    assert told.value.remedy


def test_results_of_gigabytes_are_not_read(tmp_path: Path) -> None:
    (tmp_path / "results.json").touch()
    os.truncate(tmp_path / "results.json", 1 << 33)
    with pytest.raises(UserError, match="bytes"):
        read(tmp_path)


def test_samples_that_were_not_finite_are_left_out(tmp_path: Path) -> None:
    turns = {"a": [1.0, math.nan, 3.0], REFERENCE: [1.0, 1.0, 0.0]}
    assert time_ratios(turns, {"a": [2.0, 2.0, 2.0]}, "a") == [2.0]
    assert error_ratios([1.0, math.nan], [1.0, 1.0]) == []
