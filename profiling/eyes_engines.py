"""The engine "litert" compared with "mediapipe" on videos of real people.

    python -m profiling.eyes_engines FACES

FACES is a folder with videos/*.mp4. Prints, by video: frames with a face, frames in which only one
engine found one, the longest run of such frames, and the RMS distance of eye centres in px over all
frames and over those with a frontal head. In profile the landmarks of either engine depend on the
region of interest of the previous frame. The last column shows how far mediapipe's own eyes move if
the frames get 1 DN of noise. Accuracy: tests/track/test_people.py. Time per frame: `lfpipe bench
tracker`.
"""

import itertools
from collections.abc import Iterable, Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.track.engine import Engine, Face, MediapipeEngine
from lfpipe.track.litert_engine import LitertEngine
from profiling.arguments import existing, parser_of, start

Picture = NDArray[np.uint8]
Faces = list[Face | None]


def frames(path: Path, noise_dn: int = 0) -> Iterator[Picture]:
    source = cv2.VideoCapture(str(path))
    rng = np.random.default_rng(0)
    while (frame := source.read()[1]) is not None:
        shaken = frame.astype(np.int16) + rng.integers(
            -noise_dn, noise_dn + 1, frame.shape, np.int16
        )
        yield np.clip(shaken, 0, 255).astype(np.uint8)


def run(engine: Engine, pictures: Iterable[Picture]) -> Faces:
    try:
        return [engine.detect(picture) for picture in pictures]
    finally:
        engine.close()


def frontal(face: Face) -> bool:
    """Whether the eyes span a large part of the face's width and the network is confident; in
    profile neither holds.
    """
    x0, _, x1, _ = face.box_px
    return face.confidence > 0.9995 and float(
        np.linalg.norm(face.eyes_px[0] - face.eyes_px[1])
    ) > 0.38 * (x1 - x0)


def eye_distance_px(first: Faces, second: Faces, frontal_only: bool = False) -> float:
    """RMS distance of eye centres where both found a face."""
    pairs = [
        (a, b)
        for a, b in zip(first, second, strict=True)
        if a and b and (frontal(a) or not frontal_only)
    ]
    return float(np.sqrt(np.mean([np.square(a.eyes_px - b.eyes_px).sum(axis=1) for a, b in pairs])))


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("faces", type=existing)
    folder = parser.parse_args().faces / "videos"
    if not folder.is_dir():
        parser.error(f"{folder} does not exist")
    cv2.setNumThreads(1)
    names = ("frames", "litert", "mediap.", "alone", "run", "RMS px", "frontal", "own noise")
    print(f"{'video':34}" + "".join(f"{name:>10}" for name in names))
    for video in sorted(folder.glob("*.mp4")):
        ours, theirs = run(LitertEngine(), frames(video)), run(MediapipeEngine(), frames(video))
        shaken = run(MediapipeEngine(), frames(video, 1))
        alone = [(a is None) != (b is None) for a, b in zip(ours, theirs, strict=True)]
        longest = max(
            (len(list(group)) for state, group in itertools.groupby(alone) if state), default=0
        )
        counts = (
            len(ours),
            *(sum(face is not None for face in faces) for faces in (ours, theirs)),
            sum(alone),
            longest,
        )
        metrics = (
            eye_distance_px(ours, theirs),
            eye_distance_px(ours, theirs, True),
            eye_distance_px(theirs, shaken),
        )
        print(
            f"{video.stem[:33]:34}"
            + "".join(f"{n:10}" for n in counts)
            + "".join(f"{px:10.3f}" for px in metrics),
            flush=True,
        )


if __name__ == "__main__":
    start(main)
