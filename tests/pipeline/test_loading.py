"""Loads of a running session: cancelled, replaced, shown before they are complete, left without a trace in memory; and packs in
use are kept."""

import contextlib
import threading
from pathlib import Path
from typing import Any

import psutil
import pytest
import zmq

from lfpipe.errors import UserError
from lfpipe.transport import control
from tests.scene import made
from tests.world import World, write_scene

pytestmark = pytest.mark.live


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Any:
    world = World(tmp_path_factory.mktemp("loading"))
    world.up(write_scene(world.root / "first"))
    world.pictures(3)
    yield world
    world.end()


def scene_of(world: World) -> dict[str, Any]:
    return dict(world.ask(cmd="hello")["options"]["scene"])


def packing(world: World) -> bool:
    """Whether a packer of this world runs."""
    for process in psutil.process_iter(["cmdline", "environ"]):
        with contextlib.suppress(psutil.Error, KeyError, TypeError):
            if "lfpipe.scene.packer" in process.info["cmdline"] and str(world.root) in str(process.info["environ"]):
                return True
    return False


def slow_scene(folder: Path, views: int = 7) -> Path:
    """Takes seconds: larger than the others, and with disparity to measure."""
    return made.write_grid(folder, made.views(views, views, 256, 320), "input_Cam{n:03d}.png")


def test_a_load_ends_with_its_client(session: World) -> None:
    scene = slow_scene(session.root / "left")
    with control.context() as ctx, ctx.socket(zmq.DEALER) as socket:
        control.connect(socket, session.session_dir, "ctl")
        socket.send(control.encode({"cmd": "load", "scene": str(scene)}))
        session.wait_for(lambda: packing(session), "a packer")
        shown = scene_of(session)["name"]
    if shown == "first":  # else the views were there before the client left
        session.wait_for(lambda: not packing(session), "the packer's end")
        assert scene_of(session)["name"] == "first"


def test_a_second_load_replaces_the_first(session: World) -> None:
    first, second = slow_scene(session.root / "slow", 9), write_scene(session.root / "quick", 2, 2)
    refused: list[str] = []

    def load_first() -> None:
        try:
            session.ask(cmd="load", scene=str(first))
        except UserError as error:
            refused.append(error.message)

    client = threading.Thread(target=load_first)
    client.start()
    session.wait_for(lambda: packing(session), "a packer")
    answer = session.ask(cmd="load", scene=str(second))
    client.join()
    assert answer["ok"] and scene_of(session)["name"] == "quick"
    assert not refused or "another scene" in refused[0], "replaced, or its views were shown for a moment"


def test_views_are_shown_before_the_disparity_and_then_warped(session: World) -> None:
    assert session.ask(cmd="load", scene=str(slow_scene(session.root / "both", 5)))["ok"]
    early = scene_of(session)
    session.wait_for(lambda: scene_of(session)["complete"], "the disparity")
    late = scene_of(session)
    assert not early["complete"] and early["method"] in ("nearest", "blend") and not early["has_disparity"]
    assert late["pack"] == early["pack"] and late["method"].startswith("warp")
    session.wait_for(lambda: session.lines()[-1]["method"].startswith("warp"), "warped pictures")


def mapped(pid: int) -> set[str]:
    """The packs that a process has mapped."""
    lines = Path(f"/proc/{pid}/maps").read_text().splitlines()
    return {line.split("/scenes/")[1].split("/")[0] for line in lines if "/scenes/" in line}


def test_packs_that_are_left_are_unmapped(session: World) -> None:
    scenes = [write_scene(session.root / f"scene{n}", 2, 2 + n) for n in range(3)]
    for scene in scenes:
        assert session.ask(cmd="load", scene=str(scene))["ok"]
    render = psutil.Process(session.ask(cmd="status")["stages"]["render"]["pid"])
    files = []
    for n in range(12):
        assert session.ask(cmd="load", scene=str(scenes[n % 3]))["ok"]
        session.wait_for(lambda: len(mapped(render.pid)) <= 1, f"the end of the maps of packs left by load {n}")
        files.append(render.num_fds())
    assert max(files[3:]) - min(files[3:]) <= 2, files


def test_packs_in_use_are_kept_also_while_no_render_stage_has_them_open(world: World, scene: Path) -> None:
    world.up(scene, "--set", "render.clock=camera")
    world.pictures(5)
    world.kill("render")
    cleaned = world.run("scene", "clean", "--all")
    assert cleaned.returncode == 0 and "in use, kept" in cleaned.stdout and "removed 0 packs" in cleaned.stdout
    world.more_pictures(5)
    world.ctl("stop")
    world.wait_for(lambda: not world.left(), "end of the session")
    assert "removed 1 packs" in world.run("scene", "clean", "--all").stdout
