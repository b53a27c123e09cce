"""Pictures of real people, composed from portraits with known eyes, and the tracking that watches
them.

The portraits are the sample faces beside the checkout; where they are absent, tests that need them
are skipped.
"""

import csv
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

import attrs
import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from lfpipe.config import Track
from lfpipe.eyes import EYES
from lfpipe.track.eye_tracker import EyeTracker
from lfpipe.track.models import has_face_mesh

FACES = Path(__file__).parents[3] / "shared" / "data" / "faces"  # beside the checkout
SIZE = (640, 480)
RATE_HZ = 30.0
needs_mediapipe = pytest.mark.skipif(
    not has_face_mesh(), reason="no mediapipe with FaceMesh for this Python or machine"
)
needs_faces = pytest.mark.skipif(
    not (FACES / "eyes_truth.csv").is_file(), reason=f"the sample faces are not in {FACES}"
)

Picture = NDArray[np.uint8]


@lru_cache(maxsize=1)
def _truth() -> dict[tuple[str, str, str], NDArray[np.float64]]:
    with (FACES / "eyes_truth.csv").open(newline="") as file:
        return {
            (row["set"], row["frame_or_file"].removesuffix(".jpg"), row["kind"]): np.array(
                [
                    [float(row["subject_left_x"]), float(row["subject_left_y"])],
                    [float(row["subject_right_x"]), float(row["subject_right_y"])],
                ]
            )
            for row in csv.DictReader(file)
        }


@lru_cache(maxsize=16)
def portrait(name: str) -> tuple[Picture, NDArray[np.float64]]:
    """A picture of the set imm by its name, as in "03-1m", and its true eyes (2, 2), left first."""
    image = cv2.imread(str(FACES / "imm" / f"{name}.jpg"))
    assert image is not None
    return np.asarray(image, np.uint8), _truth()["imm", name, "contour8_mean"]


@lru_cache(maxsize=4)
def backdrop(seed: int = 1) -> Picture:
    """A room out of focus."""
    rng = np.random.default_rng(seed)
    small = rng.integers(60, 150, (6, 8, 3), dtype=np.uint8)
    return np.asarray(cv2.resize(small, SIZE, interpolation=cv2.INTER_CUBIC), np.uint8)


@lru_cache(maxsize=8)
def _cut_out(name: str, eye_distance_px: float) -> tuple[Picture, NDArray[np.float32]]:
    """A portrait, blurred so that a warp to eye_distance_px does not alias, and the soft mask (H,
    W) of its head.
    """
    head, eyes = portrait(name)
    middle = eyes.mean(axis=0)
    wide = float(np.hypot(*(eyes[0] - eyes[1])))
    mask = np.zeros(head.shape[:2], np.float32)
    oval = (int(middle[0]), int(middle[1] + 0.45 * wide)), (int(1.35 * wide), int(1.95 * wide))
    cv2.ellipse(mask, *oval, 0, 0, 360, 1.0, -1)
    mask = np.asarray(cv2.GaussianBlur(mask, (0, 0), 0.06 * wide), np.float32)
    if eye_distance_px < wide:
        head = np.asarray(cv2.GaussianBlur(head, (0, 0), 0.4 * wide / eye_distance_px), np.uint8)
    return head, mask


def placed(
    picture: Picture, name: str, x: float, y: float, eye_distance_px: float, roll_deg: float = 0.0
) -> Picture:
    """picture with the head of a portrait before it: eyes eye_distance_px apart, their middle at
    (x, y), turned clockwise.
    """
    eyes = portrait(name)[1]
    between = eyes[0] - eyes[1]
    middle = eyes.mean(axis=0)
    wide = float(np.hypot(*between))
    turn = np.deg2rad(roll_deg) - np.arctan2(between[1], between[0])
    c, s = np.cos(turn) * eye_distance_px / wide, np.sin(turn) * eye_distance_px / wide
    matrix = np.array(
        [[c, -s, x - c * middle[0] + s * middle[1]], [s, c, y - s * middle[0] - c * middle[1]]]
    )
    head, mask = _cut_out(name, eye_distance_px)
    share = np.asarray(cv2.warpAffine(mask, matrix, SIZE, flags=cv2.INTER_LINEAR), np.float32)
    drawn = np.asarray(cv2.warpAffine(head, matrix, SIZE, flags=cv2.INTER_LINEAR), np.uint8)
    return np.asarray(cv2.blendLinear(drawn, picture, share, 1 - share), np.uint8)


@attrs.frozen(eq=False, kw_only=True)
class Seen:
    """What tracking made of a frame.

    raw_px, used_px: the point between the eyes, as measured and after the filter.
    """

    face: bool
    raw_px: NDArray[np.float64]
    used_px: NDArray[np.float64]
    eye_distance_px: float
    generation: int


def watched(frames: Iterable[Picture]) -> list[Seen]:
    """What the stage's own engine and tracker make of frames at RATE_HZ, with a little sensor
    noise.
    """
    tracker = EyeTracker(Track())
    record = np.zeros((), EYES)
    seen = []
    rng = np.random.default_rng(7)
    noise = np.asarray(np.rint(rng.normal(0, 2, (SIZE[1] + 97, SIZE[0], 3))), np.int16)
    for k, frame in enumerate(frames):
        shifted = noise[13 * k % 97 :][: frame.shape[0], : frame.shape[1]]
        noisy = (
            np.asarray(cv2.add(frame, shifted, dtype=cv2.CV_8U), np.uint8)
            if frame.shape == shifted.shape
            else frame
        )
        tracker.update(tracker.engine.detect(noisy), round(k * 1e9 / RATE_HZ))
        tracker.write(record, noisy)
        tracker.engine.examine(noisy)
        seen.append(
            Seen(
                face=bool(record["face"]),
                raw_px=record["raw_px"].mean(axis=0),
                used_px=record["filtered_px"].mean(axis=0),
                eye_distance_px=float(record["eye_distance_px"]),
                generation=int(record["generation"]),
            )
        )
    tracker.engine.close()
    return seen


def near(seen: Iterable[Seen], x: float, y: float, within_px: float = 12) -> bool:
    """Whether the viewer is there in all of these frames."""
    return all(one.face and np.hypot(*(one.raw_px - (x, y))) < within_px for one in seen)
