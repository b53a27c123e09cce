"""Faults, each in one place of a copy of the package, and the tests that notice each.

    python -m tests.mutation_check             # all faults of tests/faults.toml: more than an hour
    python -m tests.mutation_check 2/6         # the second of six parts
    python -m tests.mutation_check governor    # those whose name or file holds the word

Prints a row of a table for each. Exit code 1 where nobody notices one, or where a test is named
that does not exist, here or in profiling/results/tests.md.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
COPIED = ("lfpipe", "tests", "profiling", "tools", "docs", "examples", "pyproject.toml")
PYTEST = (sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider", "--tb=no")
CHOSEN = ("-m", "not nightly and not alone and not camera_vm", "-rfE")
PROFILE = "--hypothesis-profile=unshrunk"
FAULTS = ROOT / "tests" / "faults.toml"
RESULTS = ROOT / "profiling" / "results" / "tests.md"


class Fault(NamedTuple):
    """old becomes new in a file of lfpipe, which at least one of these tests notices."""

    name: str
    file: str
    old: str
    new: str
    tests: str

    def text(self) -> str:
        """The file as it is. Raises AssertionError unless old stands in it once."""
        text = (ROOT / "lfpipe" / self.file).read_text()
        assert text.count(self.old) == 1, f"{self.file}: {self.old!r} stands there not once"
        return text


def faults() -> list[Fault]:
    return [Fault(**row) for row in tomllib.loads(FAULTS.read_text())["fault"]]


def missing_tests() -> list[str]:
    """Tests that are named and do not exist."""
    named = {f"tests/{one}" for fault in faults() for one in fault.tests.split()}
    cited = re.findall(r"\b(?:tests/)?((?:\w+/)*test_\w+\.py(?:::\w+)?)", RESULTS.read_text())
    named |= {f"tests/{one}" for one in cited}
    return [one for one in sorted(named) if not is_there(one)]


def is_there(test: str) -> bool:
    path, _, name = test.partition("::")
    file = ROOT / path
    return file.exists() and f"def {name}" in file.read_text()


def noticed_by(fault: Fault, copy: Path) -> list[str]:
    """The tests that fail with it in a copy of the package, which is then as before."""
    whole = fault.text()
    path = copy / "lfpipe" / fault.file
    path.write_text(whole.replace(fault.old, fault.new))
    run = subprocess.run(
        [*PYTEST, *CHOSEN, PROFILE, *(f"tests/{one}" for one in fault.tests.split())],
        cwd=copy,
        env={**os.environ, "PYTHONPATH": str(copy)},  # before the package that is installed
        capture_output=True,
        text=True,
        check=False,
    )
    path.write_text(whole)
    return list(
        dict.fromkeys(re.findall(r"^(?:FAILED|ERROR) (\S+?\.py(?:::\w+)?)", run.stdout, re.M))
    )


def main(words: list[str]) -> int:
    chosen = faults()
    if part := re.fullmatch(r"(\d+)/(\d+)", words[0] if words else ""):
        chosen = chosen[int(part[1]) - 1 :: int(part[2])]
    elif words:
        chosen = [one for one in chosen if any(word in f"{one.name} {one.file}" for word in words)]
    failed = missing_tests()
    for one in failed:
        print(f"no such test: {one}")
    with tempfile.TemporaryDirectory() as folder:
        for name in COPIED:
            (shutil.copytree if (ROOT / name).is_dir() else shutil.copy)(
                ROOT / name, Path(folder) / name
            )
        for fault in chosen:
            who = [one.removeprefix("tests/") for one in noticed_by(fault, Path(folder))]
            print(f"| {fault.name} | {fault.file} | {', '.join(who) or '**nobody**'} |", flush=True)
            failed += [] if who else [fault.name]
    return int(bool(failed))


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
