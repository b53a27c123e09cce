"""Counts statements, docstrings excluded, by package, and compares them with the table
[tool.lfpipe.sizes] of pyproject.toml:

    python -m tools.count_statements           # ends with 1 if a package is larger
    python -m tools.count_statements --write   # updates the table

"tests / lfpipe" is the ratio of both, imports in neither. A size may go up only with the reason in
the message of the commit, the ratio never.
"""

import argparse
import ast
import re
import tomllib
from collections import Counter
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
TABLE = ROOT / "pyproject.toml"
FOLDERS = ("lfpipe", "tests", "profiling", "tools", "examples")
CORE, BESIDE = "core", ("lfpipe/bench", "lfpipe/extras")  # core: lfpipe without these


def is_docstring(node: ast.AST) -> bool:
    """Whether a node is a text alone."""
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


@cache
def statements(path: Path) -> tuple[int, int]:
    """The number of statements in a file of Python, and that of its imports."""
    nodes = [node for node in ast.walk(ast.parse(path.read_text())) if not is_docstring(node)]
    imports = sum(isinstance(node, ast.Import | ast.ImportFrom) for node in nodes)
    return sum(isinstance(node, ast.stmt) for node in nodes), imports


def by_package() -> dict[str, float]:
    """The statements of the core, of every package of lfpipe, and of the other folders; and those
    of the tests by those of lfpipe, imports in neither.
    """
    count: Counter[str] = Counter()
    bare: Counter[str] = Counter()
    for path in (path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")):
        folder, *rest = path.relative_to(ROOT).parts
        package = f"{folder}/{rest[0]}" if folder == "lfpipe" and len(rest) > 1 else folder
        size, imports = statements(path)
        bare[folder] += size - imports
        count[package] += size
        if folder == "lfpipe" and package not in BESIDE:
            count[CORE] += size
    return {**count, "tests / lfpipe": round(bare["tests"] / bare["lfpipe"] + 0.005, 2)}


def write() -> None:
    """Writes the sizes into the table."""
    lines = [f'"{package}" = {size}\n' for package, size in sorted(by_package().items())]
    head = "[tool.lfpipe.sizes]\n"
    text = re.sub(
        rf"({re.escape(head)}(?:#.*\n)*)(?:\".*\n)*",
        lambda match: match[1] + "".join(lines),
        TABLE.read_text(),
    )
    TABLE.write_text(text)


def main() -> int:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--write", action="store_true", help="write the sizes into pyproject.toml")
    if parser.parse_args().write:
        write()
    for package, size in sorted(by_package().items()):
        print(f"{package:18} {size:6,}")
    allowed: dict[str, float] = tomllib.loads(TABLE.read_text())["tool"]["lfpipe"]["sizes"]
    found = {one: size for one, size in by_package().items() if size > allowed.get(one, 0)}
    for package, size in sorted(found.items()):
        print(f"too large: {package}: {size}, {allowed.get(package, 0)} in pyproject.toml")
    return int(bool(found))


if __name__ == "__main__":
    raise SystemExit(main())
