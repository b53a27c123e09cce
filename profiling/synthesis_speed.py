"""Cost of a picture, both eyes and anaglyph, on one core, with the bounds of this machine beside it.

usage: python profiling/synthesis_speed.py [SCENE]     SCENE: default ../shared/data/lightfields/hci_antinous
Yardsticks: a copy of the picture's bytes; three resamplings pixel by pixel (red of one eye, green and blue of the other).
Minimum and median of many pictures at viewpoints between the stored views, none of them seen twice in a row.
"""

from __future__ import annotations

import itertools
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import attrs
import cv2
import numpy as np

from lfpipe.bench.kept import walk
from lfpipe.bench.timing import times_ms
from lfpipe.config import Render, Scene
from lfpipe.render.anaglyph import Mixer, recipe
from lfpipe.render.blocks import near_array
from lfpipe.render.compositor import Compositor
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.pack import open_scene

SCENE = Path(__file__).resolve().parents[2] / "shared" / "data" / "lightfields" / "hci_antinous"


def timed(call: Callable[[], object], count: int = 300) -> tuple[float, float]:
    """(minimum, median) in ms."""
    found = times_ms(call, count)
    return min(found[5:]), statistics.median(found[5:])


def tiled(field: LightField, side: int) -> LightField:
    """A grid of side x side views repeated from field's own, for the cost of large grids."""
    index = np.arange(side) % field.rows
    assert field.disparity is not None
    return attrs.evolve(
        field,
        views=np.asarray(field.views)[:, index][:, :, index],
        disparity=np.asarray(field.disparity)[:, index][:, :, index],
        offsets=np.zeros((side, side, 2), np.float32),
        present=np.ones((side, side), bool),
    )


def main() -> None:
    cv2.setNumThreads(1)
    field = open_scene(Path(sys.argv[1]) if len(sys.argv) > 1 else SCENE, Scene())
    size = (field.height_px, field.width_px)
    picture, copy = np.zeros((*size, 3), np.uint8), np.zeros((*size, 3), np.uint8)
    y, x = (np.ascontiguousarray(a, np.float32) for a in np.mgrid[0 : size[0], 0 : size[1]])
    plane = np.ascontiguousarray(np.asarray(field.views)[0, 0, 0, 0])
    out = np.empty_like(plane)
    memcpy = timed(lambda: np.copyto(copy, picture))[0]
    x += np.float32(0.3)
    remap = timed(lambda: cv2.remap(plane, x, y, cv2.INTER_LINEAR, out, borderMode=cv2.BORDER_REPLICATE))[0]
    print(f"{size[1]}x{size[0]}; OpenCV {cv2.__version__}; bounds: copy {memcpy:.3f} ms, three resamplings {3 * remap:.2f} ms")
    print(f"{'method':8s} {'anaglyph':12s} {'min ms':>8s} {'median':>8s}  bound")
    for method, anaglyph in itertools.product(("nearest", "blend", "warp", "warp2"), ("colour", "half-colour", "dubois")):
        compositor = Compositor(field, Render(method=method, anaglyph=anaglyph))  # type: ignore[arg-type]
        where = walk(field)
        low, median = timed(lambda c=compositor, w=where: c.compose(*w()))  # type: ignore[misc]
        bound = f"{low / memcpy:.1f} copies" if method in ("nearest", "blend") else f"{low / (3 * remap):.2f} x three resamplings"
        print(f"{method:8s} {anaglyph:12s} {low:8.3f} {median:8.3f}  {bound}")
    compositor = Compositor(field, Render(method="nearest", anaglyph="colour"))
    mixer, mixed = Mixer(recipe("colour"), *size), near_array((*size, 3))
    planes = [np.asarray(field.views)[0, 4, col, k] for col, k in ((3, 0), (5, 1), (5, 2))]
    rounds = [  # in turns, so that what else the machine does meets all three
        [
            timed(lambda: np.copyto(copy, picture), 60)[0],
            timed(lambda: mixer.mix(planes, mixed), 60)[0],
            timed(lambda: compositor.compose((4.0, 3.0), (4.0, 5.0)), 60)[0],
        ]
        for _ in range(9)
    ]
    copied, composite, whole = np.min(rounds, axis=0)
    print(
        f"colour composite of two stored views: {composite:.4f} ms, {composite / copied:.2f} x a copy of the same bytes", end="; "
    )
    print(f"with all that leads to it {whole:.4f} ms, {whole / copied:.2f} x")

    screen = np.zeros((1080, 1920, 3), np.uint8)
    compositor = Compositor(field, Render(method="warp", anaglyph="dubois"))
    where = walk(field)

    def frame() -> None:
        cv2.resize(compositor.compose(*where()), (1920, 1080), screen, interpolation=cv2.INTER_LINEAR)

    low, median = timed(frame)
    print(f"1920x1080 from this light field, warp, dubois: min {low:.2f}, median {median:.2f} ms of 16.7 ms at 60 Hz")
    big = attrs.evolve(
        field,
        views=np.stack([cv2.resize(p, (1920, 1080)) for p in np.asarray(field.views)[0, 3:6, 3:6].reshape(-1, *size)]).reshape(
            1, 3, 3, field.channels, 1080, 1920
        ),
        disparity=None if field.disparity is None else np.asarray(field.disparity)[:, 3:6, 3:6],
        offsets=field.offsets[3:6, 3:6],
        present=field.present[3:6, 3:6],
    )
    for anaglyph in ("colour", "dubois"):
        compositor = Compositor(big, Render(method="warp", anaglyph=anaglyph))  # type: ignore[arg-type]
        where = walk(big)
        low, median = timed(lambda c=compositor, w=where: c.compose(*w()), 100)  # type: ignore[misc]
        print(f"light field of 1920x1080 itself, warp, {anaglyph}: min {low:.2f}, median {median:.2f} ms of 16.7 ms at 60 Hz")
    print("cost as the grid grows (colour, median ms): ", end="")
    grids = [tiled(field, side) for side in (3, 9, 27)]
    for method in ("nearest", "warp"):
        rounds: list[list[float]] = []
        for _ in range(5):  # in turns, so that what else the machine does meets all sizes
            rounds.append([])
            for grid in grids:
                compositor = Compositor(grid, Render(method=method, anaglyph="colour"))  # type: ignore[arg-type]
                where = walk(grid)
                rounds[-1].append(timed(lambda c=compositor, w=where: c.compose(*w()), 150)[1])  # type: ignore[misc]
        medians = np.median(rounds, axis=0)
        print(", ".join(f"{method} {g.rows}x{g.cols} {m:.3f}" for g, m in zip(grids, medians, strict=True)), end="; ")
    print()
    start = time.perf_counter()
    compositor = Compositor(field, Render(method="warp2", anaglyph="dubois"))
    made = time.perf_counter()
    compositor.compose((4.2, 3.1), (4.2, 4.9))
    drawn = time.perf_counter()
    print(f"first picture: {1e3 * (made - start):.1f} ms to make the compositor, {1e3 * (drawn - made):.1f} ms to draw")


if __name__ == "__main__":
    main()
