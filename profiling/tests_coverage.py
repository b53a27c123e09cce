"""What the default suite covers, by room, and what share of small faults (mutants) its tests notice; writes results/tests.md.

    python profiling/tests_coverage.py [--coverage] [--mutation] [--mutants N] [--module NAME ...]

A mutant changes one operator, comparison, constant or truth of a module. It is put in place by an import hook in a process of
its own, the module's tests run there, and it is killed if one of them fails. Without --mutants, every mutant is tried.
"""

import argparse
import ast
import json
import os
import random
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "profiling" / "results"
MODULES = {  # module -> the tests that are about it
    "transport.ring": ["tests/transport/test_ring.py", "tests/transport/test_packet_ring.py"],
    "transport.histogram": ["tests/transport/test_small_parts.py"],
    "render.viewpoint": ["tests/render/test_viewpoint.py", "tests/render/test_handedness.py"],
    "track.filters": ["tests/track/test_smoothing.py", "tests/track/test_kalman.py"],
    "render.anaglyph": ["tests/render/test_anaglyph.py"],
    "supervisor.requests": ["tests/supervisor/test_requests.py"],
    "supervisor.session_state": ["tests/supervisor/test_session_state.py", "tests/supervisor/test_requests.py"],
    "supervisor.governor": ["tests/supervisor/test_governor.py"],
    "scene.orientation": ["tests/scene/test_orientation.py"],
}
HOOK = """
import importlib.util, sys
name, path = sys.argv[1:3]
code = compile(open(path).read(), path, "exec")
class Finder:
    def find_spec(self, fullname, folder=None, target=None):
        return importlib.util.spec_from_loader(name, self) if fullname == name else None
    def create_module(self, spec): return None
    def exec_module(self, module): exec(code, module.__dict__)
sys.meta_path.insert(0, Finder())
import pytest
sys.exit(pytest.main(["-q", "-x", "-n", "0", "-p", "no:cacheprovider", "--timeout", "60", *sys.argv[3:]]))
"""
SWAPS: dict[type, type] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult, ast.Mod: ast.Add,
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip


class Mutator(ast.NodeTransformer):
    """Counts the places where a fault fits; makes the one numbered chosen. what: that place."""

    def __init__(self, chosen: int = -1) -> None:
        self.chosen, self.count, self.what = chosen, 0, ""

    def _here(self, node: ast.AST, what: str) -> bool:
        self.count += 1
        if self.count - 1 == self.chosen:
            self.what = f"line {getattr(node, 'lineno', 0)}: {what}"
        return self.count - 1 == self.chosen

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        swap = SWAPS.get(type(node.op))
        if swap and self._here(node, f"{type(node.op).__name__} -> {swap.__name__}"):
            node.op = swap()
        return self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.AST:
        swap = SWAPS[type(node.op)]
        if self._here(node, f"{type(node.op).__name__} -> {swap.__name__}"):
            node.op = swap()
        return self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        swap = SWAPS[type(node.ops[0])]
        if self._here(node, f"{type(node.ops[0]).__name__} -> {swap.__name__}"):
            node.ops[0] = swap()
        return self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        if isinstance(node.value, bool):
            return ast.copy_location(ast.Constant(not node.value), node) if self._here(node, f"not {node.value}") else node
        if isinstance(node.value, int | float) and self._here(node, f"{node.value} -> {node.value + 1}"):
            return ast.copy_location(ast.Constant(node.value + 1), node)
        return node

    def _no_annotation(self, node: ast.AnnAssign) -> ast.AST:
        if node.value is not None:
            node.value = self.visit(node.value)
        return node

    visit_AnnAssign = _no_annotation


def mutants(module: str, most: int) -> tuple[int, list[str]]:
    """Number of mutants tried, and those that survive."""
    path = ROOT / "lfpipe" / f"{module.replace('.', '/')}.py"
    counter = Mutator()
    counter.visit(ast.parse(path.read_text()))
    chosen = random.Random(1).sample(range(counter.count), min(most or counter.count, counter.count))
    left = []
    for number in sorted(chosen):
        mutator = Mutator(number)
        tree = ast.fix_missing_locations(mutator.visit(ast.parse(path.read_text())))
        changed = Path(os.environ.get("TMPDIR", "/tmp")) / f"mutant_{os.getpid()}.py"
        changed.write_text(ast.unparse(tree))
        command = [sys.executable, "-c", HOOK, f"lfpipe.{module}", str(changed), *MODULES[module]]
        try:
            survives = subprocess.run(command, cwd=ROOT, capture_output=True, timeout=300).returncode == 0
        except subprocess.TimeoutExpired:
            survives = False
        left += [mutator.what] if survives else []
        changed.unlink()
    return len(chosen), left


def coverage() -> list[str]:
    """Rows of a table: line and branch coverage of each room by the default suite, with its child processes."""
    settings = ROOT / "profiling" / ".coveragerc"
    settings.write_text("[run]\nbranch = True\nparallel = True\nsource = lfpipe\npatch = subprocess, _exit\n")
    env = os.environ | {"COVERAGE_RCFILE": str(settings), "COVERAGE_FILE": str(ROOT / "profiling" / ".coverage")}
    call = [sys.executable, "-m", "coverage"]
    subprocess.run([*call, "run", "-m", "pytest", "-q"], cwd=ROOT, env=env)
    subprocess.run([*call, "combine", "-q"], cwd=ROOT, env=env, check=True)
    out = ROOT / "profiling" / ".coverage.json"
    subprocess.run([*call, "json", "-q", "-o", str(out)], cwd=ROOT, env=env, check=True)
    rooms: dict[str, list[int]] = {}
    for name, file in json.loads(out.read_text())["files"].items():
        room, found = Path(name).parts[1] if len(Path(name).parts) > 2 else "root", file["summary"]
        row = rooms.setdefault(room, [0, 0, 0, 0])
        for at, key in enumerate(("covered_lines", "num_statements", "covered_branches", "num_branches")):
            row[at] += found[key]
    for left in (settings, out, ROOT / "profiling" / ".coverage"):
        left.unlink(missing_ok=True)
    return [f"| {room} | {100 * a / max(b, 1):.1f} | {100 * c / max(d, 1):.1f} |" for room, (a, b, c, d) in sorted(rooms.items())]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--coverage", action="store_true")
    parser.add_argument("--mutation", action="store_true")
    parser.add_argument("--mutants", type=int, default=0)
    parser.add_argument("--module", nargs="*", default=list(MODULES))
    wanted = parser.parse_args()
    call = f"python profiling/tests_coverage.py {' '.join(sys.argv[1:])}"
    lines = ["# What the tests protect\n", f"`{call}`, {time.strftime('%d %B %Y')}"]
    if wanted.coverage:
        lines += ["\n| room | lines, % | branches, % |", "|---|--:|--:|", *coverage()]
    if wanted.mutation:
        results = {module: mutants(module, wanted.mutants) for module in wanted.module}
        shares = {name: 100 * (1 - len(left) / max(count, 1)) for name, (count, left) in results.items()}
        lines += ["\n| module | mutants | killed, % |", "|---|--:|--:|"]
        lines += [f"| {name} | {count} | {shares[name]:.0f} |" for name, (count, _) in results.items()]
        lines += ["\nSurvivors:\n", *(f"- {name}, {each}" for name, (_, left) in results.items() for each in left)]
    (RESULTS / "tests.md").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
