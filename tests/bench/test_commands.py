"""`lfpipe bench` on the command line, and the scripts of profiling/ and tools/ in a fresh clone,
without sample data.
"""

import json
from pathlib import Path

from tests.support.world import World


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
