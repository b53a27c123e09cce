"""Error of every method of view synthesis against left-out views: inside the grid, beyond it, and along a sweep.

usage: python profiling/synthesis_quality.py [DATA]     DATA: a folder of light fields, ../shared/data/lightfields by default
Disparities are estimated from the kept views alone. Prints one table per question; PSNR in dB, mean over all left-out views.
"""

from __future__ import annotations

import itertools
import sys
import time
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.kept import kept, made
from lfpipe.config import Scene
from lfpipe.quality import drawn_with
from lfpipe.render.scoring import METHODS, choose_method, psnr_db
from lfpipe.render.synthesis import Synthesiser
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.pack import open_scene

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "lightfields"


def left_out(field: LightField, places: list[int], truth: bool = False) -> None:
    """Keeps rows and columns `places`, makes every other view, and prints PSNR by how far outside the kept ones it lies."""
    part = kept(field, places, places, truth)
    step = places[1] - places[0]
    outs = [np.empty((field.height_px, field.width_px), np.uint8) for _ in range(field.channels)]
    whole = np.asarray(field.views)
    for method in METHODS:
        synthesiser = Synthesiser(part, method)
        found: dict[int, list[float]] = {}
        for row, col in itertools.product(range(field.rows), range(field.cols)):
            if row in places and col in places:
                continue
            outside = max(places[0] - row, row - places[-1], places[0] - col, col - places[-1], 0)
            position = ((row - places[0]) / step, (col - places[0]) / step)
            wrong = made(part, synthesiser, position, outs) - whole[0, row, col]
            found.setdefault(outside, []).append(psnr_db(float(np.mean(wrong**2))))
        scores = "   ".join(
            f"{'inside' if not out else f'{out} outside'} {np.mean(values):5.2f} (worst {min(values):5.2f})"
            for out, values in sorted(found.items())
        )
        print(f"  {method:8s} {scores}")


def _shift_px(before: NDArray[np.float32], frame: NDArray[np.float32], patch: tuple[slice, slice], guess_px: float) -> float:
    """Where the patch of `before` stands in frame, px to the right, by maximising the correlation (ECC)."""
    start = np.array([[1, 0, patch[1].start + guess_px], [0, 1, patch[0].start]], np.float32)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-6)
    _, found = cv2.findTransformECC(before[patch], frame, start, cv2.MOTION_TRANSLATION, criteria, None, 3)
    return float(found[0, 2]) - patch[1].start


def sweep(field: LightField, patch: tuple[slice, slice]) -> None:
    """Viewpoint in steps of 0.05 across the columns: largest over median frame difference, and how far a patch stands from
    where it should (RMS, px). Where it should is the line between its places in the two stored views around."""
    row, middle = field.rows // 2, field.cols // 2
    views = np.asarray(field.views)[0, row, :, 1].astype(np.float32)
    assert field.disparity is not None
    half = tuple(slice(s.start // 2, s.stop // 2) for s in patch)
    disparity_px = float(np.median(np.asarray(field.disparity)[0, row, middle][half])) * field.disparity_scale_px
    first, last = 1, field.cols - 2
    stored = [_shift_px(views[middle], views[c], patch, -disparity_px * (c - middle)) for c in range(first, last + 1)]
    cols = np.arange(first, last + 1e-9, 0.05)
    wanted = np.interp(cols, np.arange(first, last + 1), stored)
    print(f"  patch of disparity {disparity_px:.2f} px per view; nearest should miss by {abs(disparity_px) / 12**0.5:.2f} px RMS")
    for method in METHODS:
        synthesiser = Synthesiser(field, method)
        out = [np.empty((field.height_px, field.width_px), np.uint8)]
        frames = []
        for col in cols:
            source = np.asarray(field.views)
            drawn = synthesiser.render((float(row), float(col)), 0, 0.0, [lambda r, c, v=source: v[0, r, c, 1]], out)
            frames.append(drawn[0].astype(np.float32))
        steps = np.array([np.abs(b - a).mean() for a, b in itertools.pairwise(frames)])
        moved = [_shift_px(views[middle], frame, patch, want) for frame, want in zip(frames, wanted, strict=True)]
        error = float(np.sqrt(np.mean((np.array(moved) - wanted) ** 2)))
        ratio = steps.max() / np.median(steps) if np.median(steps) > 0 else np.inf
        print(f"  {method:8s} max/median difference {ratio:5.2f}   position error {error:.3f} px RMS")


def main() -> None:
    data = Path(sys.argv[1]) if len(sys.argv) > 1 else DATA
    names = ("hci_antinous", "lytro_2067", "hci_style_vr_newshot01")
    antinous, lytro, deep = (open_scene(data / name, Scene()) for name in names)
    cv2.setNumThreads(1)
    print("antinous, every 2nd view kept")
    left_out(antinous, [0, 2, 4, 6, 8])
    print("antinous, 3x3 of 9x9 kept")
    left_out(antinous, [0, 4, 8])
    print("antinous, only the middle 3x3 kept")
    left_out(antinous, [3, 4, 5])
    print("lytro_2067, every 2nd view kept")
    left_out(lytro, [0, 2, 4, 6, 8])
    print("vr_newshot01 (to 14.6 px per view), every 2nd view kept")
    left_out(deep, [0, 2, 4, 6, 8])
    print("vr_newshot01, 3x3 kept, true disparities (to 58 px per view): holes")
    left_out(deep, [0, 4, 8], truth=True)
    print("antinous, sweep of the viewpoint: far wall, then near face")
    sweep(antinous, (slice(90, 170), slice(30, 110)))
    sweep(antinous, (slice(240, 320), slice(180, 260)))
    for field in (antinous, lytro, deep):
        start = time.perf_counter()
        method, scores = choose_method(field)
        rounded = {name: round(value, 2) for name, value in scores.items()}
        print(f"auto for {field.name}: {method} {rounded}, chosen in {time.perf_counter() - start:.2f} s")
        asked = (f"{name} is drawn as {drawn_with(name, method, True, scores)}" for name in ("warp", "warp2"))
        print(f"  where it is asked for: {', '.join(asked)}")


if __name__ == "__main__":
    main()
