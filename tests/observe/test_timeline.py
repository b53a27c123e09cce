"""Timelines: trace-event JSON that a strict reader accepts, from a trace made here and from a real session."""

import itertools
import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.errors import UserError
from lfpipe.observe.timeline import TRACKS, convert, events
from tests.world import World


def line(source_seq: int, sensor: int, steps: tuple[int, int, int, int, int], composed: bool = True) -> dict[str, Any]:
    stamps = list(itertools.accumulate((sensor, *steps)))
    names = ("sensor", "read", "tracked", "started", "composed", "presented")
    view = {"left": [1.0, 1.0], "right": [1.0, 2.0]}
    about = {"source_seq": source_seq, "epoch": 0, "face": True, "view": view, "method": "warp", "composed": composed}
    return {**about, **{f"t_{name}_ns": stamp for name, stamp in zip(names, stamps, strict=True)}}


def check(made: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Checks "Trace Event Format": known phases, slices that do not overlap on a track, arrows that start, end and are bound to a
    slice. Returns the slices by track."""
    tracks = {e["tid"]: e["args"]["name"] for e in made if e["ph"] == "M" and e["name"] == "thread_name"}
    assert tuple(tracks.values()) == TRACKS
    slices: dict[str, list[dict[str, Any]]] = defaultdict(list)
    arrows: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for event in made:
        assert event["ph"] in "MXstf" and event["pid"] == 1 and isinstance(event["name"], str)
        if event["ph"] == "X":
            assert event["ts"] >= 0 and event["dur"] >= 0
            slices[tracks[event["tid"]]].append(event)
        elif event["ph"] in "stf":
            arrows[event["id"]].append(event)
    for found in slices.values():
        for before, after in itertools.pairwise(sorted(found, key=lambda e: (e["ts"], e["dur"]))):
            assert before["ts"] + before["dur"] <= after["ts"] + 1e-3, "slices of a track do not overlap"
    for found in arrows.values():
        kinds = "".join(e["ph"] for e in found)
        assert kinds[0] == "s" and set(kinds[1:-1]) <= {"t"} and kinds[-1] in "tf" and kinds.count("s") == 1
        for event in found:
            around = [s for s in slices[tracks[event["tid"]]] if s["ts"] <= event["ts"] <= s["ts"] + s["dur"]]
            assert around, "an arrow begins and ends in a slice"
    return slices


@given(st.lists(st.tuples(st.tuples(*[st.integers(0, 50_000_000)] * 5), st.booleans()), max_size=30))
def test_any_trace_gives_a_sound_timeline(made: list[tuple[Any, bool]]) -> None:
    lines = [line(k // 2, 10**9 + (k // 2) * 33_000_000, steps, composed) for k, (steps, composed) in enumerate(made)]
    slices = check(list(events(lines)))
    assert len(slices["capture"]) == len({each["source_seq"] for each in lines})
    assert len(slices["render"]) == len(slices["display"]) == sum(each["composed"] for each in lines)


def test_times_are_microseconds_and_each_slice_tells_its_frame() -> None:
    slices = check(list(events([line(7, 2_000_000, (1000, 3000, 500, 4000, 100))])))
    assert [(s["ts"], s["dur"]) for s in slices["render"]] == [(2004.5, 4.0)]
    assert all(piece["args"]["source_seq"] == 7 for found in slices.values() for piece in found)
    assert slices["display"][0]["args"]["age_ms"] == pytest.approx(0.0086)


@pytest.mark.parametrize("text", ["no json\n", "[1]\n", '{"a": 1}\n', "\xff\n"])
def test_what_is_no_trace_is_said(tmp_path: Path, text: str) -> None:
    (tmp_path / "t").write_text(text, encoding="latin-1")
    with pytest.raises(UserError, match="not a trace"):
        convert(tmp_path / "t", tmp_path / "out.json")
    assert not (tmp_path / "out.json").exists()
    with pytest.raises(UserError, match="No such file"):
        convert(tmp_path / "gone", tmp_path / "out.json")


def test_a_timeline_of_a_running_session(world: World, scene: Path) -> None:
    world.up(scene)
    world.pictures(5)
    named = ("--session", world.name)
    assert world.run("trace", "stop", *named).returncode == 2, "none runs"
    assert world.run("trace", "start", "t.json", *named).returncode == 0
    again = world.run("trace", "start", "u.json", *named)
    assert again.returncode == 2 and "already being recorded" in again.stderr
    world.pictures(len(world.lines()) + 40)
    done = world.run("trace", "stop", *named)
    assert done.returncode == 0 and "t.json" in done.stdout
    made = json.loads((world.root / "t.json").read_text())["traceEvents"]
    slices = check(made)
    assert all(len(slices[name]) > 5 for name in ("capture", "track"))
    assert not (world.root / "t.json.part").exists()
    unwritable = world.run("trace", "start", "/proc/none/t.json", *named)
    assert unwritable.returncode == 2 and "/proc/none" in unwritable.stderr
