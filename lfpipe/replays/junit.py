"""The outcome of a replay as JUnit XML, for CI systems: one test case per part of the comparison."""

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

from lfpipe.errors import plain
from lfpipe.files.output import check_output, write_output
from lfpipe.replays.compare import PARTS, Difference

TEXT_CHARS = 20_000  # of one test case


def cases_of(compared: bool, differences: Sequence[Difference]) -> list[tuple[str, list[str]]]:
    """(test case, its failures) of a finished replay; none without a comparison."""
    return [(part, [str(each) for each in differences if each.part == part]) for part in PARTS] if compared else []


def write_junit(path: Path, name: str, cases: Sequence[tuple[str, list[str]]], error: str, seconds: float) -> None:
    """name: of the sequence. error: why there is no outcome; "" if cases holds the outcome.

    Raises UserError if path must not be written; it is then unchanged.
    """
    name = plain(name, 200)
    failed = sum(bool(said) for _, said in cases)
    counts = {"tests": str(1 + len(cases)), "failures": str(failed), "errors": str(int(bool(error)))}
    suite = ElementTree.Element("testsuite", {"name": f"lfpipe replay {name}", **counts, "time": f"{seconds:.3f}"})
    for case, said, kind in [("replay", [error] if error else [], "error"), *((*case, "failure") for case in cases)]:
        entry = ElementTree.SubElement(suite, "testcase", {"classname": f"lfpipe.replay.{name}", "name": case})
        if said:
            ElementTree.SubElement(entry, kind, {"message": plain(said[0], 1000)}).text = plain("\n".join(said), TEXT_CHARS)
    text = ElementTree.tostring(suite, "utf-8", xml_declaration=True)
    check_output(path, label="--junit")
    write_output(path, text, label="--junit")
