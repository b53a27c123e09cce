"""JUnit XML, as CI services read it: outcomes of replays and of sweeps."""

from collections import Counter
from collections.abc import Sequence
from typing import Literal
from xml.etree import ElementTree

import attrs

from lfpipe.errors import plain

MESSAGE_CHARS, TEXT_CHARS = 1000, 20_000  # of one test case
Kind = Literal["", "failure", "error", "skipped"]


@attrs.frozen(kw_only=True)
class TestCase:
    """A case of a JUnit report."""

    classname: str
    name: str
    kind: Kind = ""
    """Of what went wrong, "" if nothing did."""
    message: str = ""
    """Short description of that."""
    text: str = ""
    """Long description of that."""
    seconds: float | None = None
    """None if not measured."""


def junit(name: str, cases: Sequence[TestCase], seconds: float | None = None) -> bytes:
    """A suite of test cases. seconds: of all of them."""
    kinds = Counter(case.kind for case in cases)
    counts = {
        "tests": len(cases),
        "failures": kinds["failure"],
        "errors": kinds["error"],
        "skipped": kinds["skipped"],
    }
    about = {"name": name, **{key: str(count) for key, count in counts.items()}}
    suite = ElementTree.Element("testsuite", about | _time(seconds))
    for case in cases:
        about = {"classname": case.classname, "name": plain(case.name, 500)}
        entry = ElementTree.SubElement(suite, "testcase", about | _time(case.seconds))
        if case.kind:
            message = {"message": plain(case.message, MESSAGE_CHARS)}
            what = ElementTree.SubElement(entry, case.kind, message)
            what.text = plain(case.text, TEXT_CHARS)
    return bytes(ElementTree.tostring(suite, "utf-8", xml_declaration=True))


def _time(seconds: float | None) -> dict[str, str]:
    return {} if seconds is None else {"time": f"{seconds:.3f}"}
