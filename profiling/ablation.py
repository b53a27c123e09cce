"""Which constants earn their place: replaces each by a neutral value and measures again.

    python -m profiling.ablation profiling/ablations/track.csv [--only CONSTANT]... [--out FILE.md]
        [--tracks FOLDER] [--scene FOLDER]...

The list is a CSV of file (in lfpipe), constant (at the module's head, or Class.NAME), neutral value
and measures, separated by spaces. A neutral value makes the rule that has the constant do nothing.
A function may stand for a constant; its neutral value is another function.
Each line is measured in a copy of the packages, two lines at a time:

eyes      `profiling.eyes_tracks`: the default filter on the tracks of --tracks
faces     failures of tests/track/test_people.py: real heads, hands and portraits
viewer    viewpoints of every script of `lfpipe bench viewer`, the default settings
pictures  `lfpipe bench viewer --quick`, pictures too
layouts   `profiling.scene_layouts`: 0 for a set that opens right, 1 undecided or noted, 2 wrong
table     `lfpipe bench table` on each --scene: PSNR

All figures are deterministic, and less is better. Changes of less than 1 % count as none. A
constant earns its place if the mean relative change of all figures without it is a loss, or if more
figures are beyond the bounds of `bench viewer --check`.
"""

import ast
import csv
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import attrs
import numpy as np

from lfpipe.errors import UserError
from profiling.arguments import existing, parser_of, start

ROOT = Path(__file__).parents[1]
COPIED = ("lfpipe", "profiling", "tests", "pyproject.toml")
NOISE = 0.01  # relative changes below it count as none
SMALL_FIGURE = 0.05  # changes of smaller figures are relative to this
AT_ONCE = 2
BOUNDED = "figures beyond their bounds"
Figures = dict[str, float]


@attrs.frozen
class Trial:
    """A constant and what it may be replaced by."""

    file: str
    constant: str
    neutral: str
    measures: tuple[str, ...]


def trials(path: Path) -> list[Trial]:
    """The lines of a list."""
    with path.open(newline="") as file:
        return [
            Trial(row["file"], row["constant"], row["neutral"], tuple(row["measures"].split()))
            for row in csv.DictReader(file)
        ]


def value_of(source: str, constant: str) -> ast.expr | ast.FunctionDef:
    """The expression that a module assigns to a constant, or the function of that name. Raises
    KeyError if there is none.
    """
    body: Sequence[ast.stmt] = ast.parse(source).body
    *classes, name = constant.split(".")
    for kind in classes:
        body = next(one for one in body if isinstance(one, ast.ClassDef) and one.name == kind).body
    for node in body:
        if isinstance(node, ast.FunctionDef) and node.name == name:
            return node
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        value = getattr(node, "value", None)
        for target in targets:
            pairs = [(target, value)]
            if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
                pairs = list(zip(target.elts, value.elts, strict=True))
            for one, expression in pairs:
                if (
                    isinstance(one, ast.Name)
                    and one.id == name
                    and isinstance(expression, ast.expr)
                ):
                    return expression
    raise KeyError(constant)


def replaced(source: str, constant: str, neutral: str) -> str:
    """The source with another value of a constant."""
    node = value_of(source, constant)
    if isinstance(node, ast.FunctionDef):
        neutral = f"{constant} = {neutral}"
    lines = source.encode().splitlines(keepends=True)
    before = sum(map(len, lines[: node.lineno - 1])) + node.col_offset
    after = sum(map(len, lines[: (node.end_lineno or 0) - 1])) + (node.end_col_offset or 0)
    whole = source.encode()
    return (whole[:before] + neutral.encode() + whole[after:]).decode()


def eyes(tracks: Path) -> Figures:
    from lfpipe.config import Track
    from lfpipe.track.filters.base import make_filter
    from profiling.eyes_tracks import FAULTS, added, clips, metrics, shown

    names = ("moving", "still", "step", "overshoot", "all")
    figures: Figures = {}
    recorded = clips(tracks)
    for rate_hz in (0, 60):
        found = [clip.measured(rate_hz) for clip in recorded] if rate_hz else recorded
        for delay_s in (0.0, 0.08):
            rows = [
                metrics(clip, *shown(clip, make_filter(Track(), delay_s), True, delay_s))
                for clip in found
            ]
            of = f"{rate_hz or 'recorded'} {'Hz' if rate_hz else 'rate'}, {1e3 * delay_s:.0f} ms"
            figures |= {
                f"{name}, {of}": median
                for name, median in zip(names, np.nanmedian(rows, axis=0).tolist(), strict=True)
            }
    for name, fault in FAULTS.items():
        peaks = [
            added(clip, make_filter(Track()), make_filter(Track()), True, 0.0, fault)
            for clip in recorded
        ]
        figures[name] = float(np.median(peaks))
        figures[f"{name}, worst"] = max(peaks)
    return figures


def viewer() -> Figures:
    from lfpipe.bench.simulator.metrics import BOUNDS
    from lfpipe.bench.simulator.run import Setup
    from lfpipe.bench.simulator.scripts import MOVES_ABOUT, SCRIPTS
    from lfpipe.bench.viewer import CAMERAS, viewpoints

    figures: Figures = {}
    beyond = 0
    setups = [(script.name, Setup(), script) for script in SCRIPTS]
    setups += [(f"camera {name}", Setup(camera=one), MOVES_ABOUT) for name, one in CAMERAS.items()]
    for row, setup, script in setups:
        found = viewpoints(setup, script)
        bounds = BOUNDS.get(row, {})
        for key in ("error_views", "error_p95", "step_cols", "step_rows", "right_s", "lag_ms"):
            figures[f"{row}: {key}"] = found.get(key, 0.0)
            beyond += found.get(key, 0.0) > bounds.get(key, np.inf)
        if "depth" in found:
            figures[f"{row}: without depth"] = 100 - found["depth"]
    return figures | {BOUNDED: beyond}


def faces() -> Figures:
    words = ["pytest", "-q", "-n", "0", "--tb=no", "-p", "no:cacheprovider"]
    done = subprocess.run(
        [sys.executable, "-m", *words, "tests/track/test_people.py"],
        capture_output=True,
        text=True,
        check=False,
    )
    if "." not in done.stdout.splitlines()[0]:
        raise UserError(done.stdout.strip()[-200:], "put the sample faces beside the checkout")
    return {"failed tests": float(len(re.findall("^FAILED", done.stdout, re.MULTILINE)))}


def _bench(*words: str) -> list[tuple[str, str, float]]:
    """(row, column, value) of `lfpipe bench`."""
    with tempfile.TemporaryDirectory() as out:
        command = [sys.executable, "-m", "lfpipe", "bench", *words, "--out", out]
        subprocess.run(command, capture_output=True, check=True)
        found = json.loads(Path(out, "results.json").read_text())["benchmarks"]
    return [
        (row["name"], column, cell["value"])
        for one in found.values()
        for table in one["tables"]
        for row in table["rows"]
        for column, cell in row["values"].items()
    ]


def pictures() -> Figures:
    lower = ("error_views", "step_cols", "step_rows", "right_s", "levels", "seen", "error_levels")
    return {
        f"{row}: {column}": value
        for row, column, value in _bench("viewer", "--quick")
        if column in lower
    }


def table(scenes: Sequence[Path]) -> Figures:
    return {
        f"{row}: -PSNR": -value
        for row, column, value in _bench("table", *map(str, scenes), "--untimed")
        if column == "psnr_db"
    }


def layouts() -> Figures:
    from profiling.scene_layouts import results

    grades = {"right": 0.0, "refused": 0.0, "undecided": 1.0, "note": 1.0}
    return {f"{group}, {kind}": grades.get(word, 2.0) for group, kind, _, word, _ in results()}


def measure(names: Sequence[str], tracks: Path | None, scenes: Sequence[Path]) -> Figures:
    """The figures of these measures, of the package that is imported."""
    every: dict[str, Callable[[], Figures]] = {
        "eyes": lambda: eyes(tracks) if tracks else {},
        "faces": faces,
        "viewer": viewer,
        "pictures": pictures,
        "layouts": layouts,
        "table": lambda: table(scenes),
    }
    return {f"{name}: {key}": one for name in names for key, one in every[name]().items()}


def measured(trial: Trial | None, names: Sequence[str], options: Sequence[str]) -> Figures | str:
    """The figures in a copy of the packages, with the neutral value; a text says why not."""
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent, "checkout")
        folder.mkdir()
        Path(parent, "shared").symlink_to(ROOT.parent / "shared")  # sample data
        for name in COPIED:
            copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
            copy(ROOT / name, folder / name)
        if trial is not None:
            file = folder / "lfpipe" / trial.file
            file.write_text(replaced(file.read_text(), trial.constant, trial.neutral))
        words = ["-m", "profiling.ablation", "--measure", *names, *options]
        done = subprocess.run(
            [sys.executable, *words],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"},
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            return done.stderr.strip().splitlines()[-1][:80]
        found: Figures = json.loads(done.stdout.splitlines()[-1])
        return found


def changes(before: Figures, after: Figures) -> Figures:
    """The relative change of each figure, at most 1 either way; 0 below NOISE."""
    found = {
        key: (after[key] - value) / max(abs(value), SMALL_FIGURE) for key, value in before.items()
    }
    return {key: float(np.clip(one, -1, 1)) * (abs(one) > NOISE) for key, one in found.items()}


def line(trial: Trial, before: Figures, after: Figures | str) -> str:
    """The row of a trial."""
    found_value = value_of((ROOT / "lfpipe" / trial.file).read_text(), trial.constant)
    value = "function" if isinstance(found_value, ast.FunctionDef) else ast.unparse(found_value)
    head = f"| {trial.file} | {trial.constant} | {value} | {trial.neutral} |"
    if isinstance(after, str):
        return f"{head} | | | | earns its place: fails without: {after} |"
    found = changes(before, after)
    if not any(found.values()):
        return f"{head} | | | | no effect |"
    worst = max(found, key=lambda key: found[key])
    mean = sum(found.values()) / len(found)
    counts = f"{sum(one > 0 for one in found.values())}, {sum(one < 0 for one in found.values())}"
    exceeded = any(
        change > 0 for key, change in found.items() if key.endswith((BOUNDED, "failed tests"))
    )
    verdict = "earns its place" if mean > 0 or exceeded else "better without"
    return (
        f"{head} {worst} | {before[worst]:.4g} | {after[worst]:.4g} | {counts} | {verdict}:"
        f" {100 * mean:+.1f} % |"
    )


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("list", type=existing, nargs="?")
    parser.add_argument("--only", action="append", default=[])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--tracks", type=existing)
    parser.add_argument("--scene", type=existing, action="append", default=[])
    parser.add_argument("--measure", nargs="+", default=[])
    given = parser.parse_args()
    if given.measure:
        print(json.dumps(measure(given.measure, given.tracks, given.scene)))
        return
    options = [f"--tracks={given.tracks.resolve()}"] if given.tracks else []
    options += [f"--scene={scene.resolve()}" for scene in given.scene]
    chosen = [one for one in trials(given.list) if not given.only or one.constant in given.only]
    lines = [
        f"`python -m profiling.ablation {given.list}`: the figure that gets worst without each",
        "constant, how many figures change by more than 1 %, and the mean change of all.",
        "",
        "| file | constant | value | neutral | figure | with | without | worse, better | verdict |",
        "|---|---|--:|--:|---|--:|--:|--:|---|",
    ]
    with ThreadPoolExecutor(AT_ONCE) as pool:
        sets = {one.measures for one in chosen}
        before = dict(
            zip(sets, pool.map(lambda names: measured(None, names, options), sets), strict=True)
        )
        if wrong := [one for one in before.values() if isinstance(one, str)]:
            sys.exit(wrong[0])
        found = pool.map(lambda one: measured(one, one.measures, options), chosen)
        for trial, after in zip(chosen, found, strict=True):
            usual = before[trial.measures]
            assert not isinstance(usual, str)
            lines.append(line(trial, usual, after))
            print(lines[-1], flush=True)
    if given.out:
        given.out.write_text("# Ablation\n\n" + "\n".join(lines) + "\n")


if __name__ == "__main__":
    start(main)
