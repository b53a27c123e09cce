"""The outcome of a replay as JUnit XML, which every CI system shows: a test case per part of the comparison, one for budgets."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from lfpipe.errors import UserError
from lfpipe.replay.compare import PARTS, Difference


def write_junit(
    path: Path, name: str, compared: bool, differences: list[Difference], budgets: list[str] | None, seconds: float
) -> None:
    """name: of the sequence. budgets: the broken ones, None where none were asked for.

    Raises UserError where path cannot be written.
    """
    cases: list[tuple[str, list[str]]] = [("replay", [])]
    if compared:
        cases += [(part, [str(each) for each in differences if each.part == part]) for part in PARTS]
    if budgets is not None:
        cases.append(("budgets", budgets))
    failed = sum(bool(said) for _, said in cases)
    about = {"name": f"lfpipe replay {name}", "tests": str(len(cases)), "failures": str(failed), "time": f"{seconds:.3f}"}
    suite = ElementTree.Element("testsuite", about)
    for case, said in cases:
        entry = ElementTree.SubElement(suite, "testcase", {"classname": f"lfpipe.replay.{name}", "name": case})
        if said:
            ElementTree.SubElement(entry, "failure", {"message": said[0]}).text = "\n".join(said)
    try:
        ElementTree.ElementTree(suite).write(path, "utf-8", xml_declaration=True)
    except OSError as error:
        raise UserError(f"--junit {path}: {error.strerror}", "a file in a directory that you may write to") from None
