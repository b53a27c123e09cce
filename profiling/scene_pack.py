"""What opening a scene costs: `lfpipe scene info`, the first picture of a new scene, and packing,
of sets of many sizes.

    python -m profiling.scene_pack [SCENE]... --out profiling/results/scene_pack.md

Each SCENE, the demo, and sets that are drawn: 2, 25, 101 and 289 views, and a photograph with depth
of 12 megapixels. CPU and memory are those of all processes together and of the largest one; the
first picture is that of `lfpipe up`, from its start to the refresh that shows the scene. Goals:
first picture in 2 s (9x9 views of 512x512, the demo) and 4 s (101 views), `info` in 2 s of CPU, the
photograph packed in 15 s. Last, the time of a picture from 3x3 and from 27x27 views, which must be
equal within 10 %.
"""

import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import cv2

from lfpipe import config
from lfpipe.render.synthesis.compositor import Compositor
from lfpipe.scene.lightfield import LightField
from profiling.arguments import LFPIPE, existing, parser_of, start
from tests.render import rendered
from tests.scene import made
from tests.scene.test_pictures import FLOOR

COST = """
import json, resource, subprocess, sys, time
started = time.monotonic_ns()
code = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL).returncode
used = resource.getrusage(resource.RUSAGE_CHILDREN)
wall_s = (time.monotonic_ns() - started) / 1e9
print(json.dumps([code, started, wall_s, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024]))
"""
DRAWN = {
    "2 views of 1920x1080": (1, 2, 1080, 1920),
    "5x5 views of 640x480": (5, 5, 480, 640),
    "101 views of 1000x700": (1, 101, 700, 1000),
    "17x17 views of 512x512": (17, 17, 512, 512),
}


def draw(folder: Path, kind: str) -> Path:
    """A set as JPEG files."""
    if kind in DRAWN:
        rows, cols, height, width = DRAWN[kind]
        grid = made.views(rows, cols, height // 4, width // 4, 0.5, -0.25)
        for n, view in enumerate(grid.reshape(-1, *grid.shape[2:])):
            made.write(
                folder / f"v_{n // cols:02d}_{n % cols:03d}.jpg",
                cv2.resize(view, (width, height), interpolation=cv2.INTER_CUBIC),
            )
        return folder
    made.write(folder / "x.jpg", cv2.resize(made.texture(300, 400, 1), (4000, 3000)))
    made.write(folder / "x_depth.png", cv2.resize(FLOOR, (4000, 3000)))
    return folder


def cost(*words: str) -> tuple[int, float, float, float]:
    """(start on the monotonic clock in ns, wall s, CPU s, MB of the largest process) of a
    command.
    """
    done = subprocess.run(
        [sys.executable, "-c", COST, *LFPIPE, *words], capture_output=True, text=True, check=True
    )
    code, *metrics = json.loads(done.stdout)
    if code:
        raise SystemExit(f"{' '.join(words)}: exit code {code}\n{done.stderr}")
    return tuple(metrics)


def row(scene: str, folder: Path) -> str:
    """The metrics of a scene, "" for the demo."""
    cache = f"--set=scene.cache_dir={folder}/cache"
    trace = folder / "trace.jsonl"
    words = [
        scene or "--demo",
        "--session",
        f"cost{os.getpid()}",
        "--camera",
        "demo",
        "--display",
        "none",
        "--duration",
        "1.5",
    ]
    started, *_ = cost("up", *words, "--trace", str(trace), f"--set=scene.cache_dir={folder}/first")
    first_s = (json.loads(trace.read_text().splitlines()[0])["t_presented_ns"] - started) / 1e9
    if not scene:
        return f" | {first_s:.1f} s | | | |"
    _, _, info_s, info_mb = cost("scene", "info", scene, cache)
    _, wall_s, cpu_s, mb = cost("scene", "pack", scene, cache)
    return (
        f"{info_s:.1f} s, {info_mb:.0f} MB | {first_s:.1f} s | {wall_s:.1f} s | {cpu_s:.1f} s |"
        f" {mb:.0f} MB |"
    )


def rows(scenes: list[Path]) -> Iterator[str]:
    yield "| set | `info`: CPU, memory | first picture | packing: wall time | CPU | memory |"
    yield "|---|---|---|---|---|---|"
    for kind in ("the demo", *scenes, *DRAWN, "RGB-D photograph, 12 megapixels"):
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            drawn = not isinstance(kind, Path) and kind != "the demo"
            scene = str(draw(folder / "s", str(kind)) if drawn else kind)
            yield (
                f"| {kind.name if isinstance(kind, Path) else kind} |"
                f" {row('' if kind == 'the demo' else scene, folder)}"
            )


def picture_us(field: LightField, method: str) -> float:
    """Median time to draw a picture of two views, on the same small walk around the middle of any
    grid. Larger walks would measure how many views fit into the processor's cache.
    """
    settings = config.updated(
        config.Config(), {"render.method": method, "render.anaglyph": "colour"}
    ).render
    compositor = Compositor(field, settings)
    middle = (field.rows - 1) / 2, (field.cols - 1) / 2
    places = [
        (middle[0] + math.sin(0.7 * k), middle[1] - 0.25 + 0.75 * math.cos(1.1 * k))
        for k in range(60)
    ]
    times: list[float] = []
    for _ in range(6):
        for y, x in places:
            started = time.perf_counter_ns()
            compositor.compose((y, x), (y, x + 0.5))
            times.append((time.perf_counter_ns() - started) / 1000)
    return statistics.median(times[len(places) :])


def pictures() -> Iterator[str]:
    small, large = (rendered.field(side, side, 320, 480) for side in (3, 27))
    for method in ("nearest", "warp"):
        # alternating: the machine drifts
        pairs = [(picture_us(small, method), picture_us(large, method)) for _ in range(5)]
        ratio = statistics.median(b / a for a, b in pairs)
        metrics = (
            f"{pairs[0][0]:.0f} us from 3x3 views of 480x320, {pairs[0][1]:.0f} us from 27x27,"
            f" ratio {ratio:.3f}"
        )
        yield f"A picture by {method}: {metrics}."


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("scenes", metavar="SCENE", nargs="*", type=existing)
    parser.add_argument("--out", type=Path, default=Path("profiling/results/scene_pack.md"))
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    lines = ["# What opening a scene costs", "", "`python -m profiling.scene_pack SCENE...`", ""]
    for line in chain(rows(arguments.scenes), [""], pictures()):
        print(line, flush=True)
        lines.append(line)
    arguments.out.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    start(main)
