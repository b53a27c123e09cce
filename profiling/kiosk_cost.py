"""What keys, notices, playlist, thumbnails and exhibition cost a session that uses none of them, in a real window.

    uv run python -m profiling.kiosk_cost [--seconds 10] [--rounds 3] [TREE ...]

Counts the CPU time that render spends in `KeyBindings.serve`, where all of it is called from in each pass of its loop, and of
the whole process. Other checkouts are measured in turn with this one, which comes last. Needs Xvfb. Prints a table.
"""

import importlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import attrs

HERE, OUT = Path(__file__).resolve().parents[1], "LFPIPE_SERVE_COST"


def _timed(serve: Callable[[Any], None], spent: dict[str, int]) -> Callable[[Any], None]:
    def timed(self: Any) -> None:
        before = time.thread_time_ns()
        serve(self)
        spent["ns"] += time.thread_time_ns() - before
        spent["calls"] += 1

    return timed


def main(context: Any) -> None:
    """The stage render with its calls of `serve` counted."""
    from lfpipe.render import stage

    name = "KeyBindings" if hasattr(stage, "KeyBindings") else "Keys"
    keys = getattr(stage, name)
    spent, began = {"ns": 0, "calls": 0}, time.monotonic_ns()
    keys.serve = _timed(keys.serve, spent)
    stage.main(context)
    whole = {"wall_ns": time.monotonic_ns() - began, "cpu_ns": time.process_time_ns()}
    Path(os.environ[OUT]).write_text(json.dumps({**spent, **whole}))


def measure(tree: Path, seconds: float, folder: Path, display: str) -> dict[str, float]:
    """One session of a tree."""
    out = folder / "cost.json"
    out.unlink(missing_ok=True)
    env = {**os.environ, "PYTHONPATH": f"{tree}:{HERE}", OUT: str(out), "DISPLAY": display}
    words = ("up", "--demo", "--display", "window", "--duration", str(seconds), "--session", "kioskcost")
    own = tree / ".venv" / "bin" / "python"  # another checkout may need other packages
    command = [str(own) if own.exists() else sys.executable, "-m", "profiling.kiosk_cost", *words]
    subprocess.run(command, check=True, env=env, capture_output=True, cwd=folder)
    return dict(json.loads(out.read_text()))


def compare() -> None:
    """Measures the trees in turn and prints the medians."""
    parser = importlib.import_module("profiling.arguments").parser_of(__doc__, seconds=10.0, rounds=3)
    parser.add_argument("trees", nargs="*", type=Path)
    args = parser.parse_args()
    from tests.xvfb_screen import x_server

    trees = [*(tree.resolve() for tree in args.trees), HERE]
    found: dict[Path, list[dict[str, float]]] = {tree: [] for tree in trees}
    with tempfile.TemporaryDirectory() as folder, x_server(["Xvfb", "-screen", "0", "1280x800x24"], Path(folder)) as name:
        for _ in range(args.rounds):
            for tree in trees:
                found[tree].append(measure(tree, args.seconds, Path(folder), name))
    print("| tree | serve, us a call | serve, % of a core | render, % of a core | calls a second |\n|---|---|---|---|---|")
    for tree, runs in found.items():
        head = subprocess.run(["git", "-C", tree, "log", "-1", "--format=%h"], capture_output=True, text=True, check=True)

        def middle(of: Callable[[dict[str, float]], float], runs: list[dict[str, float]] = runs) -> float:
            return statistics.median(map(of, runs))

        print(
            f"| {head.stdout.strip()} | {middle(lambda r: r['ns'] / r['calls'] / 1e3):.1f} "
            f"| {middle(lambda r: 100 * r['ns'] / r['wall_ns']):.2f} | {middle(lambda r: 100 * r['cpu_ns'] / r['wall_ns']):.1f} "
            f"| {middle(lambda r: r['calls'] / r['wall_ns'] * 1e9):.1f} |"
        )


if __name__ == "__main__":
    if "up" in sys.argv[1:2]:
        try:
            table = importlib.import_module("lfpipe.supervisor.process_table")
        except ImportError:  # checkouts of before 21 November
            table = importlib.import_module("lfpipe.supervisor.table")
        replaced = (attrs.evolve(s, module="profiling.kiosk_cost") if s.name == "render" else s for s in table.STAGES)
        table.STAGES = tuple(replaced)
        from lfpipe.cli import run

        run()
    else:
        compare()
