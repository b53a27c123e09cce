"""What each anaglyph method does to colour, comfort and ghosts, through simulated glasses, and what a picture costs.

usage: python profiling/anaglyph_colours.py [PICTURE ...]     default: one view of each scene in ../shared/data/lightfields
fused: mean CIELAB error of what both eyes see together. rivalry: difference in L* between the eyes, mean and 95th percentile.
leak: light of the other eye on mid grey, in % (negative: over-corrected). error: of the table form against the published matrix,
in code values.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Scene
from lfpipe.errors import UserError
from lfpipe.render.anaglyph import MATRICES, Mixer, decoded, encode, encoded, recipe
from lfpipe.render.colour_metric import GREEN_MAGENTA, RED_CYAN, measure
from lfpipe.scene.pack import open_scene

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "lightfields"
SCENES = ("hci_antinous", "lytro_2067", "hci_old_stillLife_3x3", "stanford_lego_knights_17x17", "atlas_jarabo_toys_9x9")


def pictures() -> list[NDArray[np.uint8]]:
    if len(sys.argv) > 1:
        return [np.asarray(cv2.imread(name), np.uint8) for name in sys.argv[1:]]
    found = []
    for name in SCENES:
        try:
            field = open_scene(DATA / name, Scene())
        except UserError as error:
            print(f"left out: {name}: {error.message}")
            continue
        view = np.asarray(field.views)[0, field.rows // 2, field.cols // 2]
        found.append(np.ascontiguousarray(np.broadcast_to(view[::-1], (3, *view.shape[1:])).transpose(1, 2, 0)))
    return found


def exact(picture: NDArray[np.uint8], name: str, light: str) -> NDArray[np.float64]:
    """The published matrix in floating point, the same picture for both eyes: BGR code values."""
    matrix = np.array(MATRICES[name]).sum(axis=1)
    linear = light == "linear" and name.startswith("dubois")
    rgb = picture[..., ::-1] / 255
    mixed = np.clip((decoded(rgb) if linear else rgb) @ matrix.T, 0, 1)
    value: NDArray[np.float64] = (encoded(mixed) if linear else mixed)[..., ::-1] * 255
    return value


def mixing_ms(name: str, light: str, ghost: float) -> float:
    """Minimum ms per megapixel of the mixing of ready planes."""
    how = recipe(name, light, ghost)
    mixer, side = Mixer(how, 1024, 1024), (1024, 1024)
    rng = np.random.default_rng(0)
    planes = [cv2.GaussianBlur(rng.integers(0, 256, side, dtype=np.uint8), (0, 0), 5) for _ in how.planes]
    out = np.empty((*side, 3), np.uint8)
    best = np.inf
    for _ in range(40):
        start = time.perf_counter()
        mixer.mix(planes, out)
        best = min(best, time.perf_counter() - start)
    return best * 1e3 / 1.048576


def main() -> None:
    cv2.setNumThreads(1)
    views = pictures()
    copy = np.zeros((1024, 1024, 3), np.uint8)
    target = copy.copy()
    best = min(_copy_s(copy, target) for _ in range(40))
    print(f"{len(views)} pictures; a copy of the same bytes: {best * 1e3 / 1.048576:.3f} ms/MP")
    print("method                 light  ghost%  fused  rivalry    p95  leak L  leak R  error  p99.9 planes ms/MP")
    for name in MATRICES:
        for light, ghost in (("gamma", 0.0), ("linear", 0.0), ("linear", 100.0)):
            crossed = name.startswith("dubois")
            if (light == "gamma" and not crossed) or (ghost and name.startswith("dubois-")):
                continue
            how = recipe(name, light, ghost)
            line = f"{name:22s} {light if crossed else '-':6s} {ghost:6.0f} "
            if name == "dubois-amber-blue":  # no spectra of these glasses are at hand
                line += " " * 45
            else:
                glasses = GREEN_MAGENTA if name == "dubois-green-magenta" else RED_CYAN
                seen = measure(views, lambda left, right, how=how: encode(left, right, how), glasses)  # type: ignore[misc]
                line += f"{seen.fused_error:6.2f} {seen.rivalry_mean:8.2f} {seen.rivalry_p95:6.2f} "
                line += f"{100 * seen.leak_left:7.1f} {100 * seen.leak_right:7.1f}"
            if ghost:
                line += " " * 14
            else:
                wrong = np.concatenate([np.abs(encode(v, v, how) - exact(v, name, light)).ravel() for v in views])
                line += f" {wrong.mean():6.2f} {np.percentile(wrong, 99.9):6.1f}"
            print(f"{line} {len(how.planes):6d} {mixing_ms(name, light, ghost):5.2f}")


def _copy_s(source: NDArray[np.uint8], target: NDArray[np.uint8]) -> float:
    start = time.perf_counter()
    np.copyto(target, source)
    return time.perf_counter() - start


if __name__ == "__main__":
    main()
