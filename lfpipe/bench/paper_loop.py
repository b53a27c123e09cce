"""The paper's pipeline as one plain loop in one process: the reference for `lfpipe`.

video frame -> FaceMesh -> mean of 16 landmarks around each eye -> k-frame moving average -> nearest
view of the grid mapped to the camera picture -> red of the left view, green and blue of the right.
It uses nothing from lfpipe except the landmark indices and the trace writer.
"""

import itertools
import json
import math
import sys
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import attrs
import cattrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.files.safe_files import TraceFile
from lfpipe.track.engine import LEFT_EYE, RIGHT_EYE

WARM_UP = 10  # frames that do not count
PRELOADED = 600  # frames in memory
MEAN_OF = 5  # frames, of the moving average
PAPER_ALPHA_PX = 12.0  # px of the camera per view: chosen by hand, as in the paper
SIDES = ("left", "right")


@attrs.frozen(kw_only=True)
class Loop:
    """Options of a run."""

    video: str
    views: str
    """Folder of rows x cols PNG files whose sorted order is row-major."""
    pace_hz: float
    """0: as fast as possible."""
    seconds: float
    alpha_px: float
    grid: tuple[int, int]
    size_px: tuple[int, int] = (640, 480)
    decode: bool = True
    """Whether to decode frames inside the loop instead of before it."""
    trace: str = ""
    """File for the trace."""


def frames(
    video: str, decode: bool, size: tuple[int, int]
) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Yields indices in the video and BGR frames, forever.

    decode: on demand; else PRELOADED frames in advance.
    """
    capture = cv2.VideoCapture(video)

    def one_pass() -> Iterator[tuple[int, NDArray[np.uint8]]]:
        capture.set(cv2.CAP_PROP_POS_FRAMES, 0)
        for index in itertools.count():
            good, frame = capture.read()
            if not good:
                return
            if frame.shape[1::-1] != size:
                frame = cv2.resize(frame, size)
            yield index, np.asarray(frame, np.uint8)

    while decode:
        yield from one_pass()
    for index, frame in itertools.cycle(list(itertools.islice(one_pass(), PRELOADED))):
        yield index, frame.copy()


def run(loop: Loop) -> Iterator[dict[str, Any]]:
    """Runs the loop, and yields the lines of its trace. Sets OpenCV to one thread."""
    import mediapipe

    cv2.setNumThreads(1)
    views = [cv2.imread(str(path)) for path in sorted(Path(loop.views).glob("*.png"))]
    mesh = mediapipe.solutions.face_mesh.FaceMesh(max_num_faces=1, refine_landmarks=False)
    source = frames(loop.video, loop.decode, loop.size_px)
    sides = LEFT_EYE.tolist(), RIGHT_EYE.tolist()
    centre = np.array(loop.size_px) / 2
    last = np.array(loop.grid) - 1
    recent: deque[NDArray[np.float64]] = deque(maxlen=MEAN_OF)
    start = math.inf
    for i in itertools.count(-WARM_UP):
        if i == 0:
            start = time.perf_counter()
        if time.perf_counter() - start >= loop.seconds:
            return
        if loop.pace_hz and i > 0:
            time.sleep(max(0.0, start + i / loop.pace_hz - time.perf_counter()))
        t_sensor_ns = time.monotonic_ns()
        index, frame = next(source)
        t_read_ns = time.monotonic_ns()
        result = mesh.process(cv2.cvtColor(frame, cv2.COLOR_BGR2RGB))
        if result.multi_face_landmarks:
            marks = result.multi_face_landmarks[0].landmark
            points = [[(marks[j].x, marks[j].y) for j in side] for side in sides]
            recent.append(np.mean(points, axis=1) * loop.size_px)
        if not recent:
            continue
        eyes = np.mean(recent, axis=0)
        t_tracked_ns = time.monotonic_ns()
        steps = (eyes - centre)[:, ::-1] / loop.alpha_px * (1, -1)
        places = np.clip(np.rint(last / 2 + steps), 0, last).astype(int)
        left, right = (views[row * loop.grid[1] + col] for row, col in places)
        picture = right.copy()
        picture[..., 2] = left[..., 2]
        t_composed_ns = time.monotonic_ns()
        if i >= 0:
            pairs = {"eyes_raw": recent[-1], "eyes_used": eyes, "view": places}
            yield {
                "source_seq": index,
                "epoch": 0,
                "face": True,
                "method": "nearest",
                "composed": True,
                "cpu_ns": time.process_time_ns(),
                "t_sensor_ns": t_sensor_ns,
                "t_read_ns": t_read_ns,
                "t_tracked_ns": t_tracked_ns,
                "t_composed_ns": t_composed_ns,
                "t_presented_ns": t_composed_ns,
                **{
                    name: dict(zip(SIDES, pair.tolist(), strict=True))
                    for name, pair in pairs.items()
                },
            }


def main() -> None:
    """Runs the loop that the first argument describes in JSON; writes its trace."""
    loop = cattrs.structure(json.loads(sys.argv[1]), Loop)
    lost: list[str] = []
    trace = TraceFile(Path(loop.trace), lost.append)
    for line in run(loop):
        trace.write(line)
    trace.close()
    if lost:
        sys.exit(lost[0])


if __name__ == "__main__":
    main()
