"""Steps of the view when people come, go and are exchanged: real heads before a made camera.

    python -m profiling.eyes_people FACES [--tracks FOLDER] [--loop-ms 80]

FACES holds imm/*.jpg, eyes_truth.csv, no_face/*.jpg, fgnet/*.avi and videos/*.mp4. Heads cut out of
portraits move over a blurred scene in pictures of 640x480, with noise of 2 grey levels, 30 Hz,
through engine, tracker and viewer in one process; a grid of 9x9 views without disparity (4 views
between the eyes), 60 pictures a second, eyes known 10 ms after their frame.

step, up and down: the largest step of an eye's view between two pictures that no head's motion
within 0.1 s explains, in views; the depth that appears with the first face is none. right: share of
the pictures whose eyes are those of the viewer meant, within 0.7 of their distance. late: seconds
from the time stated in the script until that holds for 0.2 s and both eyes look from within one
view of where they look from in the end.

Then the same viewer on recordings: the videos by the engine, and with --tracks FOLDER recorded eyes
(*.csv, see eyes_tracks). Steps of the view between two pictures: all, and those within 0.2 s of a
face that was lost or found.
"""

import csv
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Config, Render, Track
from lfpipe.eyes import EYES, EyesRecord
from lfpipe.render.viewer import Viewer
from lfpipe.scene.lightfield import Geometry, LightField
from lfpipe.track.engine import Face
from lfpipe.track.eye_tracker import EyeTracker
from profiling.arguments import existing, parser_of, start

Picture = NDArray[np.uint8]
Float = NDArray[np.float64]
Place = tuple[float, float, float]  # between the eyes, and their distance, px
Path3 = Callable[[float], Place | None]  # where a head is after so many seconds; None: not there
WIDTH, HEIGHT = 640, 480
CAMERA_HZ, SCREEN_HZ = 30, 60
AGE_S, BEGUN_S = 0.010, 0.008  # eyes are known so late; a picture is begun so long before its blank
VIEWS = 4.0  # between the eyes
EXPLAINED_S = 0.1
T0_NS = 10**12
NAMES = ("subject_left_x", "subject_left_y", "subject_right_x", "subject_right_y")


class Head(NamedTuple):
    picture: Picture
    eyes: Float  # (2, 2): left and right, px


class Case(NamedTuple):
    """paths: of the heads, in the order of drawing. viewer: index of who should be followed, by
    time. at_s: the event that `late` counts from; NaN: none.
    """

    name: str
    seconds: float
    paths: tuple[Path3, ...]
    viewer: Callable[[float], int | None]
    at_s: float = math.nan


def along(*points: tuple[float, float, float, float]) -> Path3:
    """Through places (s, x, y, apart) by straight lines; not there before the first, and there for
    ever after the last one. x outside the picture is outside.
    """
    t, x, y, apart = np.array(points).T

    def place(t_s: float) -> Place | None:
        if t_s < t[0]:
            return None
        return tuple(float(np.interp(t_s, t, v)) for v in (x, y, apart))  # type: ignore[return-value]

    return place


def only(index: int) -> Callable[[float], int | None]:
    return lambda t_s: index


def cases() -> Iterator[Case]:
    seat = (320.0, 240.0, 58.0)
    walks = along((0, 320, 240, 87), (2, 320, 240, 87), (2.72, 680, 240, 87))
    yield Case("D1 walks out at 500 px/s", 6, (walks,), only(0))
    leans = along((0, *seat), (3, *seat), (4.3, 470, 240, 58), (5.2, 760, 240, 58))
    other = along((4.0, -80, 240, 70), (5.5, 200, 240, 70))
    yield Case("D2 leans out, another sits down", 10, (leans, other), lambda t: int(t > 5.4), 5.4)
    half = along(
        (0, *seat), (2, *seat), (3, 630, 240, 58), (4.2, 630, 240, 58), (5.2, *seat), (9, *seat)
    )
    yield Case("D2 half out and back", 9, (half,), only(0), 5.2)
    near = along(
        (0, *seat), (2, *seat), (3.0, 700, 240, 58), (3.5, 700, 240, 58), (4.1, 420, 240, 70)
    )
    yield Case("D2 out, back at another place", 9, (near,), only(0), 4.1)
    edge = along(
        (0, 700, 240, 58),
        (1, 700, 240, 58),
        (2.0, 610, 240, 58),
        (3, 610, 240, 58),
        (5, 320, 240, 58),
    )
    yield Case("D3 found at the border", 8, (edge,), only(0), 5.0)
    below = along(
        (0, 320, 560, 58), (1, 320, 560, 58), (2.5, 320, 440, 58), (3, 320, 440, 58), (4.5, *seat)
    )
    yield Case("D3 found at the lower border", 8, (below,), only(0), 4.5)
    for gone_s in (2.0, 12.0):
        back_s = 4.0 + gone_s
        back = along(
            (0, *seat),
            (3, *seat),
            (4, -80, 240, 58),
            (back_s - 0.1, -80, 240, 58),
            (back_s, 720, 240, 58),
            (back_s + 0.8, 430, 240, 58),
        )
        name = f"D4 leaves at the left, back from the right after {gone_s:.0f} s"
        yield Case(name, back_s + 6, (back,), only(0), back_s + 0.8)
    comes = along((0.5, -60, 240, 58), (0.95, 320, 240, 58))
    yield Case("D4 walks in at 1 m/s", 6, (comes,), only(0), 0.95)
    poster = along((0, 300, 180, 42))
    sits = along(
        (3.0, 760, 250, 52),
        (4.2, 400, 250, 52),
        *((4.2 + 0.25 * k, 400 + 12 * math.sin(k), 250, 52) for k in range(1, 50)),
    )
    yield Case("D5 poster of 42 px first", 16, (poster, sits), lambda t: int(t > 4.2), 4.2)
    large = along((0, 250, 180, 75))
    beside = along(
        (3.0, 760, 250, 55),
        (4.2, 450, 250, 55),
        *((4.2 + 0.25 * k, 450 + 12 * math.sin(k), 250, 55) for k in range(1, 50)),
    )
    yield Case("D5 poster of 75 px first", 16, (large, beside), lambda t: int(t > 4.2), 4.2)
    sways = along(
        (0, *seat), *((0.1 * k, 320 + 15 * math.sin(0.3 * k), 240, 58) for k in range(1, 120))
    )
    behind = along((3, -60, 200, 35), (7, 700, 200, 35))
    yield Case("a passer-by behind", 10, (behind, sways), only(1))
    before = along((3, -110, 240, 95), (4.2, 760, 240, 95))
    yield Case("a passer-by before", 10, (sways, before), only(0), 4.6)
    child = along((2, 150, 300, 60))
    third = along((2, 490, 250, 55))
    yield Case("three people", 8, (child, third, sways), only(2))


def heads(folder: Path) -> list[Head]:
    """The frontal portraits."""
    out = []
    with (folder / "eyes_truth.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            path = folder / "imm" / Path(row["frame_or_file"]).name
            if row["set"] == "imm" and row["kind"] == "contour8_mean" and path.stem[3] == "1":
                eyes = np.array([float(row[name]) for name in NAMES]).reshape(2, 2)
                out.append(Head(np.asarray(cv2.imread(str(path)), np.uint8), eyes))
    return out


class Cut(NamedTuple):
    """A head without its surroundings: blue, green, red, times share, and share. eyes: as Head."""

    light: NDArray[np.float32]
    eyes: Float

    @classmethod
    def of(cls, head: Head) -> "Cut":
        own_px = float(np.hypot(*(head.eyes[0] - head.eyes[1])))
        x, y = head.eyes.mean(axis=0)
        mask = np.zeros(head.picture.shape[:2], np.float32)
        at = round(x), round(y + 0.35 * own_px)
        cv2.ellipse(mask, at, (round(1.2 * own_px), round(1.75 * own_px)), 0, 0, 360, 1.0, -1)
        share = cv2.GaussianBlur(mask, (0, 0), 0.06 * own_px)[..., None]
        rows, cols = np.nonzero(share[..., 0] > 0)
        box = slice(rows.min(), rows.max() + 1), slice(cols.min(), cols.max() + 1)
        light = np.concatenate([head.picture * share, share], axis=2)[box]
        return cls(light.astype(np.float32), head.eyes - (cols.min(), rows.min()))

    def pasted(self, scene: NDArray[np.float32], place: Place) -> NDArray[np.float32]:
        """The scene with the head at a place."""
        x, y, apart_px = place
        scale = apart_px / float(np.hypot(*(self.eyes[0] - self.eyes[1])))
        middle = self.eyes.mean(axis=0)
        matrix = np.array([[scale, 0, x - scale * middle[0]], [0, scale, y - scale * middle[1]]])
        soft = cv2.GaussianBlur(self.light, (0, 0), max(0.4 / scale, 0.3))
        drawn = cv2.warpAffine(soft, matrix, (WIDTH, HEIGHT))
        return np.asarray(scene * (1 - drawn[..., 3:]) + drawn[..., :3], np.float32)


def frames_of(
    case: Case, people: list[Cut], scene: NDArray[np.float32]
) -> Iterator[tuple[float, Picture]]:
    """Each picture of the camera with its time, s."""
    random = np.random.default_rng(3)
    noise = random.normal(0, 2, (2 * HEIGHT, 2 * WIDTH, 3)).astype(np.float32)
    for k in range(round(case.seconds * CAMERA_HZ)):
        t_s = k / CAMERA_HZ
        picture = scene
        for head, path in zip(people, case.paths, strict=False):
            place = path(t_s)
            if place is not None and -200 < place[0] < WIDTH + 200:
                picture = head.pasted(picture, place)
        y, x = random.integers(0, (HEIGHT, WIDTH)).tolist()
        noisy = picture + noise[y : y + HEIGHT, x : x + WIDTH]
        yield t_s, np.clip(noisy, 0, 255).astype(np.uint8)


def field() -> LightField:
    """A grid of 9x9 views whose disparities are not known."""
    return LightField(
        views=np.zeros((1, 9, 9, 3, 8, 8), np.uint8),
        disparity=None,
        disparity_scale_px=1.0,
        disparity_min_px=0.0,
        disparity_max_px=0.0,
        disparity_source="none",
        offsets=np.zeros((9, 9, 2), np.float32),
        present=np.ones((9, 9), bool),
        geometry=Geometry(),
        frame_rate_hz=0.0,
        name="grid",
        method="blend",
        manifest={},
    )


class Shown(NamedTuple):
    """A picture on the screen: when (s), the eyes (4,) that it was made for, the views (2, 2) of
    left and right eye, and whether there was a face.
    """

    t_s: Float
    eyes: Float
    views: Float
    face: NDArray[np.bool_]


Looked = Iterator[tuple[float, Picture, Face | None]]


def looked(tracker: EyeTracker, frames: Iterator[tuple[float, Picture]]) -> Looked:
    """Each frame with what the engine sees in it."""
    for t_s, picture in frames:
        face = tracker.engine.detect(picture)
        tracker.engine.examine(picture)
        yield t_s, picture, face


def shown(tracker: EyeTracker, frames: Looked, loop_s: float) -> Shown:
    """What the viewer shows of frames."""
    viewer = Viewer(field(), Config(render=Render(loop_ms=loop_s * 1e3, method="blend")))
    record = np.zeros((), EYES)
    rows: list[tuple[float, tuple[float, ...], Float, bool]] = []
    known: list[tuple[float, EyesRecord]] = []
    blank = 0
    for t_s, picture, face in frames:
        ready_s = t_s + AGE_S
        while blank / SCREEN_HZ - BEGUN_S < ready_s:
            if known:
                light_s = (blank + 0.5) / SCREEN_HZ + loop_s
                seen_s, newest = known[-1]
                stamps = (T0_NS + round(at_s * 1e9) for at_s in (seen_s, light_s))
                made = viewer.viewpoints(newest, *stamps)
                views = np.array((made.left, made.right))
                rows.append((light_s, tuple(made.eyes_px), views, bool(newest.face)))
            blank += 1
        tracker.update(face, T0_NS + round(t_s * 1e9))
        tracker.write(record, picture)
        known = [(t_s, EyesRecord.of(record))]
    columns = list(zip(*rows, strict=True))
    return Shown(*(np.array(column) for column in columns))


def row_of(case: Case, people: list[Cut], scene: NDArray[np.float32], loop_s: float) -> str:
    tracker = EyeTracker(Track(engine="litert"), False, loop_s)
    run = shown(tracker, looked(tracker, frames_of(case, people, scene)), loop_s)
    steps = np.abs(np.diff(run.views, axis=0)).max(axis=1)  # rows, columns
    explained = np.zeros_like(steps)
    for path in case.paths:
        explained = np.maximum(explained, moved(path, run.t_s))
    first = int((run.views[:, 1, 1] - run.views[:, 0, 1] > 0).argmax())
    beyond = np.maximum((steps - explained)[first:], 0)
    off = np.full(len(run.t_s), math.nan)
    for k, t_s in enumerate(run.t_s):
        index = case.viewer(t_s)
        place = None if index is None else case.paths[index](t_s)
        if place is not None and 0 < place[0] < WIDTH and 0 < place[1] < HEIGHT - 40:
            lx, ly, rx, ry = run.eyes[k]
            middle = (lx + rx) / 2 - place[0], (ly + ry) / 2 - place[1]
            off[k] = math.hypot(*middle) / place[2]
    inside = np.isfinite(off)
    right = 100 * float((off[inside] < 0.7).mean())
    late = "-"
    if math.isfinite(case.at_s):
        end = run.views[-SCREEN_HZ // 2 :].mean(axis=0)
        good = (off < 0.7) & (np.abs(run.views - end).max(axis=(1, 2)) < 1.0)
        count = round(0.2 * SCREEN_HZ)
        held = np.convolve(good, np.ones(count), mode="valid") > count - 0.5
        since = run.t_s[: len(held)] >= case.at_s
        late = (
            f"{run.t_s[: len(held)][since & held][0] - case.at_s:.2f}"
            if (since & held).any()
            else "never"
        )
    up, across = beyond.max(axis=0)
    return f"| {case.name} | {across:.2f} | {up:.2f} | {right:.0f} | {late} |"


def moved(path: Path3, t_s: Float) -> Float:
    """The largest motion of a head between two pictures within EXPLAINED_S, (n - 1, 2): rows and
    columns, in views.
    """
    places = [path(t) or (math.nan,) * 3 for t in t_s]
    x, y, apart = np.array(places).T
    steps = np.nan_to_num(np.abs(np.stack([np.diff(y), np.diff(x)], axis=1)))
    steps = np.where(steps > 100, 0, steps) * VIEWS / np.nan_to_num(apart[1:], nan=1e9)[:, None]
    reach = round(EXPLAINED_S * SCREEN_HZ)
    padded = np.pad(steps, ((reach, reach), (0, 0)), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=0)
    return np.asarray(windows.max(axis=-1), np.float64)


def recordings(folder: Path) -> Iterator[tuple[str, float, Iterator[tuple[float, Picture]]]]:
    """Name, rate and frames of every video."""
    for path in sorted([*folder.glob("videos/*.mp4"), *folder.glob("fgnet/*.avi")]):
        source = cv2.VideoCapture(str(path))
        yield path.stem[:24], source.get(cv2.CAP_PROP_FPS), video_frames(source)


def video_frames(source: cv2.VideoCapture) -> Iterator[tuple[float, Picture]]:
    rate_hz = source.get(cv2.CAP_PROP_FPS)
    count = 0
    while (picture := source.read()[1]) is not None:
        yield count / rate_hz, np.asarray(picture, np.uint8)
        count += 1


def track_frames(path: Path) -> Looked:
    """A recorded track as the engine's faces."""
    blank = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            face = None
            if row["face"] == "1":
                lx, ly, rx, ry = (
                    float(row[name]) for name in ("left_x", "left_y", "right_x", "right_y")
                )
                apart = math.hypot(lx - rx, ly - ry)
                x, y = (lx + rx) / 2, (ly + ry) / 2
                box = (x - 1.2 * apart, y - apart, x + 1.2 * apart, y + 1.6 * apart)
                face = Face(np.array(((lx, ly), (rx, ry))), 1.0, box, apart)
            yield float(row["t_s"]), blank, face


def steps_row(name: str, run: Shown) -> str:
    steps = np.abs(np.diff(run.views, axis=0)).max(axis=(1, 2))
    changed = np.r_[False, run.face[1:] != run.face[:-1]]
    near = np.convolve(changed, np.ones(round(0.4 * SCREEN_HZ)), mode="same")[1:] > 0
    at_change = f"{steps[near].max():.2f}" if near.any() else "-"
    return (
        f"| {name} | {len(steps)} | {int(changed.sum())} | {steps[~near].max():.2f} |"
        f" {at_change} | {np.percentile(steps, 99):.2f} | {100 * (steps > 0.5).mean():.2f} |"
    )


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("faces", type=existing)
    parser.add_argument("--tracks", type=existing)
    parser.add_argument("--loop-ms", type=float, default=0.0)
    given = parser.parse_args()
    cv2.setNumThreads(1)
    loop_s = given.loop_ms / 1000
    people = [Cut.of(head) for head in heads(given.faces)]
    room = np.asarray(cv2.imread(str(sorted((given.faces / "no_face").glob("*.jpg"))[0])), np.uint8)
    scene = np.asarray(cv2.GaussianBlur(cv2.resize(room, (WIDTH, HEIGHT)), (0, 0), 6), np.float32)
    print(
        f"| {given.loop_ms:.0f} ms | step | up and down | right % | late, s |\n|---|{'---:|' * 4}"
    )
    for case in cases():
        print(row_of(case, people, scene, loop_s), flush=True)
    print(
        f"\n| recording, {given.loop_ms:.0f} ms | pictures | lost or found | step, tracked |"
        f" step, lost or found | p99 | > .5, % |\n|---|{'---:|' * 6}"
    )
    for name, _, frames in recordings(given.faces):
        tracker = EyeTracker(Track(engine="litert"), False, loop_s)
        print(steps_row(name, shown(tracker, looked(tracker, frames), loop_s)), flush=True)
    for path in sorted(given.tracks.glob("*.csv")) if given.tracks else ():
        tracker = EyeTracker(Track(engine="litert"), False, loop_s)
        print(steps_row(path.stem, shown(tracker, track_frames(path), loop_s)), flush=True)


if __name__ == "__main__":
    start(main)
