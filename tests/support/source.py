"""The code of the package as trees, for rules about its form."""

import ast
import functools
import gc
from collections.abc import Iterator
from pathlib import Path
from typing import TypeVar

import lfpipe

PACKAGE = Path(lfpipe.__file__).parent
Node = TypeVar("Node", bound=ast.AST)


@functools.cache
def modules() -> dict[str, ast.Module]:
    """The tree of each module, by its place in the package."""
    paths = sorted(PACKAGE.rglob("*.py"))
    return {path.relative_to(PACKAGE).as_posix(): ast.parse(path.read_text()) for path in paths}


@functools.cache
def _all_nodes() -> list[tuple[str, ast.AST]]:
    gc.disable()  # the collector would look at all of them again and again
    found = [(name, node) for name, tree in modules().items() for node in ast.walk(tree)]
    gc.freeze()  # and in every later test
    gc.enable()
    return found


def nodes(kind: type[Node]) -> Iterator[tuple[str, Node]]:
    """Every node of that kind, with its module."""
    return ((name, node) for name, node in _all_nodes() if isinstance(node, kind))


@functools.cache
def package_of(module: str) -> str:
    """The package of a module, or its own name if it is a top-level module."""
    return Path(module).with_suffix("").parts[0]
