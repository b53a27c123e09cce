"""CPU time of the tracking thread for one frame, cold, against that of the landmark network alone.

    uv run python profiling/track_frame.py [--frames 150] [--filter predictive]

`EyeTracker` runs on the demo's frames, in turns with a run of the network on its last crop; before each, the thread sleeps for
20 ms and writes 6 MB of other memory. Thread CPU, medians in us. Other load on the machine hardly changes the ratio.
"""

import time

import attrs
import cv2
import numpy as np
from arguments import parser_of, start

from lfpipe.capture.demo import DemoSource
from lfpipe.config import Camera, Track
from lfpipe.eyes import EYES
from lfpipe.track.eye_tracker import EyeTracker


def main() -> None:
    parser = parser_of(__doc__, frames=150)
    parser.add_argument("--filter", default="predictive")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    tracker = EyeTracker(attrs.evolve(Track(), filter=args.filter))
    source, record, other = DemoSource(Camera()), np.zeros((), EYES), np.zeros(6 << 20, np.uint8)
    network = tracker.engine._network  # type: ignore[attr-defined]
    image = np.empty((480, 640, 3), np.uint8)
    times: dict[str, list[int]] = {"network": [], "tracking": []}
    for k in range(args.frames + 10):
        source.read(image)
        for name in times:
            time.sleep(0.02)
            other += 1
            began_ns = time.thread_time_ns()
            if name == "network":
                network.invoke()
            else:
                face = tracker.engine.detect(image)
                tracker.update(face, k * 33_333_333)
                tracker.write(record, image)
            times[name].append(time.thread_time_ns() - began_ns)
    alone, whole = (float(np.median(values[10:])) / 1e3 for values in times.values())
    print(
        f"network alone {alone:.0f} us, tracking of a frame {whole:.0f} us, ratio {whole / alone:.2f}"
    )


if __name__ == "__main__":
    start(main)
