"""Which events end a session: failures of a stage, and changes that a stage cannot apply."""

from pathlib import Path
from typing import Any

from lfpipe.errors import UserError
from tests.support.world import World, write_scene

CAMERA = ("--set", "render.clock=camera", "--set", "render.method=nearest")


def _ask(world: World, **message: Any) -> dict[str, Any]:
    """The answer to a command, or its error."""
    try:
        return world.ask(**message)
    except UserError as error:
        return {"error": str(error)}


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
