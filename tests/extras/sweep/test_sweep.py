"""Sweeps from the command line, with crashes of their parts."""

import contextlib
import csv
import json
import signal
from pathlib import Path
from typing import Any

import psutil
import pytest

from lfpipe.bench.results import read
from tests.extras.sweep.conftest import write_plan
from tests.support.world import World, runs

PLAN = """
scenes = ["CORPUS/scenes/s[0-1]"]
subjects = ["quality"]
[config]
"render.method" = ["warp", "warp2"]
[table]
border = [4, 6]
"""
CELLS = 8
pytestmark = pytest.mark.nightly


def lines(world: World) -> list[dict[str, Any]]:
    file = world.root / "out" / "results.jsonl"
    return [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []


def running(parent: psutil.Process, word: str) -> list[psutil.Process]:
    """Children with this word in their command line."""
    found = []
    for child in parent.children():
        with contextlib.suppress(psutil.Error):  # it ends just now
            found += [child] if word in " ".join(child.cmdline()) else []
    return found


def cut_short(
    world: World, words: tuple[object, ...], how: signal.Signals, kept: list[dict[str, Any]]
) -> str:
    """Ends a sweep after another cell, and the first one's cell before; what it says."""
    process = world.start(*words)
    sweep = psutil.Process(process.pid)
    if not kept:
        world.wait_for(lambda: running(sweep, "runpy"), "process of a cell")[0].kill()
    left = world.wait_for(
        lambda: len(lines(world)) > len(kept) and running(sweep, "runpy"), "another cell"
    )
    process.send_signal(how)
    _, err = process.communicate(timeout=60)
    assert process.returncode == (-how if how == signal.SIGKILL else 130), err
    assert "Traceback" not in err and len(lines(world)) < CELLS
    world.wait_for(lambda: not any(runs(one.pid) for one in left), "end of the cells")
    return err


def test_every_cell_although_cells_and_the_sweep_are_killed(world: World, corpus: Path) -> None:
    """What is done is kept; the same command continues."""
    words = ("sweep", write_plan(world.root, corpus, PLAN), "--out", "out", "--jobs", "2")
    cut_short(world, words, signal.SIGKILL, [])
    kept = lines(world)
    assert "the same command continues" in cut_short(world, words, signal.SIGINT, kept)
    done = world.done(*words)
    assert f"{CELLS} cells: {CELLS} ok" in done.stdout and "Traceback" not in done.stderr
    assert lines(world)[: len(kept)] == kept
    assert len({line["key"] for line in lines(world)}) == CELLS == len(lines(world))
    world.done(*words)
    assert len(lines(world)) == CELLS, "nothing was left to do"
    table = list(csv.reader((world.root / "out" / "table.csv").open()))
    assert len(table) == CELLS + 1 and "warp2.psnr_db" in table[0]
    world.done("bench", "table", corpus / "scenes" / "s0", "--border", "4", "--out", "hand")
    of_sweep = next(
        one for one in lines(world) if one["scene"].endswith("s0") and "border=4" in one["options"]
    )
    for row in read(world.root / "hand")["table"].rows:
        assert all(
            of_sweep["metrics"][f"{row.curve}.{name}"] == row.value(name)
            for name in ("psnr_db", "ssim")
        )
