"""Accuracy of the eyes by condition: light, distance, blur, glasses, roll, mask, turn.

    uv run python profiling/eyes_conditions.py FACES

FACES is the folder of the sample faces: imm/*.jpg with eyes_truth.csv. Every portrait is put into a picture of 640x480, eyes
63 px apart (0.6 m from an ordinary webcam), and spoilt; it is shown for 60 frames, or until it was found and has been followed
for six. found: share of the portraits. NME: mean error of both eyes over their distance, against the contour of the lids. shift:
how far the condition moves the eyes from where the same portrait has them unspoilt, median, in % of their distance.
"""

import csv
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from arguments import existing, parser_of, start
from numpy.typing import NDArray

from lfpipe.track.litert_engine import LitertEngine

Picture = NDArray[np.uint8]
Points = NDArray[np.float64]
WIDTH, HEIGHT, MIDDLE = 640, 480, np.array([320.0, 200.0])


def placed(head: Picture, eyes: Points, apart_px: float, roll_deg: float) -> tuple[Picture, Points]:
    """The portrait in a picture, and its eyes there."""
    between, middle = eyes[0] - eyes[1], eyes.mean(axis=0)
    scale = apart_px / float(np.hypot(*between))
    turn = np.deg2rad(roll_deg) - np.arctan2(between[1], between[0])
    c, s = np.cos(turn) * scale, np.sin(turn) * scale
    linear = np.array([[c, -s], [s, c]])
    matrix = np.column_stack([linear, MIDDLE - linear @ middle])
    if scale < 1:
        head = np.asarray(cv2.GaussianBlur(head, (0, 0), 0.4 / scale), np.uint8)
    out = cv2.warpAffine(head, matrix, (WIDTH, HEIGHT), flags=cv2.INTER_LINEAR, borderValue=(110, 110, 110))
    return np.asarray(out, np.uint8), eyes @ linear.T + matrix[:, 2]


def dark(share: float) -> Callable[[Picture, Points], Picture]:
    def spoil(picture: Picture, eyes: Points) -> Picture:
        return np.clip(np.random.default_rng(1).poisson(picture * share * 2.0) / 2.0, 0, 255).astype(np.uint8)

    return spoil


def blurred(length: int) -> Callable[[Picture, Points], Picture]:
    kernel = np.zeros((length, length), np.float32)
    kernel[length // 2] = 1 / length
    return lambda picture, eyes: np.asarray(cv2.filter2D(picture, -1, kernel), np.uint8)


def sunglasses(picture: Picture, eyes: Points) -> Picture:
    out, wide = picture.copy(), float(np.hypot(*(eyes[0] - eyes[1])))
    for x, y in eyes:
        cv2.ellipse(out, (int(x), int(y + 0.04 * wide)), (int(0.38 * wide), int(0.27 * wide)), 0, 0, 360, (20, 20, 20), -1)
    cv2.line(out, *(tuple(int(v) for v in eye) for eye in eyes), (20, 20, 20), 4)
    return out


def mask(picture: Picture, eyes: Points) -> Picture:
    out, wide = picture.copy(), float(np.hypot(*(eyes[0] - eyes[1])))
    x, y = eyes.mean(axis=0)
    cv2.ellipse(out, (int(x), int(y + 1.15 * wide)), (int(0.85 * wide), int(0.65 * wide)), 0, 0, 360, (200, 190, 170), -1)
    return out


def plain(picture: Picture, eyes: Points) -> Picture:
    return picture


FRONTAL, TURNED = "1256", "34"  # kinds of portrait
CONDITIONS: list[tuple[str, str, float, float, Callable[[Picture, Points], Picture]]] = [
    ("as it is", FRONTAL, 63, 0, plain),
    ("head turned", TURNED, 56, 0, plain),
    ("10 % of the light", FRONTAL, 63, 0, dark(0.1)),
    ("5 % of the light", FRONTAL, 63, 0, dark(0.05)),
    ("1.5 m away", FRONTAL, 25.2, 0, plain),
    ("2.5 m away", FRONTAL, 15.1, 0, plain),
    ("3 m away", FRONTAL, 12.6, 0, plain),
    ("motion blur of 21 px", FRONTAL, 63, 0, blurred(21)),
    ("motion blur of 41 px", FRONTAL, 63, 0, blurred(41)),
    ("head leant by 45 degrees", FRONTAL, 63, 45, plain),
    ("head leant by 70 degrees", FRONTAL, 63, 70, plain),
    ("painted sunglasses", FRONTAL, 63, 0, sunglasses),
    ("painted mask", FRONTAL, 63, 0, mask),
]


def measured(engine: LitertEngine, picture: Picture) -> Points | None:
    engine.reset()
    followed = 0
    for _ in range(60):
        face = engine.detect(picture)
        followed = followed + 1 if face is not None else 0
        if face is not None and followed >= 6:
            return face.eyes_px
    return None


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("faces", type=existing)
    parser.add_argument("--refine", action="store_true")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    engine = LitertEngine(given.refine)
    with (given.faces / "eyes_truth.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["set"] == "imm" and row["kind"] == "contour8_mean"]
    print("| condition | found | NME mean | NME p95 | shift, median % |\n|---|---:|---:|---:|---:|")
    for name, kinds, apart_px, roll_deg, spoil in CONDITIONS:
        errors, shifts, count = [], [], 0
        for row in rows:
            path = Path(row["frame_or_file"])
            if path.stem[3] not in kinds:
                continue
            head = np.asarray(cv2.imread(str(given.faces / "imm" / path.name)), np.uint8)
            names = ("subject_left_x", "subject_left_y", "subject_right_x", "subject_right_y")
            picture, truth = placed(head, np.array([float(row[n]) for n in names]).reshape(2, 2), apart_px, roll_deg)
            clean, found = measured(engine, picture), measured(engine, spoil(picture, truth))
            count += 1
            if found is not None:
                errors.append(float(np.hypot(*(found - truth).T).mean()) / apart_px)
                if clean is not None:
                    shifts.append(100 * float(np.hypot(*(found - clean).T).mean()) / apart_px)
        low = f"{np.mean(errors):.3f} | {np.percentile(errors, 95):.3f} | {np.median(shifts):.1f}" if errors else "- | - | -"
        print(f"| {name} | {100 * len(errors) / max(count, 1):.0f} % | {low} |", flush=True)


if __name__ == "__main__":
    start(main)
