"""`SceneLoads` with real packers."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
import zmq

from lfpipe.config import Scene, SceneSummary
from lfpipe.errors import UserError
from lfpipe.scene.pack import PackerRequest
from lfpipe.supervisor import control_sockets
from lfpipe.supervisor.control_sockets import Load, Request, SceneLoads
from tests.support.world import write_scene

CLIENT = Request(b"client", message={"cmd": "load"})
LIMIT_S = 120


@pytest.fixture
def settings(tmp_path: Path) -> Scene:
    return Scene(cache_dir=str(tmp_path / "cache"))


@pytest.fixture
def news() -> list[dict[str, Any]]:
    """What the stage that shows pictures is sent."""
    return []


@pytest.fixture
def loads(news: list[dict[str, Any]]) -> Iterator[SceneLoads]:
    made = SceneLoads(news.append)
    yield made
    made.close()


Event = tuple[Load, SceneSummary | Exception]


def _ends(event: Event) -> bool:
    return isinstance(event[1], Exception) or event[1].complete


def wanted(scene: Path, settings: Scene) -> PackerRequest:
    return PackerRequest(scenes=[scene], settings=settings, remember=True)


def events(loads: SceneLoads) -> list[Event]:
    """What happens until a packer has ended."""
    happened: list[Event] = []
    end = time.monotonic() + LIMIT_S
    while not any(map(_ends, happened)):
        assert time.monotonic() < end
        poller = zmq.Poller()
        for fd in loads.fds:
            poller.register(fd, zmq.POLLIN)
        poller.poll(20)
        happened += loads.events()
    assert not loads.fds
    return happened


def test_scene_loads_make_a_scene_ready_then_complete(
    loads: SceneLoads,
    news: list[dict[str, Any]],
    scene: Path,
    settings: Scene,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(control_sockets, "STEP_NS", 0)
    assert loads.want(CLIENT, wanted(scene, settings)) is None
    happened = events(loads)
    assert happened[0][0].request is CLIENT and isinstance(happened[0][1], SceneSummary)
    assert all(load.request is None for load, _ in happened[1:])
    last = happened[-1][1]
    assert isinstance(last, SceneSummary) and last.complete
    steps = [message["step"] for message in news]
    assert all(message["cmd"] == "loading" for message in news) and steps[-1] == ""


def test_scene_loads_replace_the_first_request(
    loads: SceneLoads, scene: Path, settings: Scene, tmp_path: Path
) -> None:
    loads.want(CLIENT, wanted(scene, settings))
    other = Request(b"other")
    assert loads.want(other, wanted(tmp_path / "nowhere", settings)) is CLIENT
    ((load, scene_or_error),) = events(loads)
    assert load.request is other and isinstance(scene_or_error, UserError)


def test_a_load_that_cannot_start_leaves_the_one_before(
    loads: SceneLoads, settings: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its client was never answered."""
    loads.want(CLIENT, wanted(write_scene(tmp_path / "first", 1, 2), settings))
    with monkeypatch.context() as patched:
        patched.setattr(
            control_sockets, "Packing", Mock(side_effect=UserError("no memory", "end one"))
        )
        with pytest.raises(UserError, match="no memory"):
            loads.want(Request(b"other"), wanted(tmp_path / "second", settings))
    assert next(load.request for load, _ in events(loads)) == CLIENT
