"""What differs beyond noise is called every time, and what does not never is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lfpipe.bench.builds import is_build
from lfpipe.bench.compare import Difference, Paired, compare_results, error_ratios, judge, time_ratios
from lfpipe.bench.model import Figure
from lfpipe.bench.results import Measured, Results, SubjectResults, read
from lfpipe.errors import UserError

TRIES, FIGURES = 20, 40
TIME = Figure("time_ms", "time", "ms")


def times(rng: np.random.Generator, slower: float) -> list[Difference]:
    """As two builds give them: twelve pairs of processes with a luck of 1.5 % each, turns with noise of 4 % and outliers."""
    found = []
    for k in range(FIGURES):
        groups = []
        for _ in range(12):
            turns = rng.normal(1, 0.04, 4) * rng.normal(1, 0.015) * (slower if k == 0 else 1.0)
            turns[rng.random(4) < 0.05] *= 1.8
            groups.append([float(np.median(turns))])
        found.append(Paired("synthesis", f"method {k}", TIME, "time", groups))
    return judge(found)


def test_a_build_against_itself_is_never_called_and_a_slower_one_always() -> None:
    rng = np.random.default_rng(11)
    for _ in range(TRIES):
        assert not any(one.called for one in times(rng, 1.0))
        called = [one.candidate for one in times(rng, 1.10) if one.called and one.worse]
        assert called == ["method 0"]


def test_noise_of_a_fifth_of_a_pixel_is_called_every_time() -> None:
    """Tracking errors of 135 frames; the other build has 0.2 px more noise in each coordinate."""
    rng = np.random.default_rng(3)
    figure = Figure("error_px", "error", "px", "rms")
    for _ in range(TRIES):
        away = rng.normal(0, 0.15, (135, 2, 2))
        noisy = away + rng.normal(0, 0.2, away.shape)
        a, b = (np.linalg.norm(part, axis=2).max(axis=1).tolist() for part in (away, noisy))
        ratios = {name: error_ratios(a, other) for name, other in (("same", a), ("noisy", b))}
        pairs = [Paired("tracker", name, figure, "error", [[r] for r in found]) for name, found in ratios.items()]
        pairs += [Paired("tracker", f"other {k}", figure, "error", [[1.0]] * 135) for k in range(FIGURES)]
        assert [one.candidate for one in judge(pairs) if one.called] == ["noisy"]


def test_errors_of_zero_and_of_other_samples() -> None:
    assert error_ratios([0.0, 2.0], [0.0, 1.0]) == [1.0, 0.5]
    assert error_ratios([0.0], [1e-3]) == [1e9]
    assert error_ratios([1.0, 2.0], [1.0]) == []


def test_times_are_taken_over_the_machine_s_own() -> None:
    slow_hour = {"time_ms": [2.0, 4.0], "reference_ms": [1.0, 2.0]}
    assert time_ratios({"time_ms": [1.0, 1.0], "reference_ms": [0.5, 0.5]}, slow_hour, "time_ms") == [[1.0], [1.0]]
    assert time_ratios({"time_ms": [1.0]}, {"time_ms": [1.5, 9.0]}, "time_ms") == [[1.5]]


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
        called = [one for one in compare_results(before, run(rng, 1.10)) if one.called]
        assert [(one.candidate, one.worse) for one in called] == [("warp, plain", True)]
    with pytest.raises(UserError, match="differ in scenes"):
        compare_results(run(rng), run(rng, key="other"))


def test_a_folder_without_results_is_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no results"):
        read(tmp_path)
    (tmp_path / "results.json").write_text('{"format": 1, "about": {}}')
    with pytest.raises(UserError, match="no results"):
        read(tmp_path)
    assert is_build(Path(__file__).parents[2]) and not is_build(tmp_path)
