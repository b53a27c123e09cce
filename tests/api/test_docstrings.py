"""The docstrings of `import lfpipe` and `lfpipe.rings`, from which the reference is drawn: they
name every parameter, and their examples work.
"""

import doctest
import enum
import inspect
import re
import sys

import attrs
import pytest

import lfpipe
from lfpipe import rings

FUNCTIONS = {
    name: value
    for module in (lfpipe, rings)
    for name in module.__all__
    if callable(value := getattr(module, name)) and not inspect.isbuiltin(value)
} | {
    f"Reader.{name}": value
    for name, value in vars(rings.Reader).items()
    if inspect.isfunction(value) and not name.startswith("_")
}

pytestmark = pytest.mark.nightly


@pytest.mark.parametrize("name", FUNCTIONS)
def test_public_docstrings_name_every_parameter(name: str) -> None:
    what = FUNCTIONS[name]
    text = inspect.getdoc(what) or ""
    assert text
    if isinstance(what, type) and (
        attrs.has(what) or issubclass(what, tuple | Exception | enum.Enum)
    ):
        return  # a record, whose fields have their own docstrings, or an exception
    section = re.search(r"^Parameters\n-+\n(.*?)(?=^\w+\n-+\n|\Z)", text, re.M | re.S)
    heads = re.findall(r"^([\w, ]+) : ", section[1] if section else "", re.M)
    documented = [name for head in heads for name in head.split(", ")]
    expected = [name for name in inspect.signature(what).parameters if name != "self"]
    assert documented == expected


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.live] * (name == "Session")) for name in FUNCTIONS],
)
def test_examples_of_public_docstrings_work(name: str) -> None:
    what = FUNCTIONS[name]
    module = sys.modules[what.__module__]
    for found in doctest.DocTestFinder(recurse=False).find(what, name, module):
        runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
        runner.run(found)
        assert not runner.failures, found.docstring
