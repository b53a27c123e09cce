"""Which events end a session: failures of a stage, and changes that a stage cannot apply."""

import signal
from pathlib import Path
from typing import Any

import pytest

from lfpipe.errors import UserError
from lfpipe.transport import control
from tests.support.world import World, connected, write_scene

CAMERA = ("--set", "render.clock=camera", "--set", "render.method=nearest")


def _ask(world: World, **message: Any) -> dict[str, Any]:
    """The answer to a command, or its error."""
    try:
        return world.ask(**message)
    except UserError as error:
        return {"error": str(error)}


def test_stage_that_fails_five_times_ends_the_session(world: World, scene: Path) -> None:
    world.module = "tests.faults.picky_render"
    process = world.up(scene, *CAMERA, "--set", "render.device_latency_ms=9")
    _, err = process.communicate(timeout=120)
    assert process.returncode == 1 and not world.left(), err
    last = err[err.index("error: ") :]
    assert (
        "render failed 5 times in 60 s, last in RUNNING with exit code 1, after source_seq" in last
    )
    assert (
        "its last stack:" in last
        and "ZeroDivisionError: show at 9" in last
        and "picky_render.py" in last
    )
    assert err.count("render ended with exit code 1 in RUNNING; restarting") == 4


def test_set_is_taken_whole_or_rolled_back(world: World, scene: Path, tmp_path: Path) -> None:
    world.module = "tests.faults.picky_render"
    process = world.shows(scene, *CAMERA)
    before = _ask(world, cmd="status")["config"]
    wrong = {"render.swap_eyes": True, "render.alpha_px": -4}
    assert "render.alpha_px" in _ask(world, cmd="set", set=wrong)["error"]
    assert _ask(world, cmd="status")["config"] == before
    for device_latency_ms in (7, 8):  # acknowledged, and then it failed
        for _ in range(3):  # more failures in total than end an unattended session
            _ask(
                world,
                cmd="set",
                set={"render.swap_eyes": True, "render.device_latency_ms": device_latency_ms},
            )
            world.wait_for(
                lambda: _ask(world, cmd="status").get("config") == before, "configuration as it was"
            )
    world.more_pictures(3)
    accepted = {"render.swap_eyes": True, "render.device_latency_ms": 6}
    world.wait_for(lambda: _ask(world, cmd="set", set=accepted)["applied"], "the stages' answers")
    assert "error" not in _ask(world, cmd="load", scene=str(write_scene(tmp_path / "other", 1, 5)))
    assert world.more_pictures(3)[-1]["view"]["left"][0] == 0
    _ask(world, cmd="stop")
    _, err = process.communicate(timeout=120)  # with the stacks of a stage that failed
    assert process.returncode == 0, err
    assert (
        err.count("the last change is rolled back: render.device_latency_ms = 7: not for me") == 3
    )
    assert err.count("the last change is rolled back: render fails with it") == 3


@pytest.mark.live
def test_stage_that_dies_with_a_setting_undoes_it_and_nothing_else(
    world: World, scene: Path
) -> None:
    """What is refused is undone, and what was done is not called refused."""
    world.shows(scene, *CAMERA)
    before = world.ask(cmd="hello")
    with connected(world.session_dir) as client:
        world.kill("render", signal.SIGSTOP)
        for message in (
            {"cmd": "set", "set": {"render.swap_eyes": True}},
            {"cmd": "pause"},
            {"cmd": "pictures", "lease_s": 60},
        ):
            client.send(control.encode(message))
        world.wait_for(lambda: world.ask(cmd="hello")["options"]["pictures"], "the last one")
        world.kill("render")
        answers: dict[str, bool] = {}
        while len(answers) < 3:
            assert client.poll(60_000), answers
            answer = control.decode(client.recv())
            answers[answer["cmd"]] = answer["ok"]
    assert answers == {"set": False, "pause": True, "pictures": True}
    after = world.ask(cmd="hello")
    assert after["config"] == before["config"]
    assert after["paused"] and after["options"]["pictures"]
