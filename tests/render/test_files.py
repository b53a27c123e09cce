"""The window's thread for a person's files: it lists folders, and saves settings before the end."""

import contextlib
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from lfpipe.config.check import write_keys
from lfpipe.render.ui.scenes import Content, list_folder
from lfpipe.render.ui.settings import Files
from lfpipe.scene.pack import demo_scene, remember_scene
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
