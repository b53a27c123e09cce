"""`lfpipe bench` on the command line, and the scripts of profiling/ and tools/ in a fresh clone,
without sample data.
"""

import json
import subprocess
import sys
from pathlib import Path

from tests.support.extras import PRESENT
from tests.support.world import World

ROOT = Path(__file__).parents[2]
# shared by scripts; the last is a build hook
NO_SCRIPTS = ("arguments", "simulated_recordings", "svg", "package_page")
FILES = [*ROOT.glob("profiling/*.py"), *ROOT.glob("tools/*.py")]
SCRIPTS = sorted(
    path
    for path in FILES
    if path.stem not in NO_SCRIPTS and (PRESENT or "lfpipe.extras" not in path.read_text())
)


def test_benchmarks_from_the_command_line_share_a_folder(
    world: World, scene: Path, clip: Path
) -> None:
    first = world.done(
        "bench", "synthesis", "--quick", "--scene", scene, "--sequence", clip, "--out", "out"
    )
    path, found = first.stdout.splitlines()
    assert path == "out/report.html" and (world.root / path).is_file()
    assert found.startswith("View synthesis: ") and "by the paper's method, at" in found
    # credited to itself only
    world.done("bench", "stability", "--quick", "--scene", scene, "--out", "out")
    both = json.loads((world.root / "out" / "results.json").read_text())["benchmarks"]
    assert [one["about"]["command"].split()[2] for one in both.values()] == [
        "synthesis",
        "stability",
    ]


def run(script: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(script), *words], capture_output=True, text=True, check=False
    )
