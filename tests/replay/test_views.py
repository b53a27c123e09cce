"""Sessions with a live scene: both streams are recorded, and replayed to the same bits."""

import json
from pathlib import Path

import pytest

from lfpipe.sequence.folder import VIEWS, open_sequence
from lfpipe.sequence.views import Known, open_views
from tests.live import made
from tests.pipeline.test_live_field import drawing
from tests.render import rendered
from tests.replay.test_record import frames
from tests.support.films import write_film
from tests.support.world import World

SMALL = ("--set=camera.width_px=320", "--set=camera.height_px=240")


@pytest.fixture
def scene(tmp_path: Path) -> str:
    """A clip whose disparity changes from frame to frame."""
    near = [1.0 + k / 8 for k in range(12)]
    shown = [made.frame_of(rendered.field(1, 2, 96, 128, scale=px)) for px in (*near, *near[::-1])]
    clip = write_film(tmp_path / "views.avi", shown)
    return f"live:file:{clip}?layout=side-by-side"


@pytest.mark.live
def test_both_streams_of_a_session_are_replayed_to_the_same_bits(world: World, scene: str) -> None:
    out = world.root / "rec"
    world.shows(Path(scene), *SMALL)
    world.ctl("record", "start", out)
    world.wait_for(lambda: min(frames(out), frames(out / VIEWS)) > 30, "frames of both streams")
    world.ctl("record", "stop")
    world.wait_for(lambda: json.loads((out / "manifest.json").read_text())["complete"], "manifest")
    world.ctl("stop")
    opened = open_views(out)
    assert opened is not None and opened[0].complete
    assert opened[0].codecs == {"jpeg"}, "as in the clip"
    reports = []
    for number, pace in enumerate(("step", "max")):
        to = world.root / f"out{number}"
        args = ("--expect", world.root / "out0") if number else ()
        world.done("replay", out, "--pace", pace, "--out", to, *args)
        reports.append(json.loads((to / "report.json").read_text()))
    assert reports[0]["digests"] == reports[1]["digests"]
    lines = [
        json.loads(line) for line in (world.root / "out0/trace.jsonl").read_text().splitlines()
    ]
    assert len(lines) == len(open_sequence(out).packets)
    assert len({line["disparity"] for line in lines}) > 10 and lines[-1]["own_disparity"]
    again = world.run(
        "replay", out, "--set=render.zero_plane_px=1", "--expect", world.root / "out0"
    )
    assert again.returncode == 1 and "differs: config: render.zero_plane_px" in again.stdout


@pytest.mark.live
def test_record_takes_a_scene_beside_the_camera(world: World, scene: str) -> None:
    out = world.root / "rec"
    said = world.done("record", out, "--camera", "demo", "--scene", scene, "--duration", 2, *SMALL)
    assert "of the scene" in said.stderr and open_views(out) is not None


@pytest.mark.live
def test_scene_of_a_program_is_replayed_with_the_disparity_that_it_gave(world: World) -> None:
    out = world.root / "rec"
    with drawing(world, "disparity") as live:
        world.done("record", out, "--camera", "demo", "--scene", live, "--duration", 2, *SMALL)
    opened = open_views(out)
    assert opened is not None and opened[1].drawn and "scene" in opened[0].codecs
    given = [known for k in range(len(opened[0].packets)) if (known := Known.of(*opened, k))]
    assert given and not any(known.maps.any() for known in given)
    world.done("replay", out, "--out", world.root / "first")
    world.done("replay", out, "--pace", "max", "--expect", world.root / "first")
    trace = (world.root / "first/trace.jsonl").read_text().splitlines()
    lines = [line for line in map(json.loads, trace) if line.get("own_disparity")]
    assert lines and len({line["disparity"] for line in lines}) == 1
