"""The engine "litert" compared with "mediapipe" on pictures of real people: agreement, and accuracy against annotated eyes.

    uv run python profiling/eyes_engines.py FACES [--refine]

FACES is a folder with videos/*.mp4, fgnet/*.avi, imm/*.jpg, no_face/* and eyes_truth.csv. Prints two tables:

1. Agreement on the videos: frames with a face, frames in which only one engine found one, the longest run of such frames, and the
   RMS distance of eye centres over all frames and over those with a frontal head. In profile the landmarks of either engine
   depend on the region of interest of the previous frame. The last column shows how far mediapipe's own eyes move if the frames
   get 1 DN of noise.
2. Accuracy: error of the worse eye over the distance between the eyes (Jesorsky et al. 2001), misses counted as failures; faces
   found where there are none.

Time per frame: `lfpipe bench tracker`.
"""

import csv
import itertools
from collections.abc import Iterable, Iterator
from pathlib import Path

import cv2
import numpy as np
from arguments import existing, parser_of, start
from numpy.typing import NDArray

from lfpipe.track.engine import Engine, Face
from lfpipe.track.litert_engine import LitertEngine
from lfpipe.track.mediapipe_engine import MediapipeEngine

Picture = NDArray[np.uint8]
Faces = list[Face | None]
NAMES = ("litert", "mediapipe")


def make(name: str, refine: bool = False) -> Engine:
    return LitertEngine(refine) if name == "litert" else MediapipeEngine(refine)


def frames(path: Path) -> Iterator[Picture]:
    source = cv2.VideoCapture(str(path))
    while (frame := source.read()[1]) is not None:
        yield np.asarray(frame, np.uint8)


def noisy(pictures: Iterable[Picture]) -> Iterator[Picture]:
    rng = np.random.default_rng(0)
    for picture in pictures:
        shaken = picture.astype(np.int16) + rng.integers(-1, 2, picture.shape, np.int16)
        yield np.clip(shaken, 0, 255).astype(np.uint8)


def run(name: str, pictures: Iterable[Picture]) -> Faces:
    engine = make(name)
    try:
        return [engine.detect(picture) for picture in pictures]
    finally:
        engine.close()


def apart(first: Faces, second: Faces, sure: Faces | None = None) -> tuple[float, int, int]:
    """RMS distance of eye centres in px if both found a face (a frontal one if sure is given); frames in which only one did;
    longest run of them."""
    pairs = list(zip(first, second, sure or first, strict=True))
    squares = [np.square(a.eyes_px - b.eyes_px).sum(axis=1) for a, b, c in pairs if a and b and c and (not sure or frontal(c))]
    lone = [(a is None) != (b is None) for a, b, _ in pairs]
    longest = max((len(list(run_)) for state, run_ in itertools.groupby(lone) if state), default=0)
    return float(np.sqrt(np.mean(squares))), sum(lone), longest


def frontal(face: Face) -> bool:
    """Whether the eyes span a large part of the face's width and the network is confident; in profile neither holds."""
    x0, _, x1, _ = face.box_px
    return face.confidence > 0.9995 and float(np.linalg.norm(face.eyes_px[0] - face.eyes_px[1])) > 0.38 * (x1 - x0)


def agreement(folder: Path) -> None:
    print(
        f"{'video':34}{'frames':>7}{'litert':>8}{'mediap.':>8}{'alone':>7}{'run':>5}{'RMS px':>9}{'frontal':>9}{'own noise':>11}"
    )
    for video in sorted((folder / "videos").glob("*.mp4")):
        ours, theirs = run("litert", frames(video)), run("mediapipe", frames(video))
        shaken = run("mediapipe", noisy(frames(video)))
        rms, lone, longest = apart(ours, theirs)
        counts = [sum(face is not None for face in found) for found in (ours, theirs)]
        print(f"{video.stem[:33]:34}{len(ours):7}{counts[0]:8}{counts[1]:8}{lone:7}{longest:5}", end="")
        print(f"{rms:9.3f}{apart(ours, theirs, ours)[0]:9.3f}{apart(theirs, shaken)[0]:11.3f}")


def truths(folder: Path, wanted: str, kind: str) -> dict[str, NDArray[np.float64]]:
    with (folder / "eyes_truth.csv").open() as file:
        return {
            row["frame_or_file"]: np.array(
                [[float(row[f"subject_{side}_{axis}"]) for axis in "xy"] for side in ("left", "right")]
            )
            for row in csv.DictReader(file)
            if row["set"] == wanted and row["kind"] == kind
        }


def accuracy(folder: Path, refine: bool) -> None:
    print(f"\n{'set, truth':28}{'engine':12}{'median e':>10}{'p95':>8}{'<= .05':>9}{'<= .10':>9}{'missed':>8}")
    for wanted, kind in (("fgnet", "contour4_mean"), ("fgnet", "pupil"), ("imm", "contour8_mean")):
        truth = truths(folder, wanted, kind)
        for name in NAMES:
            engine, errors = make(name, refine), []
            if wanted == "fgnet":
                pictures = ((str(i), frame) for i, frame in enumerate(frames(next((folder / "fgnet").glob("*.avi")))))
            else:
                pictures = ((key, np.asarray(cv2.imread(str(folder / "imm" / key)), np.uint8)) for key in truth)
            for key, picture in pictures:
                if wanted == "imm":
                    engine.reset()  # pictures of different people
                face, true = engine.detect(picture), truth[key]
                between = float(np.linalg.norm(true[0] - true[1]))
                errors.append(np.inf if face is None else float(np.linalg.norm(face.eyes_px - true, axis=1).max()) / between)
            engine.close()
            e = np.array(errors)
            shares = [f"{100 * (e <= bound).mean():8.1f}%" for bound in (0.05, 0.10)]
            middle = f"{np.median(e):10.4f}{np.percentile(e, 95):8.4f}"
            print(f"{wanted + ' ' + kind:28}{name:12}{middle}{''.join(shares)}{np.isinf(e).sum():8}")
    paths = sorted(path for path in (folder / "no_face").iterdir() if path.suffix.lower() in (".jpg", ".png"))
    for name in NAMES:
        engine, false = make(name), []
        for path in paths:
            engine.reset()
            if any(engine.detect(np.asarray(cv2.imread(str(path)), np.uint8)) for _ in range(3)):
                false.append(path.name)
        engine.close()
        print(f"no_face, {len(paths)} pictures: {name} saw {len(false)} {' '.join(false)}")


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("faces", type=existing)
    parser.add_argument("--refine", action="store_true", help="only the accuracy table, with the iris networks")
    given = parser.parse_args()
    missing = [name for name in ("videos", "fgnet", "imm", "no_face", "eyes_truth.csv") if not (given.faces / name).exists()]
    if missing:
        parser.error(f"{given.faces} does not hold {', '.join(missing)}")
    cv2.setNumThreads(1)
    if not given.refine:
        agreement(given.faces)
    accuracy(given.faces, given.refine)


if __name__ == "__main__":
    start(main)
