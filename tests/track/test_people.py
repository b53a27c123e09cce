"""Behaviour of people before a camera: real portraits in composed pictures, tracked as the stage
tracks them.
"""

from collections.abc import Callable, Iterable, Iterator
from functools import partial

import cv2
import numpy as np
import pytest

from lfpipe.track.litert_engine import LitertEngine
from tests.track.people import (
    Picture,
    backdrop,
    near,
    needs_faces,
    placed,
    watched,
)

pytestmark = needs_faces
VIEWER, BYSTANDER, OTHER = "01-1m", "04-1m", "08-1f"


def poster(picture: Picture, seed: int, x: int, y: int, side: int) -> Picture:
    """A drawn face that the detector takes for one and the landmark network does not."""
    rng = np.random.default_rng(seed)
    drawn = np.empty((side, side, 3), np.uint8)
    drawn[:] = rng.integers(60, 200, 3)
    c = side // 2
    skin, dark = (
        tuple(int(v) for v in rng.integers(low, high, 3)) for low, high in ((120, 255), (0, 70))
    )
    cv2.ellipse(drawn, (c, c), (int(side * 0.32), int(side * 0.4)), 0, 0, 360, skin, -1)
    for sign in (-1, 1):
        place = (
            c + sign * int(side * rng.uniform(0.11, 0.15)),
            c - int(side * rng.uniform(0.08, 0.14)),
        )
        cv2.circle(drawn, place, int(side * rng.uniform(0.03, 0.06)), dark, -1)
    lips = int(side * 0.14), int(side * rng.uniform(0.02, 0.06))
    cv2.ellipse(
        drawn, (c, c + int(side * 0.17)), lips, 0, 0, 180, dark, -1 if rng.random() < 0.5 else 4
    )
    if rng.random() < 0.5:
        cv2.line(drawn, (c, c - 5), (c, c + int(side * 0.06)), dark, 3)
    out = picture.copy()
    out[y : y + side, x : x + side] = cv2.GaussianBlur(drawn, (0, 0), rng.uniform(0.5, 6))
    return out


@pytest.mark.parametrize(
    ("name", "eye_distance_px"), [("02-1m", 25.0), ("08-1f", 15.0), ("05-1m", 12.6)]
)
def test_a_viewer_is_found_from_1_to_3_m(name: str, eye_distance_px: float) -> None:
    seen = watched([placed(backdrop(), name, 250, 190, eye_distance_px)] * 45)
    assert sum(one.face for one in seen) >= 10 and near(seen[-1:], 250, 190, 0.15 * eye_distance_px)


def before_a_poster(seed: int) -> list[Picture]:
    """The poster is larger and more central than the viewer, so it is tried first."""
    return [placed(poster(backdrop(), seed, 60, 150, 180), VIEWER, 480, 220, 40)] * 10


def passing() -> Iterator[Picture]:
    """The viewer sits; a passer-by crosses the picture, hides the viewer for a moment, and stays at
    the side for 4 s.
    """
    for k in range(200):
        frame = placed(backdrop(), VIEWER, 260, 220, 55)
        yield placed(frame, OTHER, max(700.0 - 12 * max(k - 29, 0), 100.0), 215, 62)


def returning() -> Iterator[Picture]:
    """The viewer leaves for 6 s, while a bystander behind is in the picture, and comes back to
    another place.
    """
    for k in range(290):
        frame = placed(backdrop(), BYSTANDER, 480, 180, 26)
        yield frame if 30 <= k < 210 else placed(frame, VIEWER, 260 if k < 30 else 330, 230, 62)


def beside_a_photograph() -> Iterator[Picture]:
    """A photograph on the wall; after 3 s somebody walks in, sits down beside it, and sways."""
    wall = placed(backdrop(), BYSTANDER, 360, 170, 50)
    for k in range(210):
        x = min(-60 + 12 * max(k - 90, 0), 180) + 3 * np.sin(k / 12)
        yield placed(wall, VIEWER, x, 270, 52) if k >= 90 else wall


def joined(
    first: tuple[float, ...], second: tuple[float, ...], *names: str, frames: int = 80
) -> list[Picture]:
    """One person alone for 40 frames, then another one, too; each at x, y, apart."""
    alone = placed(backdrop(), names[0], *first)
    return [alone] * 40 + [placed(alone, names[1], *second)] * frames


# what happens, and in which of its frames the viewer is where, within how many px
STORIES: dict[str, tuple[Callable[[], Iterable[Picture]], list[tuple[slice, int, int, int]]]] = {
    **{
        f"a poster ({seed})": (partial(before_a_poster, seed), [(slice(2, None), 480, 220, 8)])
        for seed in (6, 39)
    },
    "a passer-by does not keep the picture": (passing, [(slice(-45, None), 260, 220, 12)]),
    "a bystander gives way to the viewer who comes back elsewhere": (
        returning,
        [(slice(70, 200), 480, 180, 12), (slice(-30, None), 330, 230, 12)],
    ),
    "who sits down in front of a bystander is the viewer": (
        partial(joined, (440, 190, 26), (300, 240, 65), BYSTANDER, VIEWER),
        [(slice(10, 40), 440, 190, 12), (slice(-20, None), 300, 240, 12)],
    ),
    # at 3 and 2 m, where only the far detector sees them
    "a nearer person takes over far away, too": (
        partial(joined, (150, 190, 12), (420, 210, 18.5), "02-1m", "05-1m"),
        [(slice(30, 40), 150, 190, 5), (slice(-10, None), 420, 210, 5)],
    ),
    "two equals never change places": (
        partial(joined, (230, 220, 50), (420, 220, 54), VIEWER, OTHER, frames=130),
        [(slice(0, None), 230, 220, 12)],
    ),
    "a photograph gives way to a living viewer": (
        beside_a_photograph,
        [(slice(10, 90), 360, 170, 12), (slice(-30, None), 180, 270, 12)],
    ),
}


@pytest.mark.parametrize("story", STORIES)
def test_the_viewer_among_several_faces(story: str) -> None:
    """Somebody is better than nobody, until somebody better comes."""
    frames, places = STORIES[story]
    seen = watched(frames())
    assert [place for place in places if not near(seen[place[0]], *place[1:])] == []


@pytest.mark.parametrize("turn", [90, 180])
def test_a_face_that_does_not_stand_upright_is_a_hint_and_no_viewer(turn: int) -> None:
    engine = LitertEngine()
    picture = placed(backdrop(), VIEWER, 300, 220, 60, -turn)
    hints = []
    for _ in range(40):
        assert engine.detect(picture) is None, "upside down, left is right"
        hints.append(engine.rotated_deg)
    assert set(hints) == {0, turn}, "decided once"


def test_a_photograph_stays_out_after_recentre() -> None:
    engine = LitertEngine()
    for frame in beside_a_photograph():
        engine.detect(frame)
        engine.examine(frame)
    engine.reset()  # recentre
    again = engine.detect(frame)
    assert again is not None and abs(again.eyes_px[:, 0].mean() - 180) < 12


@pytest.mark.parametrize("name", ["01-1m", "06-1m", "09-1m"])
def test_a_hand_before_the_face_does_not_pull_the_eyes(name: str) -> None:
    """A hand sweeps across the face and away; landmarks follow it by up to a third of the distance
    between the eyes.
    """
    picture = placed(backdrop(), name, 300, 220, 60)
    frames = []
    for x in range(520, 100, -10):
        frames.append(picture.copy())
        cv2.ellipse(frames[-1], (x, 250), (45, 70), 0, 0, 360, (110, 140, 190), -1)
    seen = watched([picture] * 30 + frames + [picture] * 30)
    pulled = [float(np.hypot(*(one.used_px - (300, 220)))) for one in seen if one.face]
    assert max(pulled) < 0.14 * 60 and pulled[-1] < 2
