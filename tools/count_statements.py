"""Counts statements, docstrings excluded, by package, and compares them with the table
[tool.lfpipe.sizes] of pyproject.toml:

    python -m tools.count_statements           # ends with 1 if a package is larger
    python -m tools.count_statements --write   # updates the table

A size may go up only with the reason in the message of the commit.
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
def statements(path: Path) -> int:
    """The number of statements in a file of Python."""
    nodes = ast.walk(ast.parse(path.read_text()))
    return sum(isinstance(node, ast.stmt) and not is_docstring(node) for node in nodes)


def by_package() -> Counter[str]:
    """The statements of the core, of every package of lfpipe, and of the other folders."""
    count: Counter[str] = Counter()
    for path in (path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")):
        folder, *rest = path.relative_to(ROOT).parts
        package = f"{folder}/{rest[0]}" if folder == "lfpipe" and len(rest) > 1 else folder
        size = statements(path)
        count[package] += size
        if folder == "lfpipe" and package not in BESIDE:
            count[CORE] += size
    return count


def limits() -> dict[str, int]:
    """The sizes of the table."""
    table: dict[str, int] = tomllib.loads(TABLE.read_text())["tool"]["lfpipe"]["sizes"]
    return table


def excesses() -> dict[str, str]:
    """By package, the sizes above those of the table."""
    allowed = limits()
    return {
        package: f"{size}, {allowed.get(package, 0)} in pyproject.toml"
        for package, size in by_package().items()
        if size > allowed.get(package, 0)
    }


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
    found = excesses()
    for package, text in sorted(found.items()):
        print(f"too large: {package}: {text}")
    return int(bool(found))


if __name__ == "__main__":
    raise SystemExit(main())
