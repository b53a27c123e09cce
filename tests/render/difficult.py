"""Scenes on which a warp fails: fine dither, noise, wires thinner than a pixel, moving highlights, repetition.

A scene is layers of texture, each at a disparity, seen by a grid of cameras; every view between is known as well.
"""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.synthesis import subsample
from lfpipe.scene.lightfield import Geometry, LightField

Plane = NDArray[np.float32]
Layer = tuple[Plane, Plane, float]  # picture, opacity, px per step
SIDE, PAD, STEPS = 96, 24, 2  # px of a view, px around it, cameras per stored step


def _seen(plane: Plane, row: float, col: float, px: float) -> Plane:
    move = np.array([[1, 0, PAD + px * col], [0, 1, PAD + px * row]], np.float32)
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(plane, move, (SIDE, SIDE), flags=flags, borderMode=cv2.BORDER_REFLECT), np.float32)


def _view(layers: list[Layer], row: float, col: float) -> Plane:
    out = np.zeros((SIDE, SIDE), np.float32)
    for picture, opacity, px in layers:
        alpha = np.clip(_seen(opacity, row, col, px), 0, 1)
        out = _seen(picture, row, col, px) * alpha + out * (1 - alpha)
    return out


def _noise(rng: np.random.Generator, blur: float, low: float = 0, high: float = 255) -> Plane:
    found = rng.normal(size=(SIDE + 2 * PAD,) * 2).astype(np.float32)
    found = cv2.GaussianBlur(found, (0, 0), blur) if blur else found
    found = (found - found.mean()) / found.std()
    return np.asarray(np.clip((low + high) / 2 + found * (high - low) / 5, low, high), np.float32)


def _all() -> Plane:
    return np.ones((SIDE + 2 * PAD,) * 2, np.float32)


def _grid() -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    y, x = np.mgrid[: SIDE + 2 * PAD, : SIDE + 2 * PAD]
    return y, x


def _dots(rng: np.random.Generator) -> list[Layer]:
    y, x = _grid()
    stripes = (120 + 60 * ((x // 12) % 2)).astype(np.float32)
    dots = ((x % 5 < 2) & (y % 5 < 2)).astype(np.float32) * (rng.random(x.shape) < 0.7)
    return [(stripes, _all(), 0.6), (np.full_like(stripes, 20), dots.astype(np.float32), 1.6)]


def _dithered(rng: np.random.Generator) -> list[Layer]:
    y, x = _grid()
    raster = np.where((x + y) % 2, 70, 185).astype(np.float32)  # of the sensor: it stays where it is
    return [(_noise(rng, 4), _all(), 1.7), (raster, np.full_like(raster, 0.4), 0.0)]


def _wires(rng: np.random.Generator) -> list[Layer]:
    y, x = _grid()
    lines = (np.abs((x + 0.4 * y) % 17 - 8) < 0.8) | (np.abs((x - 0.7 * y) % 29 - 14) < 0.8)
    return [(_noise(rng, 2, 60, 200), _all(), -1.0), (np.full(x.shape, 250, np.float32), lines.astype(np.float32), 3.0)]


def _highlight(rng: np.random.Generator) -> list[Layer]:
    y, x = _grid()
    glow = np.exp(-((x - 70) ** 2 + (y - 70) ** 2) / 300).astype(np.float32) + 0.7 * np.exp(-((x - 45) ** 2 + (y - 90) ** 2) / 40)
    return [(_noise(rng, 3, 20, 120), _all(), 2.0), (np.full(x.shape, 255, np.float32), glow.astype(np.float32), -3.0)]


def _repeated(rng: np.random.Generator) -> list[Layer]:
    y, x = _grid()
    return [((128 + 90 * np.sin(x * 2.1) * np.sin(y * 2.3)).astype(np.float32), _all(), 1.5)]


def _glass(rng: np.random.Generator) -> list[Layer]:
    return [(_noise(rng, 2), _all(), 2.0), (_noise(rng, 2), 0.5 * _all(), -2.0)]


# layers, and the standard deviation of noise that each camera has for itself
KINDS: dict[str, tuple[Callable[[np.random.Generator], list[Layer]], float]] = {
    "dots over stripes": (_dots, 3.0),
    "fixed dither": (_dithered, 0.0),
    "thin wires": (_wires, 0.0),
    "moving highlight": (_highlight, 0.0),
    "repetition": (_repeated, 2.0),
    "reflecting glass": (_glass, 0.0),
    "fine texture": (lambda rng: [(_noise(rng, 0), _all(), 1.4)], 4.0),
    "fine texture, flat": (lambda rng: [(_noise(rng, 0), _all(), 0.3)], 4.0),
    "noise in the dark": (lambda rng: [(_noise(rng, 3, 10, 24), _all(), 0.8)], 6.0),
    "noise alone": (lambda rng: [(_noise(rng, 0, 100, 101), _all(), 0.0)], 20.0),
    "ordinary": (lambda rng: [(_noise(rng, 2), _all(), 1.5)], 0.0),
}


def scene(kind: str, kept: int = 2) -> tuple[LightField, dict[tuple[float, float], NDArray[np.uint8]]]:
    """A field of kept x kept views with estimated disparity, and the views between them by place."""
    make, noise = KINDS[kind]
    rng = np.random.default_rng(len(kind))
    layers = make(rng)
    side = (kept - 1) * STEPS + 1
    exact = {(r, c): _view(layers, r, c) + rng.normal(0, noise, (SIDE, SIDE)) for r in range(side) for c in range(side)}
    drawn = {(r / STEPS, c / STEPS): np.clip(np.rint(view), 0, 255).astype(np.uint8) for (r, c), view in exact.items()}
    views = np.stack([[drawn[float(r), float(c)] for c in range(kept)] for r in range(kept)])[None, :, :, None]
    maps = np.zeros((1, kept, kept, SIDE // 2, SIDE // 2), np.int8)
    field = LightField(
        views, maps, 1.0, 0.0, 0.0, "estimated", np.zeros((kept, kept, 2), np.float32), np.ones((kept, kept), bool), Geometry(),
        0.0, kind, "warp2", {},
    )  # fmt: skip
    field = subsample(field, range(kept), range(kept))
    return field, {place: view for place, view in drawn.items() if place[0] % 1 or place[1] % 1}
