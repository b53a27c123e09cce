"""What each anaglyph method does to colour, comfort and ghosts, through simulated glasses, and what a picture costs.

usage: python profiling/anaglyph_colours.py [PICTURE ...]     default: one view of each scene in ../shared/data/lightfields
fused: mean CIELAB error of what both eyes see together. rivalry: difference in L* between the eyes, mean and 95th percentile.
leak: light of the other eye on mid grey, in % (negative: over-corrected). error: of the table form against the published matrix,
in code values.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.anaglyph import SIDE_PX, Mixing, exact, view_bgr
from lfpipe.bench.timing import times_ms
from lfpipe.config import Scene
from lfpipe.errors import UserError
from lfpipe.render.anaglyph import LEAKS, MATRICES, encode, recipe
from lfpipe.render.colour_metric import BARE, GREEN_MAGENTA, RED_CYAN, lab, measure, rivalry, seen_xyz
from lfpipe.scene.pack import open_scene

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "lightfields"
MEGAPIXELS = SIDE_PX * SIDE_PX / 1e6
SCENES = ("hci_antinous", "lytro_2067", "hci_old_stillLife_3x3", "stanford_lego_knights_17x17", "atlas_jarabo_toys_9x9")


def pictures() -> list[NDArray[np.uint8]]:
    if len(sys.argv) > 1:
        return [np.asarray(cv2.imread(name), np.uint8) for name in sys.argv[1:]]
    found = []
    print("scene                        chroma  rivalry of colour, of dubois by its tables, by its matrix (p95, linear light)")
    for name in SCENES:
        try:
            field = open_scene(DATA / name, Scene())
        except UserError as error:
            print(f"left out: {name}: {error.message}")
            continue
        found.append(view_bgr(field, field.rows // 2, field.cols // 2))
        told(name, found[-1])
    return found


def told(name: str, view: NDArray[np.uint8]) -> None:
    """One picture's line: rivalry is a matter of how much colour there is in it, so sets of pictures differ."""
    colours = lab(seen_xyz(view, BARE), BARE.sum(axis=1))
    chroma = float(np.hypot(colours[..., 1], colours[..., 2]).mean())
    whole = np.rint(exact(view, "dubois", "linear")).astype(np.uint8)
    drawn = (encode(view, view, recipe("colour")), encode(view, view, recipe("dubois")), whole)
    print(f"{name:28s} {chroma:6.1f}  " + "  ".join(f"{rivalry(picture)[1]:5.2f}" for picture in drawn))


def mixing_ms(name: str, light: str, ghost: float) -> float:
    """Minimum ms per megapixel of the mixing of ready planes."""
    return min(times_ms(Mixing(name, light, ghost).mix, 40)) / MEGAPIXELS


def main() -> None:
    cv2.setNumThreads(1)
    views = pictures()
    best = min(times_ms(Mixing("colour", "gamma").copy, 40))
    print(f"{len(views)} pictures; a copy of the same bytes: {best / MEGAPIXELS:.3f} ms/MP")
    print("method                 light  ghost%  fused  rivalry    p95  leak L  leak R  error  p99.9 planes ms/MP")
    for name in MATRICES:
        for light, ghost in (("gamma", 0.0), ("linear", 0.0), ("linear", 100.0)):
            crossed = name.startswith("dubois")
            if (light == "gamma" and not crossed) or (ghost and name not in LEAKS):
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


if __name__ == "__main__":
    main()
