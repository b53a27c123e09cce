"""Sweeps from the command line, with crashes of their parts."""

import contextlib
import csv
import itertools
import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import psutil
import pytest

from lfpipe.bench.results import read
from lfpipe.extras.sweep.plan import Cell
from lfpipe.extras.sweep.work import SweepOptions, measure_cell
from tests.extras.sweep.conftest import write_plan, write_wall
from tests.support.world import World, runs

PLAN = """
scenes = ["CORPUS/scenes/s[0-1]"]
subjects = ["quality"]
[config]
"render.method" = ["warp", "warp2"]
[table]
border = [4, 6]
"""
MIXED = """
sequences = ["CORPUS/recordings/*", "CORPUS/broken/cut"]
scenes = ["CORPUS/scenes/s0", "CORPUS/scenes/nowhere"]
subjects = ["quality", "replay", "truth"]
[table]
border = [4]
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


@pytest.fixture
def scheduler(world: World) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """A scheduler and two workers, as somebody else started them."""
    file = world.root / "scheduler.json"
    quiet: dict[str, Any] = {
        "env": world.env,
        "stdout": subprocess.DEVNULL,
        "stderr": subprocess.DEVNULL,
        "cwd": world.root,
    }
    dask = [
        sys.executable,
        "-m",
        "distributed.cli.dask_scheduler",
        "--no-dashboard",
        "--host",
        "127.0.0.1",
        "--port",
        "0",
    ]
    started = [subprocess.Popen([*dask, "--scheduler-file", str(file)], **quiet)]
    world.wait_for(lambda: file.exists() and file.stat().st_size > 0, "address of the scheduler")
    address = json.loads(file.read_text())["address"]
    for k in range(2):
        words = [
            "--nthreads",
            "1",
            "--no-dashboard",
            "--local-directory",
            str(world.root / f"w{k}"),
        ]
        started.append(
            subprocess.Popen(
                [sys.executable, "-m", "distributed.cli.dask_worker", address, *words], **quiet
            )
        )
    yield started[0], address
    for process in started:
        process.kill()
        process.wait(60)


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


def test_a_cluster(
    world: World, corpus: Path, scheduler: tuple[subprocess.Popen[bytes], str]
) -> None:
    """A worker that dies changes nothing; timed cells run one at a time, after the others; a dead
    scheduler is a clear end.
    """
    dask, address = scheduler
    text = (
        PLAN.replace('["quality"]', '["quality", "table"]')
        .replace('["warp", "warp2"]', '"warp"')
        .replace("[4, 6]", "[4]")
    )
    plan = write_plan(world.root, corpus, text)
    process = world.start("sweep", plan, "--out", "out", "--on", address, "--insecure")
    world.wait_for(lambda: lines(world), "first cell")
    running(running(psutil.Process(), str(world.root / "w0"))[0], "spawn_main")[0].kill()
    _, err = process.communicate(timeout=110)
    assert process.returncode == 0, err
    by_subject: dict[str, list[dict[str, Any]]] = {"quality": [], "table": []}
    for line in sorted(lines(world), key=lambda line: str(line["scene"])):
        by_subject[line["subject"]].append(line)
    timed = sorted((one["began_s"], one["began_s"] + one["seconds"]) for one in by_subject["table"])
    assert len(timed) == 2 and all(a[1] <= b[0] for a, b in itertools.pairwise(timed)), (
        "one at a time"
    )
    for one, other in zip(by_subject["quality"], by_subject["table"], strict=True):
        metrics = {
            name: value
            for name, value in other["metrics"].items()
            if "psnr" in name or "ssim" in name
        }
        assert metrics == {name: one["metrics"][name] for name in metrics} != {}, (
            "whoever measures them"
        )
    other_plan = write_plan(world.root, corpus, PLAN)
    process = world.start("sweep", other_plan, "--out", "out", "--on", address, "--insecure")
    world.wait_for(lambda: len(lines(world)) >= 6, "sixth cell")
    dask.kill()
    _, err = process.communicate(timeout=90)
    assert process.returncode == 2 and "the scheduler is gone" in err and "Traceback" not in err, (
        err
    )


def test_missing(world: World, corpus: Path) -> None:
    plan = write_plan(world.root, corpus, MIXED)
    done = world.run("sweep", plan, "--out", "out", timeout_s=120)
    assert done.returncode == 1 and "Traceback" not in done.stderr, done.stderr
    found = {
        (one["subject"], Path(one["sequence"]).name, Path(one["scene"]).name): one
        for one in lines(world)
    }
    assert len(found) == 2 + 4 + 4
    states = {place: one["state"] for place, one in found.items()}
    assert all(
        state == "failed" for place, state in states.items() if "nowhere" in place or "cut" in place
    ), states
    assert all(one["reason"] for one in found.values() if one["state"] == "failed")
    assert (
        states["quality", "", "s0"]
        == states["replay", "walk", "s0"]
        == states["truth", "walk", "s0"]
        == "ok"
    )
    assert found["truth", "walk", "s0"]["metrics"]["truth.used.rms_px"] > 0
    suite = ElementTree.parse(world.root / "out" / "junit.xml").getroot()
    assert suite.get("tests") == "10" and suite.get("errors") == str(
        sum(state == "failed" for state in states.values())
    )
    world.done(
        "replay",
        corpus / "recordings" / "walk",
        "--scene",
        corpus / "scenes" / "s0",
        "--out",
        "hand",
    )
    digests = json.loads((world.root / "hand" / "report.json").read_text())["digests"]
    metrics = found["replay", "walk", "s0"]["metrics"]
    assert {name: metrics[f"digest.{name}"] for name in digests} == digests


def test_a_clock_that_is_set_back_changes_no_duration(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    hours = itertools.count(500, -1)
    monkeypatch.setattr("lfpipe.extras.sweep.work.time.time", lambda: 3600.0 * next(hours))
    cell = Cell(subject="truth", sequence=str(tmp_path), scene="")
    outcome = measure_cell(cell, SweepOptions(60.0))
    assert outcome.state == "failed" and 0 < outcome.seconds < 60, outcome.reason


def test_references_of_a_corpus(world: World, corpus: Path) -> None:
    write_wall(world.root / "wall", 0)
    text = MIXED.replace(', "CORPUS/broken/cut"', "").replace(
        '"CORPUS/scenes/s0", "CORPUS/scenes/nowhere"', '"wall"'
    )
    plan = write_plan(
        world.root, corpus, text.replace('"quality", "replay", "truth"', '"quality", "replay"')
    )
    words = ("sweep", plan, "--out", "out", "--jobs", "1", "--expect", "ref")
    assert "the first time, add --update" in world.refused(*words)
    (world.root / "ref").mkdir()
    bare = world.run(*words)
    assert bare.returncode == 1 and "write it with --update" in bare.stdout
    world.done(*words, "--update")
    assert len(list((world.root / "ref").iterdir())) == 2
    assert "2 cells: 2 ok" in world.done(*words).stdout
    for path in (world.root / "ref").glob("quality*/metrics.json"):
        path.write_text(
            json.dumps({name: value * 1.1 for name, value in json.loads(path.read_text()).items()})
        )
    changed = world.run(*words)
    assert (
        changed.returncode == 1
        and "differs: quality" in changed.stdout
        and "2 cells: 1 ok, 1 differs" in changed.stdout
    )


def test_references_are_not_written_into_a_folder_of_a_person(world: World, corpus: Path) -> None:
    plan = write_plan(world.root, corpus, MIXED)
    mine = world.root / "mine"
    mine.mkdir()
    (mine / "notes.txt").write_text("mine")
    words = ("sweep", plan, "--out", "out", "--update", "--expect")
    assert "notes.txt" in world.refused(*words, "mine")
    assert "which this command reads" in world.refused(*words, corpus / "scenes" / "s0" / "ref")
    out = corpus / "scenes" / "s0" / "out"
    assert "which this command reads" in world.refused("sweep", plan, "--out", out)
    assert [path.name for path in mine.iterdir()] == ["notes.txt"] and not out.exists()
