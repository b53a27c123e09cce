"""Choosing a scene by its picture: every scene can be reached, by keys and by the place where it is drawn."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfpipe import config
from lfpipe.render.thumbnails import STEPS, Thumbnails
from lfpipe.render.window_system import pygame
from lfpipe.scene.recent_scenes import forget_scene, recent_scenes, remember_scene

KEYS = st.lists(st.sampled_from([*STEPS, "next", "previous"]), max_size=30)


@settings(max_examples=20)
@given(st.integers(1, 40), st.tuples(st.integers(120, 1400), st.integers(120, 900)), KEYS, st.booleans())
def test_the_selected_scene_is_on_the_page_and_its_cell_gives_it_back(
    count: int, room_px: tuple[int, int], keys: list[str], camera: bool
) -> None:
    pygame.font.init()
    shown = Thumbnails([f"/nowhere/scene {k}" for k in range(count)], count // 2, config.Scene(), camera)
    if camera:
        shown.camera(np.zeros((480, 640, 3), np.uint8), "a face")
    for key in keys:
        shown.draw(room_px)
        assert shown.move(key) and 0 <= shown.at < count
    assert shown.draw(room_px).get_size() == room_px
    places = {shown.scene_at(x, y) for x in range(0, room_px[0], 10) for y in range(0, room_px[1], 10)}
    assert shown.at in places and places - {None} <= set(range(count))


def test_every_scene_is_reached_by_one_key_each_way() -> None:
    pygame.font.init()
    shown = Thumbnails([f"/nowhere/{k}" for k in range(25)], 0, config.Scene())
    shown.draw((900, 600))
    for key, there in (("more", list(range(1, 25))), ("less", list(range(23, -1, -1)))):
        assert [shown.move(key) and shown.at for _ in there] == [pytest.approx(k) for k in there]
    assert not shown.move("mode")


def test_a_scene_taken_off_is_gone_and_the_next_is_selected(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    scenes = [tmp_path / name for name in "abc"]
    for scene in scenes:
        scene.mkdir()
        remember_scene(scene)
    shown = Thumbnails([str(scene) for scene in scenes], 1, config.Scene())
    assert shown.remove() == str(scenes[1]) and shown.scenes[shown.at] == str(scenes[2])
    forget_scene(scenes[1])
    assert recent_scenes() == [scenes[2], scenes[0]] and scenes[1].is_dir()
