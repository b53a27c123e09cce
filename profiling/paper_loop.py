"""The paper's pipeline as one plain loop in one process: what `lfpipe` is measured against.

video frame -> FaceMesh -> mean of 16 landmarks around each eye -> k-frame moving average -> nearest view of the grid laid over
the camera picture -> red of the left view, green and blue of the right.

    uv run python profiling/paper_loop.py VIDEO SCENE_DIR [--pace HZ] [--seconds S] [--decode] [--trace FILE]

SCENE_DIR holds rows x cols pictures whose sorted order is row-major. --pace 0: as fast as it can; --decode: frames are decoded in
the loop and not before it. Prints one JSON object: rate, p50..max of latency, tracking and rendering in ms, CPU.
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path

import cv2
import mediapipe
import numpy as np
from numpy.typing import NDArray

from lfpipe.track.landmarks import LEFT_EYE, RIGHT_EYE

WARM_UP = 10  # frames not counted


def frames(video: str, decode: bool, size: tuple[int, int]) -> Iterator[NDArray[np.uint8]]:
    """BGR frames for ever; decoded as they are asked for, or all before the first."""
    capture = cv2.VideoCapture(video)

    def one_pass() -> Iterator[NDArray[np.uint8]]:
        capture.set(cv2.CAP_PROP_POS_FRAMES, 0)
        while (found := capture.read())[0]:
            yield found[1] if found[1].shape[1::-1] == size else cv2.resize(found[1], size)

    if decode:
        while True:
            yield from one_pass()
    kept = list(itertools.islice(one_pass(), 600))
    for frame in itertools.cycle(kept):
        yield frame.copy()


def quantiles_ms(values_s: list[float]) -> dict[str, float]:
    ranks = (("p50", 50), ("p95", 95), ("p99", 99), ("max", 100))
    return {name: round(float(np.percentile(values_s, rank)) * 1e3, 3) for name, rank in ranks}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("video")
    parser.add_argument("scene")
    parser.add_argument("--pace", type=float, default=0.0)
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--k", type=int, default=5)
    parser.add_argument("--alpha", type=float, default=12.0)
    parser.add_argument("--rows", type=int, default=9)
    parser.add_argument("--cols", type=int, default=9)
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--decode", action="store_true")
    parser.add_argument("--trace", type=Path)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    width, height = (int(v) for v in args.size.split("x"))
    files = sorted(p for p in Path(args.scene).iterdir() if p.suffix.lower() in (".png", ".jpg", ".bmp"))
    grid = [cv2.imread(str(path)) for path in files[: args.rows * args.cols]]
    mesh = mediapipe.solutions.face_mesh.FaceMesh(max_num_faces=1, refine_landmarks=False)
    source = frames(args.video, args.decode, (width, height))
    left_eye, right_eye = LEFT_EYE.tolist(), RIGHT_EYE.tolist()
    recent: deque[NDArray[np.float64]] = deque(maxlen=args.k)
    latency, track, render, lines, found = [], [], [], [], 0
    start = cpu = 0.0
    for i in itertools.count(-WARM_UP):
        if i == 0:
            start, cpu = time.perf_counter(), time.process_time()
        if i >= 0:
            if time.perf_counter() - start >= args.seconds:
                break
            if args.pace:
                time.sleep(max(0.0, start + i / args.pace - time.perf_counter()))
        t_sensor_ns = time.monotonic_ns()
        frame = next(source)
        t_read_ns = time.monotonic_ns()
        result = mesh.process(cv2.cvtColor(frame, cv2.COLOR_BGR2RGB))
        if result.multi_face_landmarks:
            marks = result.multi_face_landmarks[0].landmark
            sides = [[(marks[j].x * width, marks[j].y * height) for j in side] for side in (left_eye, right_eye)]
            recent.append(np.array([[sum(x for x, _ in side) / 16, sum(y for _, y in side) / 16] for side in sides]))
        t_tracked_ns = time.monotonic_ns()
        if recent:
            eyes = np.mean(recent, axis=0)
            cols = np.clip(np.rint((args.cols - 1) / 2 + (width / 2 - eyes[:, 0]) / args.alpha), 0, args.cols - 1).astype(int)
            rows = np.clip(np.rint((args.rows - 1) / 2 + (eyes[:, 1] - height / 2) / args.alpha), 0, args.rows - 1).astype(int)
            left, right = (grid[r * args.cols + c] for r, c in zip(rows, cols, strict=True))
            picture = right.copy()
            picture[..., 2] = left[..., 2]
        t_done_ns = time.monotonic_ns()
        if i < 0:
            continue
        found += bool(result.multi_face_landmarks)
        latency.append((t_done_ns - t_read_ns) / 1e9)
        track.append((t_tracked_ns - t_read_ns) / 1e9)
        render.append((t_done_ns - t_tracked_ns) / 1e9)
        if args.trace and recent:
            eyes_of = {"eyes_raw": recent[-1], "eyes_used": eyes}
            pairs = {name: {"left": pair[0].tolist(), "right": pair[1].tolist()} for name, pair in eyes_of.items()}
            stamps = {"t_sensor_ns": t_sensor_ns, "t_read_ns": t_read_ns, "t_presented_ns": t_done_ns}
            lines.append(json.dumps({"source_seq": i + WARM_UP, **stamps, **pairs}))
    wall = time.perf_counter() - start
    if args.trace:
        args.trace.write_text("\n".join(lines) + "\n")
    print(
        json.dumps(
            {
                "fps": round(len(latency) / wall, 1),
                "frames": len(latency),
                "hit_rate": round(found / len(latency), 3),
                "latency_ms": quantiles_ms(latency),
                "track_ms": quantiles_ms(track),
                "render_ms": quantiles_ms(render),
                "cpu_cores": round((time.process_time() - cpu) / wall, 3),
            }
        )
    )


if __name__ == "__main__":
    main()
