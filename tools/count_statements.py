"""Counts the statements of the program and its tests, without docstrings, by package, with their
goals: `python -m tools.count_statements`. Ends with 1 if a goal is exceeded.
"""

import argparse
import ast
import subprocess
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
GOALS = {
    "lfpipe": 19_000,
    "tests": 14_500,
    "lfpipe/scene": 3_500,
    "lfpipe/render": 3_200,
    "lfpipe/bench": 1_500,
    "lfpipe/capture": 1_400,
    "lfpipe/supervisor": 1_250,
    "lfpipe/monitor": 1_050,
    "lfpipe/files": 600,
}


def is_docstring(node: ast.AST) -> bool:
    """Whether a node is a text alone."""
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


def statements(path: Path) -> int:
    """The number of statements in a file of Python."""
    nodes = ast.walk(ast.parse(path.read_text()))
    return sum(isinstance(node, ast.stmt) and not is_docstring(node) for node in nodes)


def by_package() -> Counter[str]:
    """The statements of every folder at the top, and of every package of lfpipe."""
    listed = subprocess.run(
        ["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    count: Counter[str] = Counter()
    for name in listed.stdout.splitlines():
        if not (ROOT / name).exists():  # removed, not committed yet
            continue
        size = statements(ROOT / name)
        folder, *rest = name.split("/")
        count[folder] += size
        if folder == "lfpipe" and len(rest) > 1:
            count[f"lfpipe/{rest[0]}"] += size
    return count


def main() -> int:
    """Prints the table."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    over = 0
    for package, size in sorted(by_package().items()):
        goal = GOALS.get(package)
        over += goal is not None and size > goal
        print(f"{package:20} {size:7,}" + (f"  goal {goal:6,}" if goal is not None else ""))
    return int(over > 0)


if __name__ == "__main__":
    raise SystemExit(main())
