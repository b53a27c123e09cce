"""A replay in steps against a reference in git, and the changes that it must detect."""

import itertools
import json
import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from lfpipe.replays.run import Line, pair, read_trace
from tests.support.world import World

ROOT = Path(__file__).parents[2]
REFERENCE = Path(__file__).parent / "reference"
# The plane of the screen by number:
# estimated disparity is not the same to the last bit in OpenCV 4 and 5.
KEYS = (
    "render.method=nearest",
    "render.alpha_px=8",
    "render.zero_plane_px=0",
    "replay.latency_ms=20",
)
SETTINGS = tuple(f"--set={key}" for key in KEYS)
# to make it anew: LFPIPE_UPDATE_REFERENCE=1 pytest
# tests/replay/test_reference.py -k reference_in_git


def _eyes(lines: list[Line], name: str) -> np.ndarray:
    return np.array([pair(line, name) for line in lines])


@pytest.mark.everyday
def test_the_reference_in_git_is_met(world: World, walk: Path, blocks: Path) -> None:
    args = ("replay", walk, "--scene", blocks, *SETTINGS, "--expect", REFERENCE)
    if os.environ.get("LFPIPE_UPDATE_REFERENCE"):
        world.done(*args, "--update")
    world.done(*args, "--out", world.root / "out", "--junit", world.root / "j.xml")
    was, now = read_trace(REFERENCE), read_trace(world.root / "out")
    assert len(was) == len(now) == 300
    for name in ("eyes_raw", "eyes_filtered", "eyes_used"):
        assert np.abs(_eyes(was, name) - _eyes(now, name)).max() <= 0.05
    assert [line["view"] for line in was] == [line["view"] for line in now]
    reports = [
        json.loads((folder / "report.json").read_text())
        for folder in (REFERENCE, world.root / "out")
    ]
    if reports[0]["versions"] == reports[1]["versions"]:
        assert reports[0]["digests"] == reports[1]["digests"]
    assert reports[1]["truth_error"]["raw"]["rms_px"] < 1.0, "truth and eyes belong together"
    suite = ElementTree.parse(world.root / "j.xml").getroot()
    assert suite.get("failures") == "0" and {case.get("name") for case in suite} >= {
        "eyes",
        "views",
        "pictures",
    }
    seen = [(line["t_read_ns"], line["t_presented_ns"]) for line in now]
    assert all(shown < read for (_, shown), (read, _) in itertools.pairwise(seen)), (
        "one frame at a time"
    )


def test_load_and_cores_change_no_bit(world: World, short: Path, blocks: Path) -> None:
    cpus = sorted(os.sched_getaffinity(0))
    busy = "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\nwhile True: pass"
    hog = subprocess.Popen([sys.executable, "-c", busy])
    found = []
    try:
        for number, (pace, cores) in enumerate((("step", cpus[:1]), ("max", cpus[:2]))):
            out = world.root / f"out{number}"
            args = ("replay", short, "--scene", blocks, *SETTINGS, "--pace", pace, "--out", out)
            process = world.start(
                *args, preexec_fn=lambda cores=cores: os.sched_setaffinity(0, cores)
            )
            _, err = process.communicate(timeout=90)
            assert process.returncode == 0, err
            found.append(json.loads((out / "report.json").read_text())["digests"])
    finally:
        hog.kill()
        hog.wait(60)
    quiet = world.root / "quiet"
    # by `lfpipe calibrate --latency`: of this screen, which a replay has not
    measured = ("--set", "render.device_latency_ms=60")
    world.done("replay", short, "--scene", blocks, *SETTINGS, *measured, "--out", quiet)
    assert found == [json.loads((quiet / "report.json").read_text())["digests"]] * 2


def test_a_replay_fails_whose_stage_had_to_be_restarted(
    world: World, walk: Path, blocks: Path
) -> None:
    out = world.root / "out"
    process = world.start("replay", walk, "--scene", blocks, *SETTINGS, "--out", out)
    world.name = f"replay.{process.pid}"
    trace = out / "trace.jsonl"
    world.wait_for(lambda: trace.exists() and trace.stat().st_size, "picture")
    world.kill("track")
    assert "track failed during the replay and had to be restarted" in world.ended(process, code=1)
    assert not (out / "report.json").exists()
