"""Behaviour of people before a camera, in whole sessions: composed videos of real portraits."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from lfpipe.track.litert_engine import LitertEngine
from tests.track.people import FACES, SIZE, Picture, backdrop, eyes_apart_px, middle, needs_faces, placed, watched, write_video
from tests.world import World

pytestmark = needs_faces
VIEWER, BYSTANDER, OTHER = "01-1m", "04-1m", "08-1f"
LIDS = (281, 236), (397, 217)  # of the person who blinks


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


@pytest.mark.parametrize(
    ("name", "apart_px"), [("02-1m", 25.0), ("05-1m", 19.0), ("08-1f", 15.0), ("02-1m", 12.6), ("05-1m", 12.6), ("08-1f", 12.6)]
)
def test_a_viewer_is_found_from_1_to_3_m(world: World, scene: Path, name: str, apart_px: float) -> None:
    video = write_video(world.root / "v.avi", [placed(backdrop(), name, 250, 190, apart_px)] * 60)
    lines = watched(world, scene, video)
    seen = [line for line in lines if line["face"]]
    assert len(seen) >= 20 and lines[-1]["face"], "found within a second and kept"
    assert np.hypot(*(middle(lines[-1]) - (250, 190))) < 0.15 * apart_px


def passing(who: str, apart_px: float, step_px: float) -> Iterator[Picture]:
    """The viewer sits; a passer-by crosses the picture, hides the viewer for a moment, and stays at the side for 4 s."""
    x = 700.0
    for k in range(150 + int(600 / step_px)):
        frame = placed(backdrop(), VIEWER, 260, 220, 55)
        x = max(x - step_px, 100.0) if k >= 30 else x
        yield placed(frame, who, x, 215, apart_px)


@pytest.mark.parametrize(("who", "apart_px", "step_px"), [(OTHER, 62, 12), ("04-1m", 66, 4), ("09-1m", 70, 8)])
def test_a_passer_by_does_not_keep_the_picture(world: World, scene: Path, who: str, apart_px: float, step_px: float) -> None:
    lines = watched(world, scene, write_video(world.root / "v.avi", passing(who, apart_px, step_px)))
    assert all(np.hypot(*(middle(line) - (260, 220))) < 12 for line in lines[-45:])


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


def blinking() -> tuple[Picture, Picture]:
    """A person with open eyes, and the same picture with the upper lids closed as four frames later."""
    video = cv2.VideoCapture(str(next((FACES / "fgnet").glob("*.avi"))))
    frames = [np.asarray(video.read()[1][48:528, 40:680], np.uint8) for _ in range(171)]
    opened, closed = frames[166], frames[170]
    grey = [cv2.cvtColor(frame[120:460, 180:480], cv2.COLOR_BGR2GRAY) for frame in (opened, closed)]
    still = np.full_like(grey[0], 255)
    still[70:135] = 0  # all but the eyes
    _, warp = cv2.findTransformECC(*grey, np.eye(2, 3, dtype=np.float32), cv2.MOTION_AFFINE, inputMask=still)
    warp[:, 2] += (180, 120) - warp[:, :2] @ (180, 120)
    moved = cv2.warpAffine(closed, warp, SIZE, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE)
    share = np.zeros((SIZE[1], SIZE[0]), np.float32)
    for x, y in LIDS:
        cv2.ellipse(share, (x, y), (34, 20), -10, 0, 360, 1.0, -1)
    share = cv2.GaussianBlur(share, (0, 0), 4)[..., None]
    return opened, np.asarray(np.rint(share * moved + (1 - share) * opened), np.uint8)


def test_a_blink_moves_the_eyes_less_than_its_lids(world: World, scene: Path) -> None:
    opened, closed = blinking()
    lines = watched(world, scene, write_video(world.root / "v.avi", [opened] * 30 + [closed] * 6 + [opened] * 10))
    before, during = (np.mean([middle(line) for line in part], axis=0) for part in (lines[20:30], lines[31:36]))
    apart_px = abs(lines[25]["eyes_raw"]["left"][0] - lines[25]["eyes_raw"]["right"][0])
    assert abs(during[1] - before[1]) < 0.032 * apart_px, "the mean over both lids sinks by 4.1 %, this one by 2.6 %"


@pytest.mark.parametrize("person", ["01", "03", "06", "09"])
def test_a_head_that_turns_stays_at_its_distance(world: World, scene: Path, person: str) -> None:
    """Seen from the side the eyes stand closer together; alpha, which follows the viewer's distance, must not.

    Both portraits keep the scale of their photographs, which were taken from the same place.
    """
    frontal_px, aside_px = (eyes_apart_px(f"{person}-{kind}m") for kind in (1, 3))
    frontal = placed(backdrop(), f"{person}-1m", 300, 220, 60.0)
    aside = placed(backdrop(), f"{person}-3m", 300, 220, 60.0 * aside_px / frontal_px)
    lines = watched(world, scene, write_video(world.root / "v.avi", [frontal] * 60 + [aside] * 150))

    def alpha_px(line: dict[str, Any]) -> float:
        return abs(line["eyes_used"]["left"][0] - line["eyes_used"]["right"][0]) / abs(
            line["view"]["left"][1] - line["view"]["right"][1]
        )

    assert alpha_px(lines[-1]) == pytest.approx(alpha_px(lines[55]), rel=0.05)


@pytest.mark.parametrize("turn", [90, 180, 270])
def test_a_camera_mounted_otherwise_is_set_right(world: World, scene: Path, turn: int) -> None:
    """Frames as they come from a camera turned so; camera.rotate gives back the upright picture, and its eyes."""
    upright = placed(backdrop(), VIEWER, 300, 220, 60)
    code = {90: cv2.ROTATE_90_COUNTERCLOCKWISE, 180: cv2.ROTATE_180, 270: cv2.ROTATE_90_CLOCKWISE}[turn]
    frames = [np.asarray(cv2.rotate(upright, code), np.uint8)] * 20
    size = [f"camera.{name}_px={value}" for name, value in zip(("height", "width"), frames[0].shape, strict=False)]
    lines = watched(world, scene, write_video(world.root / "v.avi", frames), f"camera.rotate={turn}", *size)
    assert sum(line["face"] for line in lines) >= 18
    assert np.hypot(*(middle(lines[-1]) - (300, 220))) < 5
    assert lines[-1]["eyes_raw"]["left"][0] > lines[-1]["eyes_raw"]["right"][0] + 40


def test_a_mirroring_driver_is_set_right(world: World, scene: Path) -> None:
    frames = [np.ascontiguousarray(placed(backdrop(), VIEWER, 200, 220, 60)[:, ::-1])] * 20
    lines = watched(world, scene, write_video(world.root / "v.avi", frames), "camera.mirror=true")
    assert np.hypot(*(middle(lines[-1]) - (200, 220))) < 5


@pytest.mark.parametrize("turn", [90, 180, 270])
def test_a_face_that_does_not_stand_upright_is_a_hint_and_no_viewer(world: World, scene: Path, turn: int) -> None:
    video = write_video(world.root / "v.avi", [placed(backdrop(), VIEWER, 300, 220, 60, -turn)] * 60)
    process = world.up(scene, "--set", "render.clock=camera", camera=f"file:{video}?loop=0&pace=max")
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0 and f"camera.rotate={turn}" in out + err
    assert not any(line["face"] for line in world.lines()), "upside down, left is right"


def test_dark_glasses_leave_refined_eyes_where_the_lids_are() -> None:
    """The iris network answers whatever it is shown: behind painted glasses its answers for the two eyes disagree."""
    worse = []
    for name in ("01-1m", "02-1m", "03-1m", "05-1m", "06-1m", "09-1m"):
        picture = placed(backdrop(), name, 300, 220, 80)
        for x in (260, 340):
            cv2.ellipse(picture, (x, 223), (30, 21), 0, 0, 360, (20, 20, 20), -1)
        plain, refined = (LitertEngine(refine=refine) for refine in (False, True))
        faces = [[engine.detect(picture) for _ in range(6)][-1] for engine in (plain, refined)]
        assert faces[0] is not None and faces[1] is not None
        off = [float(np.abs(face.eyes_px.mean(axis=0) - (300, 220)).max()) for face in faces if face is not None]
        worse.append(off[1] > off[0] + 4)
    assert sum(worse) <= 1


def test_glare_on_glasses_moves_refined_eyes_no_further_than_plain_ones() -> None:
    for name in ("01-1m", "03-1m", "06-1m"):
        picture = placed(backdrop(), name, 300, 220, 80)
        for x in (260, 340):
            cv2.ellipse(picture, (x + 6, 218), (20, 13), -20, 0, 360, (255, 255, 255), -1)
        faces = [[engine.detect(picture) for _ in range(3)][-1] for engine in (LitertEngine(), LitertEngine(refine=True))]
        plain, refined = (float(np.abs(face.eyes_px.mean(axis=0) - (300, 220)).max()) for face in faces if face is not None)
        assert refined < plain + 1 and refined < 0.06 * 80


def test_hands_before_the_face_lose_no_frame() -> None:
    """Everything below the eyes is covered step by step. A face that is followed stays, where a new one would not be found."""
    followed, found = 0, 0
    for name in ("01-1m", "03-1m", "06-1m"):
        engine, picture = LitertEngine(), placed(backdrop(), name, 300, 220, 80)
        engine.detect(picture)
        for top_px in range(290, 226, -10):
            picture[top_px:] = (120, 150, 200)
            face = engine.detect(picture)
            assert face is not None and np.abs(face.eyes_px.mean(axis=0) - (300, 220)).max() < 0.06 * 80
            followed, found = followed + 1, found + (LitertEngine().detect(picture) is not None)
    assert found < followed


def test_who_walks_in_from_the_side_and_sits_down_sees_the_middle(world: World, scene: Path) -> None:
    """The first sight of a viewer is no neutral position: they would look from beyond the grid for the rest of the session."""
    places = [(40 + 280 * k / 30, 30 + 30 * k / 30) for k in range(30)] + [(320.0, 60.0)] * 120
    video = write_video(world.root / "v.avi", (placed(backdrop(), VIEWER, x, 220, apart) for x, apart in places))
    process = world.up(scene, "--set", "render.clock=camera", camera=f"file:{video}?loop=0")
    _, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    line = world.lines()[-1]
    (row, left), (_, right) = line["view"]["left"], line["view"]["right"]
    assert abs((left + right) / 2 - 1) < 0.1 and abs(row - 1) < 0.1 and right > left
