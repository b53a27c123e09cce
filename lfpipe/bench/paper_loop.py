"""The paper's pipeline as one plain loop in one process: the reference that `lfpipe` is compared
with.

video frame -> FaceMesh -> mean of 16 landmarks around each eye -> k-frame moving average -> nearest
view of the grid laid over the camera picture -> red of the left view, green and blue of the right.
It uses nothing from lfpipe except the landmarks' numbers.
"""

import itertools
import json
import sys
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.track.landmarks import LEFT_EYE, RIGHT_EYE

WARM_UP = 10  # warm-up frames, not counted
PRELOADED = 600  # frames held in memory


@attrs.frozen(kw_only=True)
class Loop:
    """views: a folder of rows x cols pictures whose sorted order is row-major. pace_hz: 0 for as
    fast as possible.

    decode: decode frames inside the loop, not before it. trace: the file to write.
    """

    video: Path = attrs.field(converter=Path)
    views: Path = attrs.field(converter=Path)
    pace_hz: float
    seconds: float
    alpha_px: float
    rows: int
    cols: int
    size_px: tuple[int, int] = (640, 480)
    k: int = 5
    decode: bool = True
    trace: Path = attrs.field(default=Path("trace.jsonl"), converter=Path)


def frames(
    video: Path, decode: bool, size: tuple[int, int]
) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Yields indices in the video and BGR frames, forever.

    decode: on demand; else PRELOADED frames before the first.
    """
    capture = cv2.VideoCapture(str(video))

    def one_pass() -> Iterator[tuple[int, NDArray[np.uint8]]]:
        capture.set(cv2.CAP_PROP_POS_FRAMES, 0)
        for index in itertools.count():
            good, frame = capture.read()
            if not good:
                return
            yield (
                index,
                np.asarray(
                    frame if frame.shape[1::-1] == size else cv2.resize(frame, size), np.uint8
                ),
            )

    while decode:
        yield from one_pass()
    for index, frame in itertools.cycle(list(itertools.islice(one_pass(), PRELOADED))):
        yield index, frame.copy()


def run(loop: Loop) -> None:
    """Runs the loop and writes its trace. Sets OpenCV to one thread."""
    import mediapipe

    cv2.setNumThreads(1)
    width, height = loop.size_px
    files = sorted(p for p in loop.views.iterdir() if p.suffix.lower() in (".png", ".jpg", ".bmp"))
    grid = [np.asarray(cv2.imread(str(path)), np.uint8) for path in files[: loop.rows * loop.cols]]
    mesh = mediapipe.solutions.face_mesh.FaceMesh(max_num_faces=1, refine_landmarks=False)
    source = frames(loop.video, loop.decode, (width, height))
    left_eye, right_eye = LEFT_EYE.tolist(), RIGHT_EYE.tolist()
    recent: deque[NDArray[np.float64]] = deque(maxlen=loop.k)
    lines = []
    start = 0.0
    for i in itertools.count(-WARM_UP):
        if i == 0:
            start = time.perf_counter()
        if i >= 0:
            if time.perf_counter() - start >= loop.seconds:
                break
            if loop.pace_hz:
                time.sleep(max(0.0, start + i / loop.pace_hz - time.perf_counter()))
        t_sensor_ns = time.monotonic_ns()
        index, frame = next(source)
        t_read_ns = time.monotonic_ns()
        result = mesh.process(cv2.cvtColor(frame, cv2.COLOR_BGR2RGB))
        if result.multi_face_landmarks:
            marks = result.multi_face_landmarks[0].landmark
            sides = [
                [(marks[j].x * width, marks[j].y * height) for j in side]
                for side in (left_eye, right_eye)
            ]
            recent.append(
                np.array(
                    [[sum(x for x, _ in side) / 16, sum(y for _, y in side) / 16] for side in sides]
                )
            )
        if not recent:
            continue
        eyes = np.mean(recent, axis=0)
        middle = (loop.rows - 1) / 2, (loop.cols - 1) / 2
        cols = np.clip(
            np.rint(middle[1] + (width / 2 - eyes[:, 0]) / loop.alpha_px), 0, loop.cols - 1
        ).astype(int)
        rows = np.clip(
            np.rint(middle[0] + (eyes[:, 1] - height / 2) / loop.alpha_px), 0, loop.rows - 1
        ).astype(int)
        left, right = (grid[r * loop.cols + c] for r, c in zip(rows, cols, strict=True))
        picture = right.copy()
        picture[..., 2] = left[..., 2]
        t_composed_ns = time.monotonic_ns()
        if i >= 0:
            pairs = {
                "eyes_raw": recent[-1],
                "eyes_used": eyes,
                "view": np.stack([rows, cols], axis=1),
            }
            sided = {
                name: {"left": pair[0].tolist(), "right": pair[1].tolist()}
                for name, pair in pairs.items()
            }
            line = {
                "source_seq": index,
                "composed": True,
                "cpu_ns": time.process_time_ns(),
                "t_sensor_ns": t_sensor_ns,
                "t_read_ns": t_read_ns,
                "t_composed_ns": t_composed_ns,
                "t_presented_ns": t_composed_ns,
                **sided,
            }
            lines.append(json.dumps(line) + "\n")
    loop.trace.write_text("".join(lines))


if __name__ == "__main__":
    loop_fields = json.loads(sys.argv[1])
    run(Loop(**{**loop_fields, "size_px": tuple(loop_fields["size_px"])}))
