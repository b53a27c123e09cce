"""What packing a scene costs (time, peak memory), and whether a picture costs the same from a small and a large grid.

    uv run python profiling/scene_pack.py [SCENE]...    packs each SCENE in a temporary cache
    uv run python profiling/scene_pack.py               generates 9x9 views of 512x512, 3x3 and 27x27 of 960x640

Bounds: 81 views of 512x512 with disparity in 20 s on two cores; 27x27 views of 960x640 in 500 MB RSS; the cost of a picture
within 10 % from 3x3 to 27x27.
"""

import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
from arguments import existing, parser_of, start

from lfpipe import config
from lfpipe.render.compositor import Compositor
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.open_scene import open_scene

ONE = """
import json, resource, sys, time
from lfpipe import config
from lfpipe.scene.open_scene import open_scene
started = time.monotonic()
open_scene(sys.argv[1], config.Scene(cache_dir=sys.argv[2], flip="none"))
packed = time.monotonic() - started
started = time.monotonic()
open_scene(sys.argv[1], config.Scene(cache_dir=sys.argv[2], flip="none"))
print(json.dumps([packed, time.monotonic() - started, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024]))
"""


def draw(folder: Path, side: int, height: int, width: int) -> Path:
    """A side x side grid of shifted texture as PNG, in the HCI layout."""
    folder.mkdir(parents=True)
    rng = np.random.default_rng(1)
    noise = rng.integers(0, 255, ((height + 160) // 4, (width + 160) // 4, 3)).astype(np.uint8)
    wall = cv2.resize(noise, (width + 160, height + 160), interpolation=cv2.INTER_CUBIC)
    for index in range(side * side):
        row, col = divmod(index, side)
        view = wall[2 * row : 2 * row + height, 2 * col : 2 * col + width]
        cv2.imwrite(str(folder / f"input_Cam{index:03d}.png"), view, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return folder


def pack(path: Path, cache: str) -> None:
    """Packs path in a process of its own and prints its cost."""
    run = subprocess.run([sys.executable, "-c", ONE, str(path), cache], stdout=subprocess.PIPE, text=True, check=True)
    packed_s, opened_s, peak_mb = (float(value) for value in run.stdout.strip("[] \n").split(","))
    opened = f"opened in {opened_s * 1000:6.1f} ms"
    print(f"{path.name:28} packed in {packed_s:6.1f} s, {opened}, peak {peak_mb:5.0f} MB RSS", flush=True)


def picture_us(field: LightField, method: str) -> float:
    """Median time to draw a picture of two views, on the same small walk around the middle of any grid. Larger walks would
    measure how many views fit into the processor's cache."""
    settings = config.updated(config.Config(), {"render.method": method, "render.anaglyph": "colour"}).render
    compositor = Compositor(field, settings)
    middle = (field.rows - 1) / 2, (field.cols - 1) / 2
    places = [(middle[0] + math.sin(0.7 * k), middle[1] - 0.25 + 0.75 * math.cos(1.1 * k)) for k in range(60)]
    times: list[float] = []
    for _ in range(6):
        for row, col in places:
            started = time.perf_counter_ns()
            compositor.compose((row, col), (row, col + 0.5))
            times.append((time.perf_counter_ns() - started) / 1000)
    return statistics.median(times[len(places) :])


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("scenes", metavar="SCENE", nargs="*", type=existing)
    scenes = parser.parse_args().scenes
    cv2.setNumThreads(1)
    print(f"{len(os.sched_getaffinity(0))} cores")
    with tempfile.TemporaryDirectory() as temporary:
        cache = f"{temporary}/cache"
        for scene in scenes:
            pack(scene, cache)
        if scenes:
            return
        pack(draw(Path(temporary, "9x9 of 512x512"), 9, 512, 512), cache)
        sizes = [draw(Path(temporary, f"{side}x{side} of 960x640"), side, 640, 960) for side in (3, 27)]
        for scene in sizes:
            pack(scene, cache)
        small, large = (open_scene(scene, config.Scene(cache_dir=cache, flip="none")) for scene in sizes)
        for method in ("nearest", "warp"):
            pairs = [(picture_us(small, method), picture_us(large, method)) for _ in range(5)]  # alternating: the machine drifts
            ratio = statistics.median(b / a for a, b in pairs)
            print(f"picture, {method:8} 3x3 {pairs[0][0]:7.0f} us   27x27 {pairs[0][1]:7.0f} us   ratio {ratio:.3f}")


if __name__ == "__main__":
    start(main)
