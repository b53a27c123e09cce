"""What the default suite covers, by room, and what share of small faults (mutants) its tests
notice; writes results/tests.md.

    python -m profiling.tests_coverage [--coverage] [--mutation] [--mutants N] [--module NAME ...]

A part that is not asked for keeps its last result. A mutant changes one operator, comparison,
constant or truth of a module. It takes the module's place in a process of its own, the module's
tests run there, and it is killed if one of them fails. Two run at once. N of them are drawn from a
module with a fixed seed; 0 stands for all.
"""

import ast
import contextlib
import json
import os
import random
import re
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from types import ModuleType

from profiling.arguments import parser_of

ROOT = Path(__file__).parents[1]
REPORT = ROOT / "profiling" / "results" / "tests.md"
MODULES = {  # module -> the tests that are about it
    "transport.ring": ["transport/test_ring.py", "transport/test_packet_ring.py"],
    "transport.histogram": ["transport/test_small_parts.py"],
    "render.viewpoint": ["render/test_viewpoint.py", "render/test_handedness.py"],
    "track.filters.base": ["track/test_filters.py"],
    "render.anaglyph": ["render/test_anaglyph.py"],
    "supervisor.requests": ["supervisor/test_requests.py"],
    "supervisor.session_state": ["supervisor/test_session_state.py", "supervisor/test_governor.py"],
    "supervisor.governor": ["supervisor/test_governor.py"],
    "scene.orientation": ["scene/test_orientation_rules.py", "scene/test_orientation.py"],
}
AT_ONCE = 2
LIMIT_S = 300.0  # of one mutant's tests: one that never ends is killed, too
SWAPS: dict[type, type] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Add,
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.And: ast.Or,
    ast.Or: ast.And,
}


class Mutator(ast.NodeTransformer):
    """Counts the places where a fault fits; makes the one numbered chosen. what: that place."""

    def __init__(self, chosen: int = -1) -> None:
        self.chosen = chosen
        self.count = 0
        self.what = ""

    def _here(self, node: ast.AST, what: str) -> bool:
        self.count += 1
        if self.count - 1 == self.chosen:
            self.what = f"line {getattr(node, 'lineno', 0)}: {what}"
        return self.count - 1 == self.chosen

    def _swapped(self, node: ast.AST, operator: ast.AST) -> ast.AST:
        swap = SWAPS.get(type(operator), type(operator))
        fits = swap is not type(operator) and self._here(
            node, f"{type(operator).__name__} -> {swap.__name__}"
        )
        return swap() if fits else operator

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        node.op = self._swapped(node, node.op)  # type: ignore[assignment]
        return self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.AST:
        node.op = self._swapped(node, node.op)  # type: ignore[assignment]
        return self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        node.ops[0] = self._swapped(node, node.ops[0])  # type: ignore[call-overload]
        return self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        if isinstance(node.value, bool):
            return (
                ast.copy_location(ast.Constant(not node.value), node)
                if self._here(node, f"not {node.value}")
                else node
            )
        if isinstance(node.value, int | float) and self._here(
            node, f"{node.value} -> {2 * node.value + 1}"
        ):
            return ast.copy_location(ast.Constant(2 * node.value + 1), node)
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        if node.value is not None:  # its annotation is no code
            node.value = self.visit(node.value)
        return node


def run_tests(module: str, number: int) -> None:
    """Ends this process with 0 if the module's tests pass with the fault of that number; -1: no
    fault.
    """
    import pytest

    tree = Mutator(number).visit(ast.parse(source_of(module)))
    code = compile(ast.fix_missing_locations(tree), f"lfpipe/{module}", "exec")
    name = f"lfpipe.{module}"
    sys.modules[name] = ModuleType(name)
    exec(code, sys.modules[name].__dict__)
    words = ["-q", "-x", "-n", "0", "-p", "no:cacheprovider"]
    words += ["-m", "not live and not alone and not soak"]
    words += ["--timeout", "60", *(f"tests/{path}" for path in MODULES[module])]
    sys.exit(pytest.main(words))


def source_of(module: str) -> str:
    return (ROOT / "lfpipe" / f"{module.replace('.', '/')}.py").read_text()


def passes(module: str, number: int) -> bool:
    """Whether the module's tests pass with a fault."""
    call = f"from profiling.tests_coverage import run_tests; run_tests({module!r}, {number})"
    with contextlib.suppress(subprocess.TimeoutExpired):
        done = subprocess.run(
            [sys.executable, "-c", call], cwd=ROOT, capture_output=True, timeout=LIMIT_S
        )
        return done.returncode == 0
    return False


def survivors(module: str, most: int) -> tuple[int, list[str]]:
    """Number of mutants tried, and those that survive."""
    counter = Mutator()
    counter.visit(ast.parse(source_of(module)))
    count = min(most or counter.count, counter.count)
    chosen = sorted(random.Random(1).sample(range(counter.count), count))
    with ThreadPoolExecutor(AT_ONCE) as pool:
        whole, *passed = pool.map(partial(passes, module), (-1, *chosen))
    if not whole:
        raise SystemExit(f"{module}: its tests fail without any fault")
    alive = [Mutator(number) for number, survives in zip(chosen, passed, strict=True) if survives]
    for mutator in alive:
        mutator.visit(ast.parse(source_of(module)))
    return count, [mutator.what for mutator in alive]


def mutation(modules: list[str], most: int) -> str:
    """The part of the report about mutants."""
    rows, left = [], []
    for module in modules:
        count, alive = survivors(module, most)
        rows.append(f"| {module} | {count} | {100 * (1 - len(alive) / max(count, 1)):.0f} |")
        left += [f"- {module}, {what}" for what in alive]
        print(rows[-1], *left[len(left) - len(alive) :], sep="\n", flush=True)
    return "\n".join(
        ["| module | mutants | killed, % |", "|---|--:|--:|", *rows, "\nSurvivors:\n", *left]
    )


def coverage() -> str:
    """The part of the report about lines and branches of each room that the default suite runs,
    child processes included.
    """
    settings, data, out = (
        ROOT / "profiling" / name for name in (".coveragerc", ".coverage", ".coverage.json")
    )
    settings.write_text(
        "[run]\nbranch = True\nparallel = True\nsource = lfpipe\npatch = subprocess, _exit\n"
    )
    env = os.environ | {"COVERAGE_RCFILE": str(settings), "COVERAGE_FILE": str(data)}
    call = [sys.executable, "-m", "coverage"]
    subprocess.run([*call, "run", "-m", "pytest", "-q"], cwd=ROOT, env=env, check=False)
    subprocess.run([*call, "combine", "-q"], cwd=ROOT, env=env, check=True)
    subprocess.run([*call, "json", "-q", "-o", str(out)], cwd=ROOT, env=env, check=True)
    rooms: dict[str, list[int]] = {}
    for name, file in json.loads(out.read_text())["files"].items():
        counts = rooms.setdefault(
            Path(name).parts[1] if len(Path(name).parts) > 2 else "root", [0] * 4
        )
        for at, key in enumerate(
            ("covered_lines", "num_statements", "covered_branches", "num_branches")
        ):
            counts[at] += file["summary"][key]
    for path in (settings, out, data):
        path.unlink(missing_ok=True)
    rooms["all"] = [sum(counts) for counts in zip(*rooms.values(), strict=True)]
    rows = [
        f"| {room} | {100 * a / max(b, 1):.1f} | {100 * c / max(d, 1):.1f} |"
        for room, (a, b, c, d) in rooms.items()
    ]
    return "\n".join(["| room | lines, % | branches, % |", "|---|--:|--:|", *rows])


def main() -> None:
    parser = parser_of(__doc__, mutants=40)
    parser.add_argument("--coverage", action="store_true")
    parser.add_argument("--mutation", action="store_true")
    parser.add_argument("--module", nargs="+", default=list(MODULES), choices=list(MODULES))
    args = parser.parse_args()
    old = REPORT.read_text() if REPORT.exists() else ""
    report = ["# What the tests protect\n"]
    for title, asked, write in (
        ("Coverage", args.coverage, coverage),
        ("Mutation", args.mutation, lambda: mutation(args.module, args.mutants)),
    ):
        if asked:
            call = (
                f"`python -m profiling.tests_coverage {' '.join(sys.argv[1:])}`,"
                f" {time.strftime('%d %B %Y')}"
            )
            report.append(f"## {title}\n\n{call}\n\n{write()}\n")
        elif kept := re.search(rf"(?ms)^## {title}\n.*?(?=^## |\Z)", old):
            report.append(kept[0])
    REPORT.write_text("\n".join(report))


if __name__ == "__main__":
    main()
