"""Listeners: status row, trace, ring of pictures, stamps for sharing, messages to the tap."""

import json
import os
from pathlib import Path
from types import SimpleNamespace

import attrs
import numpy as np
import pytest

from lfpipe.config import SessionOptions
from lfpipe.config.session_options import Lossless, ReplayOutput
from lfpipe.errors import UserError
from lfpipe.eyes import SHOWN
from lfpipe.render.display.display import Display
from lfpipe.render.listeners import (
    PictureRing,
    ShownStamps,
    StatusRow,
    Trace,
    trace_line,
)
from lfpipe.render.metrics import METRICS
from lfpipe.render.presenter import REPLACED, DisplayTime, Presentation
from lfpipe.render.stage import RenderStage
from lfpipe.transport import ring
from lfpipe.transport.ring import RingSpec
from lfpipe.transport.status import ROW, Row, summary_ms
from tests.contracts import contract
from tests.render.rendered import S, presentation, viewer

REFRESH_NS = S // 60
NONE = SessionOptions()


class Vblanks(Display):
    vblank_source = "vblanks"


# trace


def traced(path: Path) -> SessionOptions:
    return attrs.evolve(NONE, trace=str(path))


def test_trace_has_a_line_per_picture_with_eyes_while_it_is_asked_for(tmp_path: Path) -> None:
    trace = Trace(viewer(), None, pytest.fail)
    trace.set_options(traced(tmp_path / "trace.jsonl"))
    trace.presented(presentation(seq=2, eyes=None))
    trace.presented(presentation(seq=3))
    trace.presented(presentation(seq=4, by="vblanks", more={"picture": "0"}))
    trace.set_options(NONE)
    trace.presented(presentation(seq=5))
    trace.close()
    lines = [json.loads(line) for line in (tmp_path / "trace.jsonl").read_text().splitlines()]
    assert [line["seq"] for line in lines] == [3, 4]
    assert (lines[1]["presented_by"], lines[1]["picture"]) == ("vblanks", "0")
    assert (
        lines[0]["eyes_used"] == lines[0]["eyes_raw"] == {"left": [332, 240], "right": [308, 240]}
    )


def test_render_stage_reports_a_lost_output_and_ends_a_replay(tmp_path: Path) -> None:
    """A replay needs its trace and its pictures."""
    reasons: list[str] = []
    stage = SimpleNamespace(_options=NONE, _context=SimpleNamespace(report_lost=reasons.append))
    RenderStage._lost(stage, "full")  # type: ignore[arg-type]
    assert reasons == ["full"]
    output = ReplayOutput(str(tmp_path), str(tmp_path), pictures=False)
    stage._options = attrs.evolve(NONE, clock=Lossless(output=output))
    with pytest.raises(UserError, match="full"):
        RenderStage._lost(stage, "full")  # type: ignore[arg-type]


def test_trace_continues_after_a_restart_and_starts_over_with_a_session(
    tmp_path: Path,
) -> None:
    began = tmp_path / "session.json"
    began.touch()
    os.utime(began, ns=(1, 1))
    for since, count in ((None, 1), (began, 2), (began, 3), (None, 1)):
        trace = Trace(viewer(), since, pytest.fail)
        trace.set_options(traced(tmp_path / "trace"))
        trace.presented(presentation())
        trace.close()
        assert (tmp_path / "trace").read_text().count("\n") == count


# status row


ON_TIME = DisplayTime(S, REFRESH_NS)
SEEN = presentation(display_time=ON_TIME, cost_ns=5_000_000, t_presented_ns=2 * S)


@pytest.mark.parametrize(
    ("display", "handed", "missed", "presented", "metrics"),
    [
        # what was planned, and what came otherwise; one was seen
        (
            Vblanks(),
            [SEEN, presentation(number=0, display_time=ON_TIME)],
            3,
            [SEEN, presentation(juddered=True, by=REPLACED)],
            {"seq": 2, "planned": 5, "missed": 3, "juddered": 4, "face": 1, "t_face_ns": S}
            | {"age": 1, "busy": 2},
        ),
        # without vblanks nothing is planned
        (
            Display(),
            [presentation(display_time=ON_TIME)],
            2,
            [],
            {"planned": 0, "juddered": 0, "missed": 2},
        ),
        # the last face stays
        (
            Display(),
            [presentation(), presentation(eyes=None)],
            0,
            [],
            {"face": 1, "source_seq": -1},
        ),
    ],
)
def test_status_row_counts(
    display: Display,
    handed: list[Presentation],
    missed: int,
    presented: list[Presentation],
    metrics: dict[str, int],
) -> None:
    row = Row(np.zeros((), ROW), METRICS)
    status = StatusRow(row, viewer(), display)
    for one in handed:
        status.handed_over(one)
    status.missed(missed)
    for one in presented:
        status.presented(one)
    counts = {name: int(row.record[name]["count"].sum()) for name in ("age", "busy")}
    assert {name: counts[name] if name in counts else row[name] for name in metrics} == metrics


# rings


def test_picture_ring_begins_with_the_picture_on_the_screen(tmp_path: Path) -> None:
    segment = ring.create(tmp_path / "a", RingSpec((4, 4, 3), np.dtype(np.uint8), 4))
    try:
        listener = PictureRing(lambda asked: tmp_path / asked)
        picture = np.full((4, 4, 3), 7, np.uint8)
        listener.handed_over(presentation(picture=picture))
        reader = ring.Reader(tmp_path / "a")
        listener.set_options(attrs.evolve(NONE, pictures="a"))
        out = np.zeros((4, 4, 3), np.uint8)
        assert reader.read(out) is not None and np.array_equal(out, picture)
        for one, level in (
            (presentation(number=0, picture=picture), None),  # it stayed on the screen
            (presentation(picture=np.zeros((8, 4, 3), np.uint8)), None),  # of another scene
            (presentation(picture=np.full((2, 2, 3), 6, np.uint8)), 6),  # in a small window
            (presentation(picture=picture + 1), 8),
        ):
            listener.handed_over(one)
            stamp = reader.read(out)
            assert level == (None if stamp is None else out[0, 0, 0])
        assert stamp is not None and stamp.t_sensor_ns == S
        listener.set_options(attrs.evolve(NONE, pictures="none"))  # released since
        reader.close()
    finally:
        segment.remove()


def test_shown_stamps_only_on_demand_and_of_what_was_seen() -> None:
    records: list[tuple[int, int]] = []
    slot = np.zeros((), SHOWN)
    publish = lambda seq, *_: records.append((seq, int(slot["t_presented_ns"])))  # noqa: E731
    opened = SimpleNamespace(begin=lambda: slot, publish=publish)
    stamps = ShownStamps(lambda: opened)  # type: ignore[arg-type, return-value]
    stamps.presented(presentation(t_presented_ns=5))
    stamps.set_options(attrs.evolve(NONE, asked_for=("shown",)))
    stamps.presented(presentation(t_presented_ns=6))
    stamps.presented(presentation(by=REPLACED))
    stamps.presented(presentation(eyes=None))
    assert records == [(1, 6)]


def test_trace_line_has_the_columns_of_the_contract() -> None:
    line = json.loads(json.dumps(trace_line(presentation(by="x_present"), "warp", 0)))
    example = contract("trace.json")
    kinds = {key: type(value) for key, value in example.items()}
    assert {key: type(value) for key, value in line.items()} == kinds
    for key in ("eyes_raw", "eyes_used", "view"):
        assert list(line[key]) == list(example[key]) == ["left", "right"]
        assert all(np.shape(side) == (2,) for side in line[key].values())


def test_status_row_measures_the_prediction_in_ns() -> None:
    row = Row(np.zeros((), ROW), METRICS)
    eyes_ns = S
    seen = DisplayTime(eyes_ns + 60_000_000, device_latency_ns=80_000_000)
    StatusRow(row, viewer(), Display()).handed_over(presentation(display_time=seen))
    measured = summary_ms(row.histograms["prediction"].record)
    assert measured["n"] == 1 and measured["p50_ms"] == pytest.approx(140.0, rel=0.02)
