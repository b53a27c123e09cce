"""The distance between the viewer's eyes from the iris: on made-up faces whose truth is known, and on photographs of people."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from lfpipe.config import Track
from lfpipe.config.camera_pose import EYES_MM
from lfpipe.track.engine import Face, make_engine
from lfpipe.track.eye_distance import IRIS_MM, PLAUSIBLE_MM, EyeDistance
from lfpipe.track.landmarks import FRONTAL
from tests.track.people import FACES, needs_faces, needs_mediapipe

FRAME_NS = 33_333_333
FOCAL_PX = 600.0


def face(apart_mm: float, away_mm: float = 600.0, noise_px: float = 0.0, rng: np.random.Generator | None = None) -> Face:
    """What a pinhole camera makes of a viewer who looks at it from away_mm."""
    per_mm = FOCAL_PX / away_mm
    wrong = (0.0, 0.0) if rng is None else rng.normal(0, noise_px, 2)
    half = (apart_mm * per_mm + wrong[0]) / 2
    eyes = np.array([[320 + half, 240.0], [320 - half, 240.0]])
    return Face(eyes, 1.0, (200.0, 100.0, 440.0, 400.0), IRIS_MM * per_mm + wrong[1])


def learn(subject: EyeDistance, faces: list[Face], start_ns: int = 0) -> list[float]:
    return [subject.update(start_ns + k * FRAME_NS, each) for k, each in enumerate(faces)]


@settings(max_examples=20)
@given(st.floats(50, 75), st.floats(300, 1500))
def test_learnt_within_seconds_whatever_the_distance(apart_mm: float, away_mm: float) -> None:
    rng = np.random.default_rng(0)
    faces = [face(apart_mm * (1 if k % 10 else 3), away_mm + k, 0.1, rng) for k in range(60)]  # one in ten is seen wrongly
    told = learn(EyeDistance(), faces)
    assert not any(told[:20]), "not from a glance"
    assert told[-1] == pytest.approx(apart_mm, abs=1.5)


def test_nothing_is_said_of_what_is_unsteady_implausible_or_unknown() -> None:
    rng = np.random.default_rng(1)
    assert learn(EyeDistance(), [face(mm) for mm in rng.uniform(50, 75, 90)])[-1] == 0
    assert learn(EyeDistance(), [face(120.0)] * 90)[-1] == 0
    plain = face(61.0)
    turned = Face(plain.eyes_px, plain.confidence, plain.box_px)
    assert learn(EyeDistance(), [turned] * 90)[-1] == 0


def test_kept_while_nobody_is_there_and_learnt_anew_of_somebody_else_or_after_the_clock_was_set_back() -> None:
    for start_ns in (10**11, -(10**12)):
        subject = EyeDistance()
        learn(subject, [face(58.0)] * 60)
        if start_ns > 0:
            subject.reset()
        told = learn(subject, [face(67.0)] * 60, start_ns)
        assert told[0] == pytest.approx(58.0) and told[-1] == pytest.approx(67.0)


@settings(max_examples=60)
@given(st.lists(st.tuples(st.integers(-(2**60), 2**60), st.floats(), st.floats()), max_size=80))
def test_nonsense_gives_nothing_or_a_plausible_distance(seen: list[tuple[int, float, float]]) -> None:
    subject = EyeDistance()
    for t_ns, apart_px, iris_px in seen:
        eyes = np.array([[apart_px, 0.0], [0.0, 0.0]])
        told = subject.update(t_ns, Face(eyes, 1.0, (0.0, 0.0, 1.0, 1.0), iris_px))
        assert told == 0 or PLAUSIBLE_MM[0] <= told <= PLAUSIBLE_MM[1]


def photograph(person: int, kind: int) -> NDArray[np.uint8]:
    return np.asarray(cv2.imread(str(next((FACES / "imm").glob(f"{person:02d}-{kind}*.jpg")))), np.uint8)


@needs_faces
@pytest.mark.parametrize("name", ["litert", pytest.param("mediapipe", marks=needs_mediapipe)])
def test_people_have_one_distance_in_all_their_pictures_and_turned_heads_say_nothing(name: str) -> None:
    apart: list[float] = []
    engine = make_engine(Track(engine=name, refine=True))  # type: ignore[arg-type]
    people = range(1, 11) if name == "litert" else (1, 7)
    for person in people:
        found = []
        for kind in (1, 2, 5):  # looking ahead, smiling, lit from the side
            engine.reset()
            face = engine.detect(photograph(person, kind))
            assert face is not None
            found.append(IRIS_MM * float(np.hypot(*(face.eyes_px[0] - face.eyes_px[1]))) / face.iris_px)
        assert max(found) / min(found) < 1.07, (person, found)
        apart.append(float(np.median(found)))
        engine.reset()
        aside = engine.detect(photograph(person, 3))
        assert aside is not None
        assert aside.iris_px == 0, f"turned by more than {FRONTAL}"
    assert np.mean(apart) == pytest.approx(EYES_MM, abs=3.0), "as people are on average"
    assert min(apart) > 50 and max(apart) < 75
    engine.close()
