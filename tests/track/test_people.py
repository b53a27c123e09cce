"""What people do before a camera, in whole sessions: composed videos of real portraits."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.track.people import Picture, backdrop, middle, needs_faces, placed, watched, write_video
from tests.world import World

pytestmark = needs_faces
VIEWER, BYSTANDER, OTHER = "01-1m", "04-1m", "08-1f"


def poster(picture: Picture, seed: int, x: int, y: int, side: int) -> Picture:
    """A drawn face that the detector takes for one and the landmark network does not."""
    rng, drawn = np.random.default_rng(seed), np.empty((side, side, 3), np.uint8)
    drawn[:] = rng.integers(60, 200, 3)
    c = side // 2
    skin, dark = (tuple(int(v) for v in rng.integers(low, high, 3)) for low, high in ((120, 255), (0, 70)))
    cv2.ellipse(drawn, (c, c), (int(side * 0.32), int(side * 0.4)), 0, 0, 360, skin, -1)
    for sign in (-1, 1):
        place = c + sign * int(side * rng.uniform(0.11, 0.15)), c - int(side * rng.uniform(0.08, 0.14))
        cv2.circle(drawn, place, int(side * rng.uniform(0.03, 0.06)), dark, -1)
    lips = int(side * 0.14), int(side * rng.uniform(0.02, 0.06))
    cv2.ellipse(drawn, (c, c + int(side * 0.17)), lips, 0, 0, 180, dark, -1 if rng.random() < 0.5 else 4)
    if rng.random() < 0.5:
        cv2.line(drawn, (c, c - 5), (c, c + int(side * 0.06)), dark, 3)
    out = picture.copy()
    out[y : y + side, x : x + side] = cv2.GaussianBlur(drawn, (0, 0), rng.uniform(0.5, 6))
    return out


@pytest.mark.parametrize("seed", [6, 18, 20, 39])
def test_a_viewer_beside_a_poster_is_found(world: World, scene: Path, seed: int) -> None:
    """The poster is larger and more central than the viewer, so it is tried first."""
    video = write_video(world.root / "v.avi", [placed(poster(backdrop(), seed, 60, 150, 180), VIEWER, 480, 220, 40)] * 20)
    lines = watched(world, scene, video)
    assert sum(line["face"] for line in lines) >= 18
    assert all(np.hypot(*(middle(line) - (480, 220))) < 8 for line in lines if line["face"])


@pytest.mark.parametrize("apart_px", [25.0, 19.0, 15.0, 12.6])
@pytest.mark.parametrize("name", ["02-1m", "05-1m", "08-1f"])
def test_a_viewer_is_found_from_1_to_3_m(world: World, scene: Path, apart_px: float, name: str) -> None:
    video = write_video(world.root / "v.avi", [placed(backdrop(), name, 250, 190, apart_px)] * 60)
    lines = watched(world, scene, video)
    seen = [line for line in lines if line["face"]]
    assert len(seen) >= 20 and lines[-1]["face"], "found within a second and kept"
    assert np.hypot(*(middle(lines[-1]) - (250, 190))) < 0.15 * apart_px


def passing() -> Iterator[Picture]:
    """The viewer sits; a passer-by of the same size walks through the picture, hides the viewer, and stays at the side."""
    for k in range(150):
        frame = placed(backdrop(), VIEWER, 260, 220, 55)
        x = 700 - 12 * max(0, k - 30)
        yield placed(frame, OTHER, max(x, 100), 215, 62) if k >= 30 else frame


def test_a_passer_by_does_not_keep_the_picture(world: World, scene: Path) -> None:
    lines = watched(world, scene, write_video(world.root / "v.avi", passing()))
    assert all(np.hypot(*(middle(line) - (260, 220))) < 12 for line in lines[-30:])


def returning() -> Iterator[Picture]:
    """The viewer leaves for 6 s, while a bystander behind is in the picture, and comes back to another place."""
    for k in range(330):
        frame = placed(backdrop(), BYSTANDER, 480, 180, 26)
        yield frame if 60 <= k < 240 else placed(frame, VIEWER, 260 if k < 60 else 330, 230, 62)


def test_a_bystander_gives_way_to_the_viewer_who_comes_back_elsewhere(world: World, scene: Path) -> None:
    lines = watched(world, scene, write_video(world.root / "v.avi", returning()))
    assert all(np.hypot(*(middle(line) - (480, 180))) < 12 for line in lines[100:230]), "somebody is better than nobody"
    assert all(np.hypot(*(middle(line) - (330, 230))) < 12 for line in lines[-30:])


@pytest.mark.parametrize(("behind", "before"), [("04-1m", "01-1m"), ("08-1f", "06-1m"), ("05-1m", "08-1f")])
def test_who_sits_down_in_front_of_a_bystander_is_the_viewer(world: World, scene: Path, behind: str, before: str) -> None:
    frames = [placed(backdrop(), behind, 440, 190, 26)] * 40
    frames += [placed(frames[0], before, 300, 240, 65)] * 80
    lines = watched(world, scene, write_video(world.root / "v.avi", frames))
    assert all(np.hypot(*(middle(line) - (440, 190))) < 12 for line in lines[10:40])
    assert all(np.hypot(*(middle(line) - (300, 240))) < 12 for line in lines[-20:])


def test_two_equals_never_change_places(world: World, scene: Path) -> None:
    frames = [placed(backdrop(), VIEWER, 230, 220, 50)] * 10
    both = placed(frames[0], OTHER, 420, 220, 54)
    lines = watched(world, scene, write_video(world.root / "v.avi", frames + [both] * 200))
    assert all(np.hypot(*(middle(line) - (230, 220))) < 12 for line in lines)
