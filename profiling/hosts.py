"""What runs under which Python: every module imported, the tests of the transport and of commands
interrupted inside native code, the demo, and one recording replayed.

    python -m profiling.hosts            # each Python found here; writes profiling/results/hosts.md
    python -m profiling.hosts --short    # a minute; prints the table only

Each Python has its environment in .venv-X.Y of the checkout, made by uv from the project's file. A
Python that is not installed is a line of the table and no failure. The replay compares the digests
of eyes, views and pictures with those of the first Python. Exit code 1 where something failed.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "profiling" / "results" / "hosts.md"
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
IMPORTS = """
import importlib, pkgutil, lfpipe
found = pkgutil.walk_packages(lfpipe.__path__, "lfpipe.")
names = [module.name for module in found if not module.name.endswith("__main__")]
for name in names:
    importlib.import_module(name)
print(len(names))
"""
MAKE_SEQUENCE = """
import sys
from pathlib import Path
from tests.replay.conftest import make_sequence
make_sequence(Path(sys.argv[1]), int(sys.argv[2]))
"""
INTERRUPTED = "tests/cli/test_signals.py::test_command_is_interrupted_inside_native_code"
COLUMNS = ("Python", "modules imported", "transport and interrupts", "demo", "replay", "seconds")
ELSEWHERE = """
| machine | state |
|---|---|
| Linux on ARM | rows of the workflow; the ring's fences hold on a model of its memory |
| macOS | a row of the workflow that may fail; `LFPIPE_HOST=portable` runs its code on Linux |
"""


def find_python(version: str) -> str | None:
    """Path of an interpreter: one that uv knows, or of pyenv. None is downloaded."""
    if sys.version_info[:2] == tuple(map(int, version.split("."))):
        return sys.executable
    command = ["uv", "python", "find", "--no-project", "--no-python-downloads", version]
    done = subprocess.run(command, capture_output=True, text=True, cwd="/")
    if done.returncode == 0:
        return done.stdout.strip()
    kept = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    return next(
        (str(path) for path in sorted(kept.glob(f"{version}.*/bin/python"), reverse=True)), None
    )


class Interpreter:
    """One Python with its environment, and a work folder."""

    def __init__(self, path: str, folder: Path) -> None:
        self.folder = folder
        self.failed = False
        folder.mkdir(mode=0o700)
        self.own = Path(sys.prefix) == ROOT / ".venv" and path == sys.executable
        place = ROOT / (".venv" if self.own else f".venv-{folder.name}")
        self._env = {
            key: value
            for key, value in os.environ.items()
            if key not in ("VIRTUAL_ENV", "DISPLAY", "WAYLAND_DISPLAY")
        }
        self._env |= {
            "UV_PROJECT_ENVIRONMENT": str(place),
            "UV_PYTHON": path,
            "PYTHONPATH": str(ROOT),
        }
        self._env |= {"LFPIPE_RUN_DIR": str(folder)}
        if not self.own:
            subprocess.run(
                ["uv", "sync", "--quiet", "--group", "dev", "--python", path],
                cwd=ROOT,
                env=self._env,
                check=True,
            )
        self._python = place / "bin/python"

    def run(self, *args: str | Path) -> str:
        """What its Python prints with args, in its work folder; "FAILED", printed and kept, if it
        fails.
        """
        command = [str(self._python), *map(str, args)]
        done = subprocess.run(
            command, cwd=self.folder, env=self._env, capture_output=True, text=True
        )
        if done.returncode:
            self.failed = True
            output = f"{done.stdout[-2000:]}{done.stderr[-2000:]}"
            print(
                f"{' '.join(command)[:200]}: exit code {done.returncode}\n{output}", file=sys.stderr
            )
        return "FAILED" if done.returncode else done.stdout.strip()


def transport(one: Interpreter, short: bool) -> str:
    """The tests' own last line; a short run leaves out what the suite has just run under this
    Python.
    """
    if short and one.own:
        return "in the suite"
    options = ("-o", "addopts=", "-q", "-W", "ignore", "-p", "no:cacheprovider")
    tests = ROOT / "tests" / "transport", f"{ROOT}/{INTERRUPTED}"
    output = one.run("-m", "pytest", "--rootdir", ROOT, *tests, *options)
    return output.splitlines()[-1].strip("= ").partition(" in ")[0]


def demo(one: Interpreter, seconds: int) -> str:
    """Pictures per second and drops, from the trace."""
    trace = one.folder / "trace.jsonl"
    options = (
        "--display",
        "none",
        "--duration",
        str(seconds),
        "--trace",
        trace,
        "--session",
        "hosts",
    )
    if one.run("-m", "lfpipe", "up", "--demo", *options) == "FAILED":
        return "FAILED"
    rows = [row for row in map(json.loads, trace.read_text().splitlines()) if row["composed"]]
    span_s = (rows[-1]["t_presented_ns"] - rows[0]["t_presented_ns"]) / 1e9
    faces = sum(bool(row.get("face")) for row in rows) / len(rows)
    return f"{len(rows)} pictures, {(len(rows) - 1) / span_s:.1f} Hz, eyes in {faces:.0%}"


def replay(one: Interpreter, sequence: Path) -> str:
    """Digests of a replay in steps with the demo's scene."""
    out = one.folder / "out"
    if one.run("-m", "lfpipe", "replay", sequence, "--out", out) == "FAILED":
        return "FAILED"
    return " ".join(
        value[:8] for value in json.loads((out / "report.json").read_text())["digests"].values()
    )


def table(short: bool) -> tuple[list[tuple[str, ...]], bool]:
    """A row per Python, and whether anything failed."""
    rows = []
    failed = False
    first = ""
    with tempfile.TemporaryDirectory(prefix="lfh") as work:
        sequence = Path(work, "walk")
        for version in PYTHONS:
            path = find_python(version)
            if path is None:
                rows.append((version, *["not installed here"] * 4, ""))
                continue
            began = time.monotonic()
            one = Interpreter(path, Path(work, version))
            if not sequence.exists():
                one.run("-c", MAKE_SEQUENCE, sequence, "30" if short else "150")
            cells = [
                one.run("-c", "import platform; print(platform.python_version())"),
                one.run("-c", IMPORTS),
            ]
            cells += [transport(one, short), demo(one, 3 if short else 10)]
            digests = replay(one, sequence)
            first = first or digests
            failed |= one.failed or digests != first
            equal = f"{'equal' if digests == first else 'DIFFERENT'}: {digests}"
            rows.append((*cells, equal, f"{time.monotonic() - began:.0f}"))
            print(" | ".join(rows[-1]), file=sys.stderr)
    return rows, failed


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--short", action="store_true", help="3 s of the demo, 1 s of replay; writes no file"
    )
    short = parser.parse_args().short
    rows, failed = table(short)
    lines = [
        "| " + " | ".join(COLUMNS) + " |",
        "|---" * len(COLUMNS) + "|",
        *("| " + " | ".join(row) + " |" for row in rows),
    ]
    text = "\n".join(lines)
    print(text)
    if not short:
        machine = (
            f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, load average"
            f" {psutil.getloadavg()[1]:.0f}"
        )
        about = (
            "Digests are of all frames' eyes, views and pictures, replayed in steps with the demo's"
            " scene."
        )
        head = f"# Hosts and Pythons\n\n`python -m profiling.hosts` on {machine}. {about}"
        RESULTS.write_text(f"{head}\n\n{text}\n{ELSEWHERE}")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
