"""What an installation takes: size, versions and `pip check`, for each Python and way to install.

    python -m profiling.install    # each Python found here; writes profiling/results/install.md

Needs a package index, and some minutes. A way that cannot be installed is a row of the table, and
exit code 1.
"""

import os
import platform
import subprocess
import sys
import tempfile
from datetime import date
from pathlib import Path

from profiling.hosts import PYTHONS, find_python

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "profiling" / "results" / "install.md"
WAYS = {
    "pip": [["-m", "pip", "install", "-q", str(ROOT)]],
    "pip, beside numpy 2 and opencv-python": [
        ["-m", "pip", "install", "-q", "numpy>=2", "opencv-python"],
        ["-m", "pip", "install", "-q", str(ROOT)],
    ],
    "uv sync, in a clone": [],
}
VERSIONS = """
import cv2, importlib.metadata as m
names = ("numpy", "mediapipe", "opencv-python", "opencv-contrib-python")
names += ("opencv-contrib-python-headless",)
found = {one.metadata["Name"].lower(): one.version for one in m.distributions()}
print(", ".join(f"{name} {found[name]}" for name in names if name in found))
"""
DEMO = ["-m", "lfpipe", "up", "--demo", "--duration", "1", "--display", "none"]
COLUMNS = ("Python", "way", "MB on disk", "packages", "`pip check`", "the demo")


def size_mb(folder: Path) -> int:
    """What `du -sm` prints."""
    done = subprocess.run(["du", "-sm", folder], capture_output=True, text=True, check=True)
    return int(done.stdout.split()[0])


def measured(way: str, path: str, folder: Path) -> tuple[str, ...]:
    """Size, versions, conflicts and whether the demo runs."""
    place = folder / "venv"
    env = {key: value for key, value in os.environ.items() if key not in ("VIRTUAL_ENV", "DISPLAY")}
    env |= {"UV_PROJECT_ENVIRONMENT": str(place), "LFPIPE_RUN_DIR": str(folder)}
    python = place / "bin/python"

    def run(*words: str | Path) -> subprocess.CompletedProcess[str]:
        return subprocess.run(words, cwd=folder, env=env, capture_output=True, text=True)

    if WAYS[way]:
        done = run(path, "-m", "venv", place)
        before_mb = size_mb(place)
        for step in WAYS[way]:
            done = run(python, *step) if not done.returncode else done
    else:
        before_mb = 0
        done = run("uv", "sync", "-q", "--project", ROOT, "--python", path)
    if done.returncode:
        print(done.stderr[-2000:], file=sys.stderr)
        return "failed", "", "", ""
    check = run("uv", "pip", "check", "--python", python)
    problems = [line for line in check.stderr.splitlines() if "requires" in line]
    if problems and not WAYS[way]:
        problems = [f"{len(problems)} requirements overridden in pyproject.toml"]
    return (
        str(size_mb(place) - before_mb),
        run(python, "-c", VERSIONS).stdout.strip(),
        "; ".join(problems) or "no conflicts",
        "failed" if run(python, *DEMO).returncode else "runs",
    )


def main() -> int:
    rows = []
    for version in PYTHONS:
        path = find_python(version)
        for way in WAYS if path else ():
            with tempfile.TemporaryDirectory(prefix="lfi") as folder:
                assert path is not None
                rows.append((version, way, *measured(way, path, Path(folder))))
            print(" | ".join(rows[-1]), file=sys.stderr)
    lines = [" | ".join(row) for row in (COLUMNS, ["---"] * len(COLUMNS), *rows)]
    table = "\n".join(f"| {line} |" for line in lines)
    about = f"`python -m profiling.install` on {platform.system()} {platform.machine()}"
    RESULTS.write_text(f"# Installations\n\n{about}, {date.today()}.\n\n{table}\n")
    return int(any("failed" in row for row in rows))


if __name__ == "__main__":
    sys.exit(main())
