"""The paper's pipeline as one plain loop in one process: what `lfpipe` is measured against.

video frame -> FaceMesh -> mean of 16 landmarks around each eye -> k-frame moving average -> nearest view of the grid laid over
the camera picture -> red of the left view, green and blue of the right. Nothing of lfpipe is in it but the landmarks' numbers.
"""

from __future__ import annotations

import itertools
import json
import sys
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.track.landmarks import LEFT_EYE, RIGHT_EYE

WARM_UP = 10  # frames not counted
KEPT = 600  # frames held in memory


@attrs.frozen
class Loop:
    """What the loop runs with. scene: a folder of rows x cols pictures whose sorted order is row-major. pace_hz: 0 as fast as it
    can. decode: frames are decoded in the loop and not before it. trace: a file to write, or None."""

    video: Path
    scene: Path
    pace_hz: float = 0.0
    seconds: float = 15.0
    k: int = 5
    alpha_px: float = 12.0
    rows: int = 9
    cols: int = 9
    size_px: tuple[int, int] = (640, 480)
    decode: bool = False
    trace: Path | None = None


def frames(video: Path, decode: bool, size: tuple[int, int]) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Places in the video and BGR frames, over and over; decoded as they are asked for, or the first KEPT before the first."""
    capture = cv2.VideoCapture(str(video))

    def one_pass() -> Iterator[tuple[int, NDArray[np.uint8]]]:
        capture.set(cv2.CAP_PROP_POS_FRAMES, 0)
        for place in itertools.count():
            found = capture.read()
            if not found[0]:
                return
            frame = found[1] if found[1].shape[1::-1] == size else cv2.resize(found[1], size)
            yield place, np.asarray(frame, np.uint8)

    if decode:
        while True:
            yield from one_pass()
    kept = list(itertools.islice(one_pass(), KEPT))
    for place, frame in itertools.cycle(kept):
        yield place, frame.copy()


def quantiles_ms(values_s: list[float]) -> dict[str, float]:
    ranks = (("p50", 50), ("p95", 95), ("p99", 99), ("max", 100))
    return {name: round(float(np.percentile(values_s, rank)) * 1e3, 3) for name, rank in ranks}


def run(loop: Loop) -> dict[str, Any]:
    """Runs it; rate, p50..max of latency, tracking and rendering in ms, CPU in cores. Sets OpenCV to one thread."""
    import mediapipe

    cv2.setNumThreads(1)
    width, height = loop.size_px
    files = sorted(p for p in loop.scene.iterdir() if p.suffix.lower() in (".png", ".jpg", ".bmp"))
    grid = [np.asarray(cv2.imread(str(path)), np.uint8) for path in files[: loop.rows * loop.cols]]
    mesh = mediapipe.solutions.face_mesh.FaceMesh(max_num_faces=1, refine_landmarks=False)
    source = frames(loop.video, loop.decode, (width, height))
    left_eye, right_eye = LEFT_EYE.tolist(), RIGHT_EYE.tolist()
    recent: deque[NDArray[np.float64]] = deque(maxlen=loop.k)
    latency, track, render = list[float](), list[float](), list[float]()
    lines, hits = list[str](), 0
    start = cpu = 0.0
    t_first_ns = 0
    for i in itertools.count(-WARM_UP):
        if i == 0:
            start, cpu = time.perf_counter(), time.process_time()
        if i >= 0:
            if time.perf_counter() - start >= loop.seconds:
                break
            if loop.pace_hz:
                time.sleep(max(0.0, start + i / loop.pace_hz - time.perf_counter()))
        t_sensor_ns = time.monotonic_ns()
        place, frame = next(source)
        t_read_ns = time.monotonic_ns()
        result = mesh.process(cv2.cvtColor(frame, cv2.COLOR_BGR2RGB))
        if result.multi_face_landmarks:
            marks = result.multi_face_landmarks[0].landmark
            sides = [[(marks[j].x * width, marks[j].y * height) for j in side] for side in (left_eye, right_eye)]
            recent.append(np.array([[sum(x for x, _ in side) / 16, sum(y for _, y in side) / 16] for side in sides]))
        t_tracked_ns = time.monotonic_ns()
        if recent:
            eyes = np.mean(recent, axis=0)
            middle = (loop.rows - 1) / 2, (loop.cols - 1) / 2
            cols = np.clip(np.rint(middle[1] + (width / 2 - eyes[:, 0]) / loop.alpha_px), 0, loop.cols - 1).astype(int)
            rows = np.clip(np.rint(middle[0] + (eyes[:, 1] - height / 2) / loop.alpha_px), 0, loop.rows - 1).astype(int)
            left, right = (grid[r * loop.cols + c] for r, c in zip(rows, cols, strict=True))
            picture = right.copy()
            picture[..., 2] = left[..., 2]
        t_done_ns = time.monotonic_ns()
        t_first_ns = t_first_ns or (t_done_ns if recent else 0)
        if i < 0:
            continue
        hits += bool(result.multi_face_landmarks)
        latency.append((t_done_ns - t_read_ns) / 1e9)
        track.append((t_tracked_ns - t_read_ns) / 1e9)
        render.append((t_done_ns - t_tracked_ns) / 1e9)
        if loop.trace and recent:
            eyes_of = {"eyes_raw": recent[-1], "eyes_used": eyes, "view": np.stack([rows, cols], axis=1)}
            pairs = {name: {"left": pair[0].tolist(), "right": pair[1].tolist()} for name, pair in eyes_of.items()}
            stamps = {"t_sensor_ns": t_sensor_ns, "t_read_ns": t_read_ns, "t_presented_ns": t_done_ns}
            lines.append(json.dumps({"source_seq": place, "cpu_ns": time.process_time_ns(), **stamps, **pairs}))
    wall = time.perf_counter() - start
    if loop.trace:
        loop.trace.write_text("\n".join(lines) + "\n")
    return {
        "fps": round(len(latency) / wall, 1),
        "frames": len(latency),
        "hit_rate": round(hits / len(latency), 3),
        "latency_ms": quantiles_ms(latency),
        "track_ms": quantiles_ms(track),
        "render_ms": quantiles_ms(render),
        "cpu_cores": round((time.process_time() - cpu) / wall, 3),
        "t_first_picture_ns": t_first_ns,
    }


def main() -> None:
    """Runs the loop that the JSON object in the first argument describes, and prints its figures."""
    given = json.loads(sys.argv[1])
    paths = {name: Path(given[name]) for name in ("video", "scene", "trace")}
    print(json.dumps(run(Loop(**{**given, **paths, "size_px": tuple(given["size_px"])}))))


if __name__ == "__main__":
    main()
