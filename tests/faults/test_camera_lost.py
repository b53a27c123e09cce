"""A camera that stalls, hangs in its driver, is unplugged and comes back: the session survives and
reports it.
"""

import os
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfpipe.capture.frame_source import Frame, SourceInfo
from lfpipe.capture.open_source import BACKOFF_S, CameraLost, ReconnectingCamera
from lfpipe.errors import UserError
from lfpipe.supervisor.stage_process import HANG_S
from tests.support.world import World, stays

CAMERA = ("--set", "render.clock=camera", "--set", "render.method=nearest")


def _rows(world: World) -> dict[str, tuple[str, int, int]]:
    """State, pid and restarts of each stage."""
    return {
        name: (row["state"], row["pid"], row["restarts"])
        for name, row in world.monitor()["stages"].items()
    }


@pytest.mark.native("Video4Linux")
def test_session_outlives_all_that_happens_to_its_camera(
    world: World, scene: Path, tmp_path: Path
) -> None:
    node = tmp_path / "video0"
    node.write_text("frames")
    world.module = "tests.faults.scripted_camera"
    process = world.shows(scene, *CAMERA, camera=f"camera:{node}", pictures=10)
    before = _rows(world)
    pid = before["capture"][1]
    with world.tap() as heard:
        for outage, word in enumerate(("stall", "hang", ""), 1):
            if word:
                node.write_text(word)
            else:
                node.unlink()
            world.wait_for(
                lambda: _rows(world)["capture"] == ("READY", pid, 0),
                f"word of the {word or 'unplugged'} camera",
            )
            stays(
                lambda: _rows(world)["capture"] == ("READY", pid, 0),
                HANG_S + 0.2 if word == "hang" else 0.5,  # longer than a stage may be silent
                "the beat",
            )
            node.write_text("frames")
            assert world.more_pictures(3)[-1]["epoch"] == outage, (
                "downstream must forget what was before"
            )
            world.wait_for(lambda n=outage: len(heard("camera")) == 2 * n, "word on the tap")
            assert _rows(world)["capture"] == ("RUNNING", pid, 0)
        lost, back = heard("camera")[-2:]
        assert lost["lost"] and not back["lost"] and back["away_s"] > 0.4
        world.wait_for(lambda: "is back after" in heard("notice")[-1]["text"], "last notice")
        texts = [message["text"] for message in heard("notice")]
        assert (
            sum("camera lost, trying again" in text for text in texts)
            == sum("is back after" in text for text in texts)
            == 3
        )
        seqs = [line["source_seq"] for line in world.lines()]
        assert seqs == sorted(set(seqs)), "the camera's count goes on"

        # also unplugged while its process dies: a new process waits for it like the old one
        node.unlink()
        os.kill(pid, signal.SIGKILL)
        world.wait_for(lambda: _rows(world)["capture"][0::2] == ("READY", 1), "waiting capture")
        node.write_text("frames")
        world.more_pictures(3)
        assert all(_rows(world)[name] == before[name] for name in ("track", "render"))
        node.write_text("stall")
        world.wait_for(lambda: _rows(world)["capture"][0] == "READY", "stall")
    assert "camera lost, trying again" in world.ended(process, signal.SIGTERM)


class Made:
    """A camera whose reads are scripted: 0 for a frame, or an error."""

    def __init__(self, steps: list[Any]) -> None:
        self.info = SourceInfo("camera:made", (4, 4), 30.0, live=True)
        self.steps = steps
        self.seq = 0
        self.closed = False

    def read(self, out: np.ndarray) -> Frame | None:
        if isinstance(step := self.steps.pop(0), Exception):
            raise step
        self.seq += 1
        out[:] = self.seq
        return Frame(self.seq - 1, self.seq, self.seq)

    def close(self) -> None:
        self.closed = True


def _read(camera: ReconnectingCamera, out: np.ndarray) -> tuple[Frame, list[Exception]]:
    """The next frame and the errors before it."""
    raised: list[Exception] = []
    while True:
        try:
            frame = camera.read(out)
            assert frame is not None
            return frame, raised
        except TimeoutError as error:
            raised.append(error)


def test_reconnecting_camera_continues_counting_and_reports_a_loss_once() -> None:
    opened: list[Made] = []
    scripts: list[Any] = [
        [0, 0, UserError("gone")],
        UserError("no such device"),
        [0, ZeroDivisionError("a mistake of ours")],
    ]

    def open_() -> Made:
        script = scripts.pop(0)
        if isinstance(script, Exception):
            raise script
        opened.append(Made(script))
        return opened[-1]

    camera = ReconnectingCamera(SourceInfo("?", (1, 1), 1.0, live=True), open_)
    assert camera.info.name == "camera:made"
    out = np.zeros((4, 4), np.uint8)
    assert [_read(camera, out)[0].source_seq for _ in range(2)] == [0, 1]
    start = time.monotonic()
    frame, raised = _read(camera, out)
    assert frame.source_seq == 2 and (out == 1).all()
    assert [str(error) for error in raised if isinstance(error, CameraLost)] == ["gone"], (
        "told once, with the first reason"
    )
    assert time.monotonic() - start >= BACKOFF_S + 2 * BACKOFF_S, (
        "each attempt waits twice as long as the one before"
    )
    with pytest.raises(ZeroDivisionError):
        _read(camera, out)
    assert opened[0].closed
    camera.close()
    assert opened[1].closed
