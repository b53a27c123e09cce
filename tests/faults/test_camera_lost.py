"""A camera that stalls, hangs in its driver, is unplugged and comes back: the session survives and reports it."""

import contextlib
import os
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfpipe.capture.frame_source import Frame, SourceInfo
from lfpipe.capture.reconnecting_camera import BACKOFF_S, CameraLost, ReconnectingCamera
from lfpipe.errors import UserError
from lfpipe.transport.session import Session
from lfpipe.transport.status import State, Table
from tests.world import World
from tests.xvfb_screen import Screen

CAMERA = ("--set", "render.clock=camera", "--set", "render.method=nearest")


Row = tuple[str, int, int]  # state, pid, restarts


def _rows(world: World) -> dict[str, Row]:
    table = Table(Session(world.name).segment("status"))
    try:
        return {name: (State(int(r["state"])).name, int(r["pid"]), int(r["restarts"])) for name, r in table.rows.items()}
    finally:
        table.close()


@pytest.mark.live
@pytest.mark.native("Video4Linux")
def test_one_session_outlives_all_that_happens_to_its_camera(world: World, scene: Path, tmp_path: Path) -> None:
    node = tmp_path / "video0"
    node.write_text("frames")
    world.module = "tests.faults.scripted_camera"
    process = world.up(scene, *CAMERA, camera=f"camera:{node}")
    world.pictures(10)
    before = _rows(world)
    pid = before["capture"][1]
    steps = contextlib.ExitStack()
    heard = steps.enter_context(world.tap())
    for outage, word in enumerate(("stall", "hang", ""), 1):
        if word:
            node.write_text(word)
        else:
            node.unlink()
        world.wait_for(lambda: _rows(world)["capture"] == ("READY", pid, 0), f"word of the {word or 'unplugged'} camera")
        time.sleep(2.2 if word == "hang" else 0.5)  # longer than a stage may be silent
        assert _rows(world)["capture"] == ("READY", pid, 0), "beats go on"
        count = len(world.lines())
        node.write_text("frames")
        assert world.pictures(count + 3)[-1]["epoch"] == outage, "downstream must forget what was before"
        world.wait_for(lambda n=outage: len(heard("camera")) == 2 * n, "word on the tap")
        assert _rows(world)["capture"] == ("RUNNING", pid, 0)
    lost, back = heard("camera")[-2:]
    assert lost["lost"] and not back["lost"] and back["away_s"] > 0.4
    world.wait_for(lambda: "is back after" in heard("notice")[-1]["text"], "last notice")
    texts = [message["text"] for message in heard("notice")]
    assert sum("camera lost, trying again" in text for text in texts) == sum("is back after" in text for text in texts) == 3
    seqs = [line["source_seq"] for line in world.lines()]
    assert seqs == sorted(set(seqs)), "the camera's count goes on"

    node.unlink()  # also unplugged while its process dies: a new process waits for it like the old one
    os.kill(pid, signal.SIGKILL)
    world.wait_for(lambda: _rows(world)["capture"][0::2] == ("READY", 1), "waiting capture")
    count = len(world.lines())
    node.write_text("frames")
    world.pictures(count + 3)
    assert all(_rows(world)[name] == before[name] for name in ("track", "render"))
    node.write_text("stall")
    world.wait_for(lambda: _rows(world)["capture"][0] == "READY", "stall")
    steps.close()
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 0 and "Traceback" not in err and "camera lost, trying again" in err, err


@pytest.mark.native("Video4Linux")
def test_the_last_picture_stays_on_the_screen_with_a_notice(world: World, scene: Path, screen: Screen, tmp_path: Path) -> None:
    node = tmp_path / "video0"
    node.write_text("frames")
    world.module = "tests.faults.scripted_camera"
    world.env["DISPLAY"] = screen.name
    fixed = ("--camera", f"camera:{node}", "--trace", world.trace, "--session", world.name, "--display", "window")
    world.start("up", scene, *fixed, *CAMERA, "--set", "render.anaglyph=colour", "--set", "render.light=gamma")
    world.pictures(5)

    def letters() -> bool:
        return bool((screen.picture() == 255).all(axis=-1).any())

    world.wait_for(lambda: not letters(), "window without a word")
    node.unlink()
    world.wait_for(letters, "notice on the screen")
    last = world.lines()[-1]["view"]
    shown = screen.shown()[-20:, -20:].reshape(-1, 3)
    (left_row, left_col), (right_row, right_col) = last["left"], last["right"]
    wanted = [8 * right_row + 5, 8 * right_col + 5, 8 * (3 * left_row + left_col) + 5]
    assert (shown == wanted).all(), "the last picture stays"
    node.write_text("frames")
    world.wait_for(lambda: not letters(), "window without the notice")


class Made:
    """A camera that opens, reads and fails on command."""

    def __init__(self, steps: list[Any], size: tuple[int, int] = (4, 4)) -> None:
        self.info = SourceInfo("camera:made", 4, 4, 30.0, live=True)
        self.steps, self.seq, self.closed = steps, 0, False

    def read(self, out: np.ndarray) -> Frame | None:
        step = self.steps.pop(0)
        if isinstance(step, Exception):
            raise step
        time.sleep(step)
        out[:] = self.seq + 1
        self.seq += 1
        return Frame(self.seq - 1, self.seq, self.seq)

    def close(self) -> None:
        self.closed = True


def _read(camera: ReconnectingCamera, out: np.ndarray, limit_s: float = 3.0) -> tuple[Frame, list[Exception]]:
    """The next frame and the errors before it."""
    raised: list[Exception] = []
    end = time.monotonic() + limit_s
    while time.monotonic() < end:
        try:
            frame = camera.read(out)
            assert frame is not None
            return frame, raised
        except TimeoutError as error:
            raised.append(error)
    raise AssertionError(f"no frame: {raised}")


def test_frames_count_on_over_connections_and_the_loss_is_told_once() -> None:
    opened: list[Made] = []
    scripts: list[Any] = [[0, 0, UserError("gone")], UserError("no such device"), [0, 0, TimeoutError("stalled"), 0]]

    def open_() -> Made:
        script = scripts.pop(0)
        if isinstance(script, Exception):
            raise script
        opened.append(Made(script))
        return opened[-1]

    camera = ReconnectingCamera(SourceInfo("?", 1, 1, 1.0, live=True), open_)
    assert camera.info.name == "camera:made"
    out = np.zeros((4, 4), np.uint8)
    assert [_read(camera, out)[0].source_seq for _ in range(2)] == [0, 1]
    start = time.monotonic()
    frame, raised = _read(camera, out)
    assert frame.source_seq == 2 and (out == 1).all()
    assert [str(error) for error in raised if isinstance(error, CameraLost)] == ["gone"], "told once, with the first reason"
    assert time.monotonic() - start >= BACKOFF_S + 2 * BACKOFF_S, "each attempt waits twice as long as the one before"
    assert opened[0].closed and not opened[1].closed
    camera.close()
    assert opened[1].closed


def test_what_is_no_fault_of_the_camera_is_not_hidden() -> None:
    def open_() -> Made:
        return Made([ZeroDivisionError("a mistake of ours")])

    camera = ReconnectingCamera(SourceInfo("?", 1, 1, 1.0, live=True), open_)
    with pytest.raises(ZeroDivisionError):
        _read(camera, np.zeros((4, 4), np.uint8))
