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
    FACES,
    SIZE,
    Picture,
    backdrop,
    eye_distance_px,
    near,
    needs_faces,
    placed,
    watched,
)

pytestmark = needs_faces
VIEWER, BYSTANDER, OTHER = "01-1m", "04-1m", "08-1f"
LIDS = (281, 236), (397, 217)  # of the person who blinks


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


def blinking() -> tuple[Picture, Picture]:
    """A person with open eyes, and the same picture with the upper lids closed as four frames
    later.
    """
    video = cv2.VideoCapture(str(next((FACES / "fgnet").glob("*.avi"))))
    frames = [np.asarray(video.read()[1][48:528, 40:680], np.uint8) for _ in range(171)]
    opened, closed = frames[166], frames[170]
    grey, goal = (
        cv2.cvtColor(frame[120:460, 180:480], cv2.COLOR_BGR2GRAY) for frame in (opened, closed)
    )
    still = np.full_like(grey, 255)
    still[70:135] = 0  # all but the eyes
    start = np.eye(2, 3, dtype=np.float32)
    _, found = cv2.findTransformECC(grey, goal, start, cv2.MOTION_AFFINE, inputMask=still)
    warp = np.asarray(found)
    warp[:, 2] = warp[:, 2] + (180, 120) - warp[:, :2] @ (180, 120)
    moved = cv2.warpAffine(
        closed,
        warp,
        SIZE,
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    lids = np.zeros((SIZE[1], SIZE[0]), np.float32)
    for x, y in LIDS:
        cv2.ellipse(lids, (x, y), (34, 20), -10, 0, 360, 1.0, -1)
    share = cv2.GaussianBlur(lids, (0, 0), 4)[..., None]
    return opened, np.asarray(np.rint(share * moved + (1 - share) * opened), np.uint8)


def test_a_blink_moves_the_eyes_less_than_its_lids() -> None:
    opened, closed = blinking()
    seen = watched([opened] * 20 + [closed] * 6)
    before, during = (
        np.mean([one.raw_px for one in some], axis=0) for some in (seen[10:20], seen[21:26])
    )
    assert abs(during[1] - before[1]) < 0.032 * seen[15].eye_distance_px, (
        "the mean over both lids sinks by 4.1 %, this one by 2.6 %"
    )


@pytest.mark.parametrize("person", ["01", "06"])
def test_a_head_that_turns_stays_at_its_distance(person: str) -> None:
    """Seen from the side the eyes stand closer together; the distance that alpha follows must not.

    Both portraits keep the scale of their photographs, which were taken from the same place.
    """
    frontal_px, aside_px = (eye_distance_px(f"{person}-{kind}m") for kind in (1, 3))
    frontal = placed(backdrop(), f"{person}-1m", 300, 220, 60.0)
    aside = placed(backdrop(), f"{person}-3m", 300, 220, 60.0 * aside_px / frontal_px)
    seen = watched([frontal] * 5 + [aside] * 10)
    assert seen[-1].eye_distance_px == pytest.approx(seen[4].eye_distance_px, rel=0.06)


@pytest.mark.parametrize("turn", [90, 180])
def test_a_face_that_does_not_stand_upright_is_a_hint_and_no_viewer(turn: int) -> None:
    engine = LitertEngine()
    picture = placed(backdrop(), VIEWER, 300, 220, 60, -turn)
    hints = []
    for _ in range(40):
        assert engine.detect(picture) is None, "upside down, left is right"
        hints.append(engine.rotated_deg)
    assert set(hints) == {0, turn}, "decided once"


MASKED = [("06-5m", (90, 60, 160), 20), ("10-2m", (200, 190, 170), 10), ("10-1m", (30, 30, 30), 20)]


@pytest.mark.parametrize(("name", "colour", "up_px"), MASKED)
def test_a_face_behind_a_mask_is_found(name: str, colour: tuple[int, int, int], up_px: int) -> None:
    """In a region turned by quarters the network is a trace surer of it; upside down it would be
    surer by far.
    """
    picture = placed(backdrop(), name, 300, 200, 60)
    cv2.ellipse(picture, (300, int(270 - 0.6 * up_px)), (60, 52), 0, 0, 360, colour, -1)
    assert near(watched([picture] * 4)[1:], 300, 200, 8)


@pytest.mark.parametrize("name", ["03-1m", "03-2m", "07-1m"])
def test_a_lying_head_is_no_viewer_or_has_its_own_eyes(name: str) -> None:
    found = {
        roll_deg: LitertEngine().detect(placed(backdrop(), name, 320, 240, 60, roll_deg))
        for roll_deg in (-88, -85, -75, 0, 75, 85)
    }
    assert found[0] is not None
    assert all(face is None or abs(face.lean_deg - deg) < 10 for deg, face in found.items())


# outlines in distances between the eyes, from their middle
MASK = [(-0.95, 0.55), (-0.4, 0.42), (0, 0.32), (0.4, 0.42), (0.95, 0.55), (0.85, 1.35)]
MASK += [(0.45, 1.8), (0, 1.92), (-0.45, 1.8), (-0.85, 1.35)]
FRAME = [(-1.05, -0.32), (1.05, -0.32), (1.05, 0.36), (0.2, 0.36), (0.1, 0.15), (-0.1, 0.15)]
FRAME += [(-0.2, 0.36), (-1.05, 0.36)]
LENS = [(0.14, -0.2), (0.86, -0.2), (0.86, 0.25), (0.2, 0.25)]


def masked_with_glasses(name: str) -> Picture:
    """A person with a shaded mask and red/cyan film glasses, eyes 60 px apart around (300, 200)."""
    face = placed(backdrop(), name, 300, 200, 60).astype(np.float32)
    light = cv2.GaussianBlur(face.mean(axis=2), (0, 0), 15)[..., None]
    light = np.clip(light / max(float(light[248, 300, 0]), 30.0), 0.5, 1.3)
    mirrored = [(-x, y) for x, y in LENS]
    film = 0.75 * face
    for outline, colour in (
        (MASK, light * (200, 170, 120)),
        (FRAME, np.full_like(face, 235)),
        (LENS, film * (0.95, 0.85, 0.08) + 12),
        (mirrored, film * (0.1, 0.1, 0.9) + 12),
    ):
        filled = np.zeros(face.shape[:2], np.float32)
        corners = np.rint(16 * (60 * np.array(outline) + (300, 200))).astype(np.int32)
        cv2.fillPoly(filled, [corners], 1.0, cv2.LINE_AA, 4)
        share = cv2.GaussianBlur(filled, (0, 0), 1)[..., None]
        face += share * (colour - face)
    return np.asarray(np.clip(np.rint(face), 0, 255), np.uint8)


@pytest.mark.parametrize("name", ["03-1m", "04-1m", "10-1m"])
def test_a_face_behind_a_mask_and_film_glasses_is_found(name: str) -> None:
    """The landmark network is not sure of it, but the detector is."""
    assert near(watched([masked_with_glasses(name)] * 15)[1:], 300, 200, 10)


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


def test_a_head_that_moves_behind_an_uncertain_network_is_followed() -> None:
    """Holding ends where the face moves by more than a hand can pull it."""
    dark = [placed(backdrop(), VIEWER, 200 + 6 * max(k - 20, 0), 220, 60) for k in range(50)]
    frames = [
        frame if k < 20 else np.asarray(cv2.GaussianBlur(frame, (0, 0), 5), np.uint8)
        for k, frame in enumerate(dark)
    ]
    seen = watched(frames)
    assert seen[-1].face and np.hypot(*(seen[-1].used_px - (374, 220))) < 12


def test_hands_before_the_face_lose_no_frame() -> None:
    """Everything below the eyes is covered step by step.

    A face that is followed stays, where a new one would not be found.
    """
    followed, found = 0, 0
    for name in ("01-1m", "03-1m", "06-1m"):
        engine = LitertEngine()
        picture = placed(backdrop(), name, 300, 220, 80)
        engine.detect(picture)
        for top_px in range(290, 226, -10):
            picture[top_px:] = (120, 150, 200)
            face = engine.detect(picture)
            assert (
                face is not None
                and np.abs(face.eyes_px.mean(axis=0) - (300, 220)).max() < 0.06 * 80
            )
            followed, found = followed + 1, found + (LitertEngine().detect(picture) is not None)
    assert found < followed
