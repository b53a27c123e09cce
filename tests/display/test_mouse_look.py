"""The mouse as the viewer, without a camera and beside one."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lfpipe.config import Config
from lfpipe.eyes import EYES, EyesRecord
from lfpipe.render.display.display import Pointer
from lfpipe.render.viewer.mouse_look import MouseLook
from lfpipe.render.viewer.viewer import Viewer
from lfpipe.sequence.folder import open_sequence
from lfpipe.transport.ring import Stamp
from tests.render.rendered import field
from tests.render.rendered import record as eyes_record
from tests.support.world import World
from tests.support.xvfb_screen import Screen, needs_xdotool

REFRESH_NS = 16_666_667


class Session:
    """A viewer whose eyes are those of the mouse, one refresh after the other."""

    def __init__(self, alone: bool = True) -> None:
        self.viewer = Viewer(field(5, 9), Config(), neutral_is_fixed=alone)
        ring: Any = SimpleNamespace(begin=lambda: np.zeros((), EYES), publish=lambda *_: 0)
        self.mouse = MouseLook(Config(), self.viewer, ring if alone else None)
        self.t_ns = 10**9

    def cols(
        self, pointer: Pointer, refreshes: int = 90, camera: EyesRecord | None = None
    ) -> list[float]:
        """The column between both eyes at each refresh with the pointer there."""
        columns = []
        for _ in range(refreshes):
            self.t_ns += REFRESH_NS
            self.mouse.move(pointer, self.t_ns)
            record = camera
            t_ns = self.t_ns
            if self.mouse.is_viewer:
                record, _ = self.mouse.eyes(camera, Stamp(1, 1, 0, t_ns, t_ns, t_ns, 0), t_ns)
            views = self.viewer.viewpoints(record, t_ns, t_ns)
            columns.append((views.left[1] + views.right[1]) / 2)
        return columns


def test_mouse_look_from_edge_to_edge_without_a_jump() -> None:
    session = Session()
    assert session.cols(Pointer(0.5, 0.5))[-1] == pytest.approx(4, abs=0.05)
    way = session.cols(Pointer(0.0, 0.5))
    assert way[-1] < 1.5 and max(np.abs(np.diff(way))) < 0.6
    assert session.cols(Pointer(1.0, 0.5), 400)[-1] > 6.5
    for y, least, most in ((0.0, 0, 1), (1.0, 3, 9)):
        session.cols(Pointer(0.5, y), 200)
        views = session.viewer.last_viewpoints
        assert views is not None and least <= views.left[0] <= most


def test_mouse_look_right_button_takes_over_without_a_jump() -> None:
    session = Session(alone=False)
    camera = eyes_record(eye_distance=60.0, eye_distance_px=60.0, generation=1)
    still = session.cols(Pointer(0.1, 0.5), 200, camera)
    assert not session.mouse.is_viewer
    away = session.cols(Pointer(0.1, 0.5, right=True), 120, camera)
    back = session.cols(Pointer(0.1, 0.5), 200, camera)
    assert away[-1] < still[-1] - 1.5 and back[-1] == pytest.approx(still[-1], abs=0.3)
    assert max(np.abs(np.diff([*still, *away, *back]))) < 0.6 and not session.mouse.is_viewer


@pytest.mark.timeout(300)
@needs_xdotool
def test_mouse_session_is_recorded_and_played_again(
    world: World, scene: Path, screen: Screen
) -> None:
    """The recording holds the eyes."""
    world.env["DISPLAY"] = screen.name
    out = world.root / "rec"
    process = world.shows(scene, camera="mouse", display="fullscreen")

    for x, follows in ((1200, lambda col: col > 0.75), (80, lambda col: col < 0.25)):
        world.xdotool("mousemove", x, 400)
        world.wait_for(
            lambda follows=follows: follows(world.lines()[-1]["view"]["left"][1]),
            "picture that follows the mouse",
        )
    assert all(line["face"] for line in world.lines())
    world.ctl("record", "start", out)

    def recorded_frames() -> int:
        return (
            (out / "frames.jsonl").read_text().count("\n") if (out / "frames.jsonl").exists() else 0
        )

    world.wait_for(recorded_frames, "first frame of the recording")
    moves = " ".join(f"mousemove {x} 500 sleep 0.03" for x in range(300, 1200, 30))
    world.xdotool(*moves.split())
    world.wait_for(lambda: recorded_frames() > 60, "recording of the motion")
    world.ctl("record", "stop")
    world.wait_for(lambda: json.loads((out / "manifest.json").read_text())["complete"], "manifest")
    world.ctl("stop")
    assert "the mouse: move it to look around" in world.ended(process)
    world.done("sequence", "check", out)
    recorded = open_sequence(out)
    known = {line["t_sensor_ns"]: line for line in world.lines()}
    for packet in recorded.packets:
        line = known[packet.t_sensor_ns]
        left, right = recorded.eyes(packet.seq)["raw_px"].tolist()
        assert line["eyes_raw"] == {"left": left, "right": right}
    world.done("replay", out, "--scene", scene, "--out", world.root / "one")
    lines = (world.root / "one" / "trace.jsonl").read_text().splitlines()
    cols = [json.loads(line)["view"]["left"][1] for line in lines]
    assert len(cols) == len(recorded.packets) and np.ptp(cols) > 0.5
