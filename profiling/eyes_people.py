"""Steps of the view when people come, go and are exchanged: the simulator of `lfpipe bench viewer`
with real heads and the real networks in place of synthetic faces.

    python -m profiling.eyes_people FACES [--device-latency-ms 80]

FACES holds imm/*.jpg, eyes_truth.csv, no_face/*.jpg, fgnet/*.avi and videos/*.mp4. Heads cut out of
portraits take the places of the people of the scripts, over a blurred scene in pictures of 640x480,
with noise of 2 grey levels. The columns are those of `bench viewer`, against the same truth.

Then the same viewer before recordings, whose truth is not known. Steps of the view between two
pictures: all, and those within 0.2 s of a face that was lost or found. `lfpipe bench viewer --track
CSV` does that for recorded eyes.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.simulator.camera import TRACKED_MS, Camera, Frame, Observer
from lfpipe.bench.simulator.metrics import viewpoint_metrics
from lfpipe.bench.simulator.run import Run, Screen, Setup, Truth, watch
from lfpipe.bench.simulator.scripts import (
    SCRIPTS,
    SEAT,
    SETTLED_S,
    Move,
    Script,
    after,
    path,
    person,
    settled,
    swayed,
)
from lfpipe.render.viewer.presence import RestingEyes
from lfpipe.track.engine import Face
from lfpipe.track.litert_engine import LitertEngine
from profiling.arguments import existing, parser_of, start
from profiling.eyes_conditions import Picture, Portrait, portraits
from profiling.eyes_engines import frames

WIDTH, HEIGHT = 640, 480
CHANGE_MS = 200.0  # steps so near to a face that was lost or found
COLUMNS = ("step_cols", "step_rows", "error_views", "right_s", "depth")
SIDE_SEAT = (450.0, 250.0, 55.0)
OWN = (
    Script(
        name="leans out, another sits down",
        people=(
            person(
                path(10.0, SEAT, Move(3.0, 4.3, (470, 240, 60)), Move(4.3, 5.2, (760, 240, 60)))
            ),
            person(path(10.0, (-80, 240, 70), Move(4.0, 5.5, (200, 240, 70)))),
        ),
        windows=(settled(3.0), after(5.5 + SETTLED_S, 10.0, RestingEyes(200, 240, 70), person=1)),
    ),
    Script(
        name="out, back elsewhere at once",
        people=(
            person(path(9.0, SEAT, Move(2.0, 3.0, (700, 240, 60)), Move(3.5, 4.1, (420, 240, 70)))),
        ),
        windows=(after(4.1, 9.0),),  # within the grid: a lean, no new seat
    ),
    Script(
        name="found at the lower border",
        people=(
            person(path(9.0, (320, 560, 60), Move(1.0, 2.5, (320, 440, 60)), Move(3.0, 4.5, SEAT))),
        ),
        windows=(after(4.5 + SETTLED_S, 9.0),),
        steps_from_s=0.0,
    ),
    Script(
        name="portrait of 75 px first",
        people=(
            person(path(16.0, (250, 180, 75)), still=True),
            person(
                swayed(
                    path(16.0, (760, 250, 55), Move(3.0, 4.2, SIDE_SEAT)),
                    reach_px=12.0,
                    rate_hz=0.5,
                    up=0.0,
                    from_s=4.2,
                )
            ),
        ),
        windows=(after(7.2, 16.0, RestingEyes(*SIDE_SEAT), person=1),),
    ),
    Script(
        name="a passer-by before",
        people=(
            person(swayed(path(10.0, SEAT), 15.0, 0.5, up=0.0)),
            person(path(10.0, (-110, 240, 95), Move(3.0, 4.2, (760, 240, 95), even=True))),
        ),
        windows=(settled(3.0), after(4.6, 10.0)),
    ),
    Script(
        name="three people",
        people=(
            person(swayed(path(8.0, SEAT), 15.0, 0.5, up=0.0)),
            person(path(8.0, (150, 300, 60))),
            person(path(8.0, (490, 250, 55))),
        ),
        windows=(settled(8.0),),
    ),
)


class Cut(NamedTuple):
    """A head without its surroundings: blue, green, red, times share, and share. eyes: (2, 2)."""

    light: NDArray[np.float32]
    eyes: NDArray[np.float64]

    @classmethod
    def of(cls, head: Portrait) -> "Cut":
        own_px = float(np.hypot(*(head.eyes[0] - head.eyes[1])))
        x, y = head.eyes.mean(axis=0)
        mask = np.zeros(head.head.shape[:2], np.float32)
        at = round(x), round(y + 0.35 * own_px)
        cv2.ellipse(mask, at, (round(1.2 * own_px), round(1.75 * own_px)), 0, 0, 360, 1.0, -1)
        share = cv2.GaussianBlur(mask, (0, 0), 0.06 * own_px)[..., None]
        rows, cols = np.nonzero(share[..., 0] > 0)
        box = slice(rows.min(), rows.max() + 1), slice(cols.min(), cols.max() + 1)
        light = np.concatenate([head.head * share, share], axis=2)[box]
        return cls(light.astype(np.float32), head.eyes - (cols.min(), rows.min()))

    def pasted(
        self, scene: NDArray[np.float32], eyes_px: NDArray[np.float64]
    ) -> NDArray[np.float32]:
        """The scene with the head whose eyes are at eyes_px, (2, 2)."""
        (du, dv), (dx, dy) = self.eyes[0] - self.eyes[1], eyes_px[0] - eyes_px[1]
        square = du * du + dv * dv
        cos, sin = (dx * du + dy * dv) / square, (dy * du - dx * dv) / square
        turn = np.array([[cos, -sin], [sin, cos]])
        matrix = np.column_stack([turn, eyes_px.mean(axis=0) - turn @ self.eyes.mean(axis=0)])
        soft = cv2.GaussianBlur(self.light, (0, 0), max(0.4 / math.hypot(cos, sin), 0.3))
        drawn = cv2.warpAffine(soft, matrix, (WIDTH, HEIGHT))
        return np.asarray(scene * (1 - drawn[..., 3:]) + drawn[..., :3], np.float32)


class Portraits(Observer):
    """Sees the people of a script, with heads of portraits, before a scene."""

    def __init__(self, script: Script, heads: list[Cut], scene: NDArray[np.float32]) -> None:
        super().__init__(LitertEngine())
        self._people = list(zip(script.people, heads, strict=False))
        self._scene = scene
        self._random = np.random.default_rng(3)
        noise = self._random.normal(0, 2, (2 * HEIGHT, 2 * WIDTH, 3))
        self._noise = noise.astype(np.float32)

    def picture(self, frame: Frame) -> Picture:
        picture = self._scene
        for someone, head in self._people:
            at = min(round(frame.ms), len(someone.path_px) - 1)
            if someone.logit[at] > 0 and -200 < someone.path_px[at, 0] < WIDTH + 200:
                picture = head.pasted(picture, someone.eyes_px(at))
        y, x = self._random.integers(0, (HEIGHT, WIDTH)).tolist()
        noisy = picture + self._noise[y : y + HEIGHT, x : x + WIDTH]
        return np.asarray(np.clip(noisy, 0, 255), np.uint8)


class Film(Observer):
    """Sees a video. found: (ms, whether there is a face) of each frame."""

    def __init__(self, pictures: Iterator[Picture]) -> None:
        super().__init__(LitertEngine())
        self._pictures = pictures
        self._newest = next(pictures)
        self.found: list[tuple[float, bool]] = []

    def picture(self, frame: Frame) -> Picture:
        newest = self._newest
        self._newest = next(self._pictures, newest)
        return newest

    def look(self, frame: Frame) -> tuple[Face | None, Picture]:
        face, picture = super().look(frame)
        self.found.append((frame.ms, face is not None))
        return face, picture


def script_row(script: Script, observer: Observer, setup: Setup) -> str:
    run = watch(setup, observer, script.count_ms / 1e3)
    metrics = viewpoint_metrics(run, Truth(setup, script), script)
    cells = [f"{metrics[key]:.2f}" if key in metrics else "" for key in COLUMNS]
    return f"| {script.name} | {' | '.join(cells)} |"


def film_row(film: Path, screen: Screen) -> str:
    source = cv2.VideoCapture(str(film))
    rate_hz = source.get(cv2.CAP_PROP_FPS)
    observer = Film(frames(film))
    setup = Setup(camera=Camera(rate_hz=rate_hz), screen=screen)
    run: Run = watch(setup, observer, source.get(cv2.CAP_PROP_FRAME_COUNT) / rate_hz)
    ms, faces = (np.array(column) for column in zip(*observer.found, strict=True))
    changes_ms = ms[1:][faces[1:] != faces[:-1]] + TRACKED_MS + screen.device_latency_ms
    steps = np.abs(np.diff(run.views, axis=0)).max(axis=(1, 2))
    near = (np.abs(run.ms[1:, None] - changes_ms) < CHANGE_MS).any(axis=1)
    at_change = f"{steps[near].max():.2f}" if near.any() else "-"
    return (
        f"| {film.stem[:24]} | {len(steps)} | {len(changes_ms)} | {steps[~near].max():.2f} |"
        f" {at_change} | {np.percentile(steps, 99):.2f} | {100 * (steps > 0.5).mean():.2f} |"
    )


def main() -> None:
    parser = parser_of(__doc__, device_latency_ms=Screen().device_latency_ms)
    parser.add_argument("faces", type=existing)
    given = parser.parse_args()
    cv2.setNumThreads(1)
    heads = [Cut.of(portrait) for portrait in portraits(given.faces, "1")]
    room = np.asarray(cv2.imread(str(sorted((given.faces / "no_face").glob("*.jpg"))[0])), np.uint8)
    scene = np.asarray(cv2.GaussianBlur(cv2.resize(room, (WIDTH, HEIGHT)), (0, 0), 6), np.float32)
    setup = Setup(screen=Screen(device_latency_ms=given.device_latency_ms))
    print(
        f"| {given.device_latency_ms:.0f} ms | step | up and down | error, mean | until right, s |"
        f" full depth, % |\n|---|{'---:|' * 5}"
    )
    for script in (*(script for script in SCRIPTS if not script.glitches), *OWN):
        print(script_row(script, Portraits(script, heads, scene), setup), flush=True)
    print(
        f"\n| recording, {given.device_latency_ms:.0f} ms | pictures | lost or found |"
        f" step, tracked | step, lost or found | p99 | > .5, % |\n|---|{'---:|' * 6}"
    )
    folder: Path = given.faces
    for film in sorted([*folder.glob("videos/*.mp4"), *folder.glob("fgnet/*.avi")]):
        print(film_row(film, setup.screen), flush=True)


if __name__ == "__main__":
    start(main)
