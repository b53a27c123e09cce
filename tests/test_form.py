"""The form of the code: lines are short, large classes take keywords, conditionals are not nested,
and the counter of statements counts.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from tests.mutation_check import FAULTS
from tests.support import extras
from tests.support.source import nodes, package_of
from tools.count_statements import by_package, excesses, limits, statements

LARGE = 5  # fields
# Classes with positional fields from before the rule. Remove a name here with its last
# positional call; add none.
POSITIONAL = {
    "bench": "Results Row Table Value",
    "capture": "Frame Mode SourceInfo",
    "config": "Key",
    "extras": "Outcome Sample",
    "render": "Item Pointer",
    "track": "Face",
    "transport": "Stamp",
}


# Calls of `time.sleep` in tests: fakes that keep time, what takes its time under test, and polls of
# the guest's devices. Other tests wait for an event: `until` and `stays` of tests/support/world.py.
SLEEPS = {
    "camera_vm/driver.py": 1,
    "camera_vm/machine.py": 1,
    "camera_vm/test_usb.py": 1,
    "camera_vm/usb_camera.py": 2,
    "capture/fake_camera.py": 1,
    "capture/test_untrusted.py": 1,
    "display/screen_camera.py": 2,
    "display/test_file_display.py": 2,
    "faults/scripted_camera.py": 4,
    "faults/soak.py": 8,
    "faults/test_resume.py": 1,
    "scene/test_pack.py": 1,
    "support/world.py": 2,
    "transport/test_segment.py": 1,
}


def test_no_line_has_more_than_100_columns() -> None:
    """ruff passes a line that ends with a comment for tools, or that has no space to break at."""
    root = Path(__file__).parents[1]
    long = [
        f"{path.relative_to(root)}:{number}"
        for folder in ("lfpipe", "tests", "tools", "profiling", "examples")
        for path in sorted((root / folder).rglob("*.py"))
        for number, line in enumerate(path.read_text().splitlines(), 1)
        if len(line) > 100
    ]
    assert not long


def test_only_listed_tests_sleep() -> None:
    found = {}
    tests = Path(__file__).parent
    for path in sorted(tests.rglob("*.py")):
        text = path.read_text()
        nodes_here = ast.walk(ast.parse(text)) if "sleep" in text else ()
        called = [node.func for node in nodes_here if isinstance(node, ast.Call)]
        if count := sum(ast.unparse(function) == "time.sleep" for function in called):
            found[str(path.relative_to(tests))] = count
    assert found == SLEEPS, "wait for an event; remove from SLEEPS what sleeps no longer"


def test_no_nested_conditional_expressions() -> None:
    nested = [
        f"{module}:{node.lineno}"
        for module, node in nodes(ast.IfExp)
        if any(isinstance(part, ast.IfExp) for part in (node.body, node.test, node.orelse))
    ]
    assert not nested, "write an if statement"


def large_classes() -> Iterator[tuple[str, str, bool]]:
    """(package, class, whether it takes keywords only) of every attrs class of many fields."""
    for module, node in nodes(ast.ClassDef):
        made = [ast.unparse(one) for one in node.decorator_list]
        fields = sum(isinstance(line, ast.AnnAssign) for line in node.body)
        if fields >= LARGE and any(one.startswith("attrs.") for one in made):
            yield package_of(module), node.name, any("kw_only=True" in one for one in made)


def test_large_classes_are_keyword_only() -> None:
    wrong = {
        f"{package}: {name}"
        for package, name, by_keyword in large_classes()
        if not by_keyword and name not in POSITIONAL.get(package, "").split()
    }
    assert not wrong, "add kw_only=True"


def test_attributes_are_documented_below_their_fields() -> None:
    """Not in the docstring of their class, where no tool finds them."""
    found = []
    for module, node in nodes(ast.ClassDef):
        fields = [one.target for one in node.body if isinstance(one, ast.AnnAssign)]
        named = re.findall(r"(\w+): ", ast.get_docstring(node) or "")
        if any(isinstance(field, ast.Name) and field.id in named for field in fields):
            found.append(f"{module}:{node.name}")
    assert not found


def test_positional_allowlist_is_minimal() -> None:
    excused = {
        (place, name)
        for place, names in POSITIONAL.items()
        for name in names.split()
        if place != "extras" or extras.PRESENT
    }
    needed = {(place, name) for place, name, by_keyword in large_classes() if not by_keyword}
    assert excused <= needed, "remove it from POSITIONAL"


def test_statements_are_counted_without_docstrings(tmp_path: Path) -> None:
    path = tmp_path / "a.py"
    path.write_text(
        '"""Doc."""\n\n\ndef f():\n    """Doc."""\n    x = 1; y = 2\n    return x + y\n'
    )
    assert statements(path) == 4


def test_no_package_is_larger_than_the_table_says() -> None:
    assert not excesses(), "delete as much elsewhere, or run `tools.count_statements --write`"
    assert not extras.PRESENT or limits().keys() == by_package().keys()


def test_every_fault_of_the_mutation_check_fits_the_program() -> None:
    for fault in FAULTS:
        fault.text()
