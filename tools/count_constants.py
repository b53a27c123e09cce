"""Counts the numeric constants of the program, by package: `python -m tools.count_constants`.

A constant is a name at the head of a module whose value contains a number. Each is a decision that
a measurement must justify (`profiling/ablation.py`).
"""

import argparse
import ast
from collections import Counter
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "lfpipe"


def _is_number(node: ast.AST) -> bool:
    return (
        isinstance(node, ast.Constant)
        and isinstance(node.value, int | float)
        and not isinstance(node.value, bool)
    )


def constants(source: str) -> list[str]:
    """The names of the numeric constants of a module."""
    found = []
    for node in ast.parse(source).body:
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        value = node.value
        for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
            pairs = [(target, value)]
            if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
                pairs = list(zip(target.elts, value.elts, strict=True))
            found += [
                one.id
                for one, expression in pairs
                if isinstance(one, ast.Name) and any(map(_is_number, ast.walk(expression)))
            ]
    return found


def by_package() -> Counter[str]:
    """The number of constants of each package of lfpipe."""
    count: Counter[str] = Counter()
    for path in PACKAGE.rglob("*.py"):
        first, *rest = path.relative_to(PACKAGE).parts
        count[first if rest else "lfpipe"] += len(constants(path.read_text()))
    return count


def main() -> None:
    """Prints the table."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    count = by_package()
    for package, number in count.most_common():
        print(f"{package:12} {number:4}")
    print(f"{'together':12} {count.total():4}")


if __name__ == "__main__":
    main()
