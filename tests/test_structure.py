"""What no linter checks: how paths are examined, and that faults of the mutation check exist."""

import ast

from tests.mutation_check import FAULTS
from tests.support.source import nodes, package_of


def test_paths_are_examined_without_exceptions() -> None:
    """`Path.exists` and its like raise up to Python 3.13, for a folder that may not be searched:
    `host.files` does not.
    """
    wrong = [
        f"{module}: {ast.unparse(call)}"
        for module, call in nodes(ast.Call)
        if package_of(module) not in ("scene", "files")
        and not call.args
        and isinstance(call.func, ast.Attribute)
        and call.func.attr in ("exists", "is_file", "is_dir")
    ]
    assert not wrong, wrong


def test_every_fault_of_the_mutation_check_fits_the_program() -> None:
    for fault in FAULTS:
        fault.text()
