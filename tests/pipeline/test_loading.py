"""Loads of a running session leave no trace in memory; and the playlist of folders and files."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene.packer import playlist
from tests.scene import made
from tests.support.world import World, write_scene


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    with World(tmp_path_factory.mktemp("loading")) as world:
        world.shows(write_scene(world.root / "first"), pictures=3)
        yield world


@pytest.mark.live
def test_a_scene_that_cannot_be_opened_is_stepped_over(tmp_path: Path) -> None:
    scenes = [write_scene(tmp_path / name, 2, 2) for name in ("amber", "birch", "cedar")]
    with World(tmp_path) as world:
        world.shows(*scenes, pictures=3)
        for picture in scenes[1].iterdir():
            picture.write_bytes(b"")
        for at in (2, 0, 2):
            assert world.ask(cmd="load", step=1)["ok"]
            options = world.ask(cmd="hello")["options"]
            assert options["playlist_at"] == at and [*options["unusable"]] == [str(scenes[1])]
        with pytest.raises(UserError, match="not a readable picture"):
            world.ask(cmd="load", at=1)


def mapped(pid: int) -> set[str]:
    """The packs that a process has mapped."""
    lines = Path(f"/proc/{pid}/maps").read_text().splitlines()
    return {line.split("/scenes/")[1].split("/")[0] for line in lines if "/scenes/" in line}


@pytest.mark.live
def test_load_unmaps_the_packs_that_are_left(session: World) -> None:
    scenes = [write_scene(session.root / f"scene{n}", 2, 2 + n) for n in range(3)]
    for scene in scenes:
        assert session.ask(cmd="load", scene=str(scene))["ok"]
    render = psutil.Process(session.ask(cmd="status")["stages"]["render"]["pid"])
    files = []
    for n in range(7):
        assert session.ask(cmd="load", scene=str(scenes[n % 3]))["ok"]
        session.wait_for(
            lambda: len(mapped(render.pid)) <= 1, f"the end of the maps of packs left by load {n}"
        )
        files.append(render.num_fds())
    assert max(files[2:]) - min(files[2:]) <= 2, files


def write_scenes(folder: Path) -> Path:
    """Three light fields of 2, 3 and 4 rows, and a folder that is none."""
    for rows, name in enumerate(("amber", "birch", "cedar"), 2):
        write_scene(folder / name, rows, 3)
    (folder / "notes.txt").write_text("nothing to see")
    (folder / "empty").mkdir()
    return folder


@pytest.mark.everyday
def test_playlist_of_a_folder_and_of_scenes(tmp_path: Path) -> None:
    folder = write_scenes(tmp_path / "scenes")
    settings = config.Scene(cache_dir=str(tmp_path / "cache"))
    names = [folder / name for name in ("amber", "birch", "cedar")]
    assert playlist([folder], settings) == (names, 0)
    assert playlist([names[1], folder, names[0]], settings) == ([names[1], *names, names[0]], 0)
    # one file does not hide the folders beside it
    made.write(folder / "dune_qs3x1a1.5.png", made.mosaic(made.views(1, 3)))
    assert playlist([folder], settings) == (
        [*names, folder / "dune_qs3x1a1.5.png"],
        0,
    )
    # pairs, pictures of both eyes and photographs beside each other
    card = tmp_path / "card"
    left, right = made.views(1, 2)[0]
    for name, picture in (("a-left", left), ("a-right", right), ("plain", left)):
        made.write(card / f"{name}.png", picture)
    made.write(card / "inner" / "b_half_sbs.png", np.hstack([left, right]))
    assert playlist([card], settings) == ([card / "a-left.png", card / "inner"], 1)
    for other in (tmp_path / "nowhere", folder / "empty", folder / "notes.txt"):
        assert playlist([other], settings) == ([other], 0)  # opening it reports the error
