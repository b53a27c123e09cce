"""`lfpipe bench` on the command line."""

import json
import subprocess
import sys
from pathlib import Path

from tests.world import World


def test_a_subject_from_the_command_line_and_again(world: World, scene: Path, clip: Path) -> None:
    words = ("bench", "anaglyph", "--quick", "--scene", scene, "--sequence", clip, "--out", "out")
    first = world.run(*words)
    assert first.returncode == 0, first.stderr
    assert first.stdout.strip() == "out/report.html" and (world.root / "out" / "report.html").is_file()
    results = json.loads((world.root / "out" / "results.json").read_text())
    assert set(results["subjects"]) == {"anaglyph"} and results["subjects"]["anaglyph"]["about"]["command"].startswith(
        "lfpipe bench anaglyph"
    )
    second = world.run(*words)  # complete: nothing is measured again
    assert second.returncode == 0, second.stderr
    again = json.loads((world.root / "out" / "results.json").read_text())
    assert again["subjects"] == results["subjects"]
    third = world.run("bench", "judder", "--quick", "--out", "out")  # credited to itself only
    assert third.returncode == 0, third.stderr
    both = json.loads((world.root / "out" / "results.json").read_text())["subjects"]
    assert [one["about"]["command"].split()[2] for one in both.values()] == ["judder", "anaglyph"]


def test_mistakes_are_named(world: World, clip: Path) -> None:
    for words, text in (
        (("bench", "trackers"), "trackers"),
        (("bench", "stability", "--quick", "--scene", "nowhere", "--sequence", clip), "nowhere"),
        (("bench", "stability", "--quick", "--sequence", "nowhere.avi"), "nowhere.avi"),
    ):
        done = world.run(*words)
        assert done.returncode == 2 and text in done.stderr and "Traceback" not in done.stderr, (words, done.stderr)


def test_bench_alone_prints_its_help_and_measures_nothing(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-m", "lfpipe", "bench"], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert "Usage" in done.stdout + done.stderr and "Measure every subject" in done.stdout + done.stderr
    assert list(tmp_path.iterdir()) == []
