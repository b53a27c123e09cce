"""The window's thread for a person's files: it lists folders, and saves settings before the end."""

import contextlib
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from lfpipe.config.user_files import write_keys
from lfpipe.render.display.display import Event
from lfpipe.render.ui.files import Files
from lfpipe.render.ui.scenes import MAX_LISTED, Content, folder_menu, list_folder
from lfpipe.scene.demo import demo_scene
from lfpipe.scene.recent_scenes import remember_scene
from tests.support.refusal import refusal


@pytest.fixture
def files() -> Iterator[Files]:
    context: Any = SimpleNamespace(saving=lambda work: contextlib.nullcontext())
    made = Files(context)
    yield made
    made.close()


def test_files_saves_in_order_what_was_asked_for_just_before_the_end(
    files: Files, tmp_path: Path
) -> None:
    path = tmp_path / "config.toml"
    path.write_text("# mine\n[render]\nmethod = 'warp'\n")
    for values in ({"swap_eyes": True}, {"anaglyph": "mono"}):
        files.do(partial(write_keys, path, "render", values))
    files.close()
    assert path.read_text() == (
        "# mine\n[render]\nmethod = 'warp'\nswap_eyes = true\nanaglyph = \"mono\"\n"
    )


def test_files_passes_on_results_and_refusals(files: Files, tmp_path: Path) -> None:
    path = tmp_path / "config.toml"
    path.write_text("[render")
    done: list[object] = []
    files.do(lambda: 5, done.append)
    files.do(partial(write_keys, path, "render", {"depth": 1.0}), done.append)
    files.close()
    (error,) = files.serve()
    assert f"{path}: depth not saved" in error.message and error.remedy
    assert done == [5] and path.read_text() == "[render" and not list(files.serve())


def test_list_folder_has_what_there_is_to_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("b10", "b9", ".hidden"):
        (tmp_path / name).mkdir()
    for name in ("view_10.png", "view_2.PNG", "film.mp4", "field.h5", "notes.txt", ".thumb.png"):
        (tmp_path / name).touch()
    scenes = ["field.h5", "film.mp4", "view_2.PNG", "view_10.png"]
    found = Content(tmp_path, ["b9", "b10"], scenes)
    assert list_folder(tmp_path) == found
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / ".state"))
    monkeypatch.setenv("HOME", str(tmp_path / "b9"))
    assert list_folder(None).folder == tmp_path / "b9", "at home"
    remember_scene(tmp_path / "film.mp4")
    remember_scene(demo_scene(tmp_path / "b10"))
    assert list_folder(None) == found, "where the last scene is that is no demo"
    assert "gone: cannot be read: No such file" in str(refusal(list_folder, tmp_path / "gone"))


@pytest.mark.parametrize(("folders", "files"), [(5, MAX_LISTED), (MAX_LISTED + 2, 3), (0, 3)])
def test_folder_menu_has_a_limit_and_says_what_is_left_out(folders: int, files: int) -> None:
    one, other = ([f"{k}" for k in range(count)] for count in (folders, files))
    menu = folder_menu(Content(Path("/f"), one, other), {})
    listed = sum(not item.row for item in menu.items)
    assert listed == min(folders + files, MAX_LISTED)
    left = folders + files - listed
    assert any(f"{left} more" in item.label for item in menu.items) == bool(left)


def test_views_of_a_scene_are_offered_as_one(tmp_path: Path) -> None:
    for name in (*(f"view_{k:02d}.png" for k in range(25)), "pair.mpo", "quilt_4x8.png"):
        (tmp_path / name).touch()
    content = list_folder(tmp_path)
    assert content == Content(tmp_path, [], ["pair.mpo", "quilt_4x8.png"], 25)
    first, *others = folder_menu(content, {}).items
    assert first.label == "Open these 25 pictures as one scene"
    assert first.event == Event("load", str(tmp_path))
    assert [item.label for item in others if not item.row] == content.scenes
