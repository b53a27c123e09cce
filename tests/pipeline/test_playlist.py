"""Several scenes in one session: chosen by command and by the page, with the old one on the screen meanwhile."""

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from lfpipe import config
from lfpipe.scene.packer import playlist
from tests.scene import made
from tests.web.server import served
from tests.world import World, write_scene


def write_scenes(folder: Path) -> Path:
    """Three light fields of 2, 3 and 4 rows, and a folder that is none."""
    for rows, name in enumerate(("amber", "birch", "cedar"), 2):
        write_scene(folder / name, rows, 3)
    (folder / "notes.txt").write_text("nothing to see")
    (folder / "empty").mkdir()
    return folder


@pytest.fixture(scope="module")
def listed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    """A session with a folder of scenes."""
    world = World(tmp_path_factory.mktemp("listed"))
    world.up(write_scenes(world.root / "scenes"))
    world.pictures(3)
    yield world
    world.end()


def shown(world: World) -> tuple[int, int]:
    """The place in the list that the session shows, and the rows of its scene."""
    options = world.ask(cmd="hello")["options"]
    assert len(options["playlist"]) == 3
    return options["playlist_at"], options["scene"]["rows"]


@pytest.mark.everyday
def test_a_folder_of_scenes_is_a_list_and_a_scene_stays_one(tmp_path: Path) -> None:
    folder = write_scenes(tmp_path / "scenes")
    settings = config.Scene(cache_dir=str(tmp_path / "cache"))
    names = [folder / name for name in ("amber", "birch", "cedar")]
    assert playlist([folder], settings) == names
    assert playlist([names[1], folder, names[0]], settings) == [names[1], *names, names[0]]
    made.write(folder / "dune_qs3x1a1.5.png", made.mosaic(made.views(1, 3)))  # one file does not hide the folders beside it
    assert playlist([folder], settings) == [*names, folder / "dune_qs3x1a1.5.png"]
    for other in (tmp_path / "nowhere", folder / "empty", folder / "notes.txt"):
        assert playlist([other], settings) == [other]  # opening it reports the error


@pytest.mark.everyday
def test_the_next_and_the_previous_scene_come_by_command(listed: World) -> None:
    def load(*words: str) -> subprocess.CompletedProcess[str]:
        return listed.run("ctl", "--session", listed.name, "load", *words)

    assert shown(listed) == (0, 2)
    for word, wanted in (("--next", (1, 3)), ("--next", (2, 4)), ("--next", (0, 2)), ("--previous", (2, 4))):
        done = load(word)
        assert done.returncode == 0 and shown(listed) == wanted, done.stderr
    assert load(str(listed.root / "scenes" / "amber")).returncode == 0 and shown(listed) == (0, 2)  # which is in the list
    for words in ((), ("--next", "amber")):
        assert load(*words).returncode == 2


@pytest.mark.live
def test_the_page_has_the_list_and_loads_nothing_else(listed: World) -> None:
    with served(listed) as server:
        for at, rows in ((2, 4), (0, 2)):
            status, answer = server.ask("POST", "/ctl", {"cmd": "load", "at": at})
            assert status == 200 and json.loads(answer)["ok"] and shown(listed) == (at, rows)
        for wrong in ({"at": 3}, {"at": -1}, {"at": True}, {"scene": "/etc"}, {"at": 1, "scene": "/etc"}, {}):
            assert server.ask("POST", "/ctl", {"cmd": "load", **wrong})[0] == 400, wrong
        assert shown(listed) == (0, 2)
