"""Scenes of the playlist, chosen on the page."""

import json
from collections.abc import Iterator

import pytest

from tests.extras.web.server import served
from tests.pipeline.test_loading import running, shown, write_scenes
from tests.support.world import World


@pytest.fixture
def listed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    """A session with a folder of scenes."""
    yield from running(tmp_path_factory.mktemp("listed"), "scenes", write_scenes)


@pytest.mark.live
def test_page_loads_from_the_playlist_alone(listed: World) -> None:
    with served(listed) as server:
        for at, rows in ((2, 4), (0, 2)):
            status, answer = server.ask("POST", "/ctl", {"cmd": "load", "at": at})
            assert status == 200 and json.loads(answer)["ok"] and shown(listed) == (at, rows)
        for wrong in (
            {"at": 3},
            {"at": -1},
            {"at": True},
            {"scene": "/etc"},
            {"at": 1, "scene": "/etc"},
            {},
        ):
            assert server.ask("POST", "/ctl", {"cmd": "load", **wrong})[0] == 400, wrong
        assert shown(listed) == (0, 2)
