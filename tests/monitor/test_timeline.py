"""Traces of running sessions, and timelines: trace-event JSON that a strict reader accepts."""

import itertools
import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.monitor.monitor import TRACKS, convert, events


def line(
    source_seq: int, sensor: int, steps: tuple[int, int, int, int, int], composed: bool = True
) -> dict[str, Any]:
    stamps = list(itertools.accumulate((sensor, *steps)))
    names = ("sensor", "read", "tracked", "started", "composed", "presented")
    view = {"left": [1.0, 1.0], "right": [1.0, 2.0]}
    about = {
        "source_seq": source_seq,
        "epoch": 0,
        "face": True,
        "view": view,
        "method": "warp",
        "composed": composed,
    }
    return {**about, **{f"t_{name}_ns": stamp for name, stamp in zip(names, stamps, strict=True)}}


def check(made: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Checks "Trace Event Format": known phases, slices that do not overlap on a track. Returns the
    slices by track.
    """
    tracks = {
        e["tid"]: e["args"]["name"] for e in made if e["ph"] == "M" and e["name"] == "thread_name"
    }
    assert tuple(tracks.values()) == TRACKS
    slices: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for event in made:
        assert event["ph"] in "MX" and event["pid"] == 1 and isinstance(event["name"], str)
        if event["ph"] == "X":
            assert event["ts"] >= 0 and event["dur"] >= 0
            slices[tracks[event["tid"]]].append(event)
    for found in slices.values():
        for before, after in itertools.pairwise(sorted(found, key=lambda e: (e["ts"], e["dur"]))):
            assert before["ts"] + before["dur"] <= after["ts"] + 1e-3, (
                "slices of a track do not overlap"
            )
    return slices


@given(
    st.lists(st.tuples(st.tuples(*[st.integers(0, 50_000_000)] * 5), st.booleans()), max_size=30)
)
def test_timeline_of_any_trace_is_sound(made: list[tuple[Any, bool]]) -> None:
    lines = [
        line(k // 2, 10**9 + (k // 2) * 33_000_000, steps, composed)
        for k, (steps, composed) in enumerate(made)
    ]
    slices = check(list(events(lines)))
    assert len(slices["capture"]) == len({each["source_seq"] for each in lines})
    assert (
        len(slices["render"]) == len(slices["display"]) == sum(each["composed"] for each in lines)
    )
    seen = {s["args"]["source_seq"] for found in slices.values() for s in found}
    assert seen == {each["source_seq"] for each in lines}


LINES = [line(k, 10**9 + k * 33_000_000, (1000, 3000, 500, 4000, 100)) for k in range(6)]


def written(path: Path) -> Path:
    path.write_text("".join(json.dumps(each) + "\n" for each in LINES))
    return path


def test_convert_writes_microseconds(tmp_path: Path) -> None:
    out = tmp_path / "t.json"
    convert(written(tmp_path / "t.jsonl"), out)
    slices = check(json.loads(out.read_text())["traceEvents"])
    begun, shown = slices["render"][0], slices["display"][0]
    assert (begun["ts"], begun["dur"], shown["args"]["age_ms"]) == pytest.approx(
        (1_000_004.5, 4.0, 0.0086)
    )
