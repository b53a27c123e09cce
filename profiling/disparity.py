"""Error against run time of the choices in estimating disparity: `python profiling/disparity.py SCENE... -o TABLE.md`.

Every second view of each scene is kept, disparity is estimated from those, and up to 16 of the others are predicted by warp2.
Time is CPU time of one thread per view.
"""

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import attrs
import cv2
import numpy as np

from lfpipe import config
from lfpipe.render.scoring import left_out, psnr_db, thinned
from lfpipe.render.synthesis import Synthesiser
from lfpipe.scene import disparity, optical_flow
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.open_scene import open_scene

# name: (half size, patch, stride, descents, smoothings of the flow; rounds, sigma, median of the refinement)
CHOICES = {
    "full size, patches of 8 (until 22 November)": (False, 8, 4, 25, 2, 2, 2.0, 5),
    "half size, the same": (True, 8, 4, 25, 2, 2, 2.0, 5),
    "half size, narrow refinement": (True, 8, 4, 25, 2, 3, 0.8, 3),
    "half size, patches of 5": (True, 5, 4, 25, 2, 2, 0.8, 3),
    "half size, patches of 4, stride 4": (True, 4, 4, 25, 2, 3, 0.8, 3),
    "half size, patches of 4, stride 3": (True, 4, 3, 25, 2, 2, 0.8, 3),
    "the same, 8 descents, 3 smoothings (in use)": (True, 4, 3, 8, 3, 2, 0.8, 3),
}


def choose(half: bool, patch: int, stride: int, descents: int, smoothings: int, rounds: int, sigma: float, median: int) -> None:
    """Sets the constants of the two modules."""
    disparity.HALVED_PX = 192 if half else 1 << 30
    disparity.ROUNDS, disparity.REFINED_OVER_PX, disparity.MEDIAN_PX = rounds, sigma, median
    optical_flow._PATCH_PX, optical_flow._PATCH_STRIDE_PX = patch, stride
    optical_flow._DESCENTS, optical_flow._SMOOTHINGS = descents, smoothings
    optical_flow._here.__dict__.clear()


def judged(field: LightField) -> tuple[float, float]:
    """(PSNR in dB of held-out views, CPU ms per view)."""
    kept, places = thinned(field), left_out(field, 16)
    started = time.process_time()
    maps = disparity.estimate_disparity(np.ascontiguousarray(kept.views[0]), kept.offsets)
    took_ms = 1000 * (time.process_time() - started) / (kept.rows * kept.cols)
    assert maps is not None
    low, high = (float(value) for value in np.nanpercentile(maps, (0.1, 99.9)))
    scale = disparity.scale_for(low, high)
    kept = attrs.evolve(kept, disparity=disparity.quantised(maps, scale)[None], disparity_scale_px=scale,
                        disparity_min_px=low, disparity_max_px=high)  # fmt: skip
    synthesiser, green = Synthesiser(kept, "warp2"), field.channels // 2
    out = [np.empty((field.height_px, field.width_px), np.uint8)]
    errors = []
    for row, col in places:
        drawn = synthesiser.render((row / 2, col / 2), 0, 0.0, [lambda r, c: np.asarray(kept.views[0, r, c, green])], out)[0]
        errors.append(psnr_db(float(np.mean((drawn.astype(np.float32) - field.views[0, row, col, green]) ** 2))))
    return float(np.mean(errors)), took_ms


def table(fields: list[LightField]) -> Iterator[str]:
    yield "| choice | " + " | ".join(f"{field.name}: dB, ms per view" for field in fields) + " |"
    yield "|---|" + "---|" * len(fields)
    for name, choice in CHOICES.items():
        choose(*choice)
        figures = [judged(field) for field in fields]
        yield f"| {name} | " + " | ".join(f"{db:.2f}, {ms:.0f}" for db, ms in figures) + " |"
        print(name, figures, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("-o", "--out", type=Path, default=Path("disparity.md"))
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    fields = [open_scene(scene, config.Scene()) for scene in arguments.scenes]
    said = "Held-out views by warp2 (every second kept), CPU time of one thread: `python profiling/disparity.py SCENE...`."
    head = ["# Disparity: error against run time", "", said, ""]
    arguments.out.write_text("\n".join([*head, *table(fields), ""]))


if __name__ == "__main__":
    main()
