"""`lfpipe bench` on the command line."""

import json
from pathlib import Path

from tests.world import World


def test_subjects_from_the_command_line_share_a_folder(world: World, scene: Path, clip: Path) -> None:
    first = world.done("bench", "anaglyph", "--quick", "--scene", scene, "--sequence", clip, "--out", "out")
    assert first.stdout.strip() == "out/report.html" and (world.root / "out" / "report.html").is_file()
    world.done("bench", "judder", "--quick", "--out", "out")  # credited to itself only
    both = json.loads((world.root / "out" / "results.json").read_text())["subjects"]
    assert [one["about"]["command"].split()[2] for one in both.values()] == ["judder", "anaglyph"]


def test_mistakes_are_named(world: World, clip: Path) -> None:
    alone = world.run("bench")
    assert "Measure every subject" in alone.stdout + alone.stderr, "its help"
    for words, text in (
        (("bench", "trackers"), "trackers"),
        (("bench", "stability", "--quick", "--scene", "nowhere", "--sequence", clip), "nowhere"),
        (("bench", "stability", "--quick", "--sequence", "nowhere.avi"), "nowhere.avi"),
    ):
        assert text in world.refused(*words)
