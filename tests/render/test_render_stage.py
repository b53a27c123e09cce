"""The stage render in the test's own process: records go in, pictures and words come out."""

import json
import os
import shutil
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from threading import Event
from typing import Any
from unittest.mock import Mock

import attrs
import cv2
import pytest

from lfpipe.config import Scene, SceneSummary, SessionOptions
from lfpipe.config.session_options import CameraViewer, Lossless, MouseViewer
from lfpipe.errors import UserError
from lfpipe.eyes import EyesRecord
from lfpipe.render import stage
from lfpipe.scene.pack import summarize
from lfpipe.scene.packing import pack_scene
from lfpipe.transport import control, ring
from lfpipe.transport.ring import MS_NS, now_ns
from lfpipe.transport.status import State
from tests.support.recorded import Recorded, recorded
from tests.support.world import write_scene

FRAME_NS = 33_333_333


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> tuple[SceneSummary, SceneSummary]:
    """Scenes of 2x3 and of 2x2 views."""
    folder = tmp_path_factory.mktemp("scenes")
    settings = Scene(cache_dir=str(folder / "cache"))
    first, second = (
        summarize(pack_scene(write_scene(folder / f"{cols}", 2, cols), settings)) for cols in (3, 2)
    )
    return first, second


class Rendered:
    """A stage with the writer of its eyes."""

    def __init__(self, context: Recorded, folder: Path) -> None:
        self.context = context
        self.trace, self.still = folder / "trace.jsonl", folder / "still.png"
        self.eyes: Any = None
        self.seq = 0

    def look(self, x_px: float = 320.0, face: bool = True) -> None:
        """A record of a face whose eyes have their midpoint there."""
        if self.eyes is None:
            self.eyes = ring.Writer(self.context.spec.session.segment("eyes"))
        points = (x_px + 30, 240.0, x_px - 30, 240.0)
        record = EyesRecord(points, points, (0.0,) * 4, 60.0, 1.0, 640, 480, 0, face, 1)
        record.write(self.eyes.begin())
        self.seq += 1
        self.eyes.publish(self.seq, self.seq * FRAME_NS, self.seq * FRAME_NS)

    def run(self, *steps: Any) -> list[dict[str, Any]]:
        """The lines of the trace after these steps: places to look from, or calls."""
        self.context.steps += [
            partial(self.look, one) if isinstance(one, float) else one for one in steps
        ]
        stage.main(self.context)
        return [json.loads(line) for line in self.trace.read_text().splitlines()]


@pytest.fixture
def rendered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, scenes: tuple[SceneSummary, SceneSummary]
) -> Iterator[Rendered]:
    options = SessionOptions(
        scene=scenes[0],
        viewer=CameraViewer(source="demo", rate_hz=30.0),
        clock=Lossless(),
        trace=str(tmp_path / "trace.jsonl"),
        still=str(tmp_path / "still.png"),
    )
    with recorded(tmp_path, monkeypatch, "render", options) as context:
        yield Rendered(context, tmp_path)


def test_each_record_has_a_picture_and_the_last_one_is_saved(rendered: Rendered) -> None:
    lines = rendered.run(300.0, 320.0, 340.0)
    assert [line["source_seq"] for line in lines] == [1, 2, 3]
    assert [line["composed"] for line in lines] == [True, True, True]
    picture = cv2.imread(str(rendered.still))
    assert picture is not None and picture.shape == (48, 64, 3)


def test_a_pause_leaves_records_out(rendered: Rendered) -> None:
    hear = rendered.context.hear
    pause = partial(hear, paused=True)
    lines = rendered.run(300.0, pause, 320.0, hear, 340.0, pause, 350.0)
    assert [line["source_seq"] for line in lines] == [1, 3]
    assert rendered.context.row["left_out"] == 2


def test_another_scene_is_shown_and_acknowledged(
    rendered: Rendered, scenes: tuple[SceneSummary, SceneSummary]
) -> None:
    context = rendered.context
    lines = rendered.run(200.0, partial(context.hear, scene=scenes[1]), 200.0)
    cols = [max(line["view"][side][1] for side in ("left", "right")) for line in lines]
    assert cols[0] > 1 >= cols[1], "the first one has three columns, the second one two"
    assert context.row["config_rev"] == 2


@pytest.mark.parametrize("damage", ["gone", "cut"])
def test_a_pack_that_cannot_be_opened_ends_the_stage_by_name(
    rendered: Rendered, scenes: tuple[SceneSummary, SceneSummary], tmp_path: Path, damage: str
) -> None:
    """The supervisor then takes the scene before again."""
    pack = tmp_path / "pack"
    if damage == "cut":
        shutil.copytree(scenes[1].pack, pack)
        os.truncate(pack / "views.npy", 1000)
    other = attrs.evolve(scenes[1], pack=str(pack))
    with pytest.raises(UserError, match=str(pack)):
        rendered.run(320.0, partial(rendered.context.hear, scene=other), 320.0)
    assert rendered.context.row["config_rev"] == 1
    assert len(rendered.trace.read_text().splitlines()) == 1 and rendered.still.exists()


def test_commands_are_answered(rendered: Rendered, tmp_path: Path) -> None:
    context = rendered.context

    def trace(path: Path) -> None:
        context.hear()
        context._commands = [("trace", {"cmd": "trace", "path": str(path), "inputs": []})]

    (tmp_path / "there").touch()
    rendered.run(
        320.0,
        partial(context.hear, "recentre"),
        330.0,
        partial(trace, tmp_path / "new"),
        partial(trace, tmp_path / "there"),
        330.0,
    )
    answers = [one for one in context.asked if one["cmd"] == control.EXECUTED]
    assert [one["ok"] for one in answers] == [True, True, False]
    assert "already exists" in answers[2]["error"]


def test_the_ring_of_eyes_has_one_writer(
    rendered: Rendered, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The mouse writes once the tracker has ended."""
    context = rendered.context
    track = context.table.rows["track"]
    opened: list[str] = []

    def output(name: str) -> Mock:
        opened.append(name)
        return Mock()

    monkeypatch.setattr(context, "output", output)
    track["state"] = State.RUNNING

    def end() -> None:
        assert opened == []
        track["state"] = State.FINISHED

    rendered.run(320.0, partial(context.hear, viewer=MouseViewer()), 320.0, end, 320.0)
    assert opened == ["eyes"]


def test_a_still_scene_rests_until_somebody_comes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, scenes: tuple[SceneSummary, SceneSummary]
) -> None:
    monkeypatch.setattr(stage, "REST_AFTER_NS", 100 * MS_NS)
    monkeypatch.setattr(stage, "REST_NS", 30 * MS_NS)
    options = SessionOptions(scene=scenes[0], viewer=CameraViewer(source="demo", rate_hz=30.0))
    rests: list[int] = []
    with recorded(tmp_path, monkeypatch, "render", options) as context:
        rendered = Rendered(context, tmp_path)

        def clock(until_ns: int) -> bool:
            rests.append(context.row["resting"])
            if rendered.seq:
                return False
            if sum(rests) == 3:
                rendered.look()  # early in a rest
                return True
            Event().wait(max(until_ns - now_ns(), 0) / 1e9)
            return len(rests) < 200

        context.clock = clock
        stage.main(context)
    assert rests[0] == 0 and sum(rests) == 3 and rests[-1] == 0
