"""Scenes on which a warp fails: fine dither, noise, wires thinner than a pixel, moving highlights,
repetition.

A scene is layers of texture, each at a disparity, seen by a grid of cameras; every view between is
known as well.
"""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.synthesis import subsample
from lfpipe.scene.lightfield import LightField
from tests.render.rendered import light_field

Plane = NDArray[np.float32]
Layer = tuple[Plane, Plane, float]  # picture, opacity, px per step
SIDE, PAD, STEPS = 96, 24, 2  # px of a view, px around it, cameras per stored step


def _seen(plane: Plane, row: float, col: float, px: float) -> Plane:
    move = np.array([[1, 0, PAD + px * col], [0, 1, PAD + px * row]], np.float32)
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    return np.asarray(
        cv2.warpAffine(plane, move, (SIDE, SIDE), flags=flags, borderMode=cv2.BORDER_REFLECT),
        np.float32,
    )


def _view(layers: list[Layer], row: float, col: float) -> Plane:
    out = np.zeros((SIDE, SIDE), np.float32)
    for picture, opacity, px in layers:
        alpha = np.clip(_seen(opacity, row, col, px), 0, 1)
        out = _seen(picture, row, col, px) * alpha + out * (1 - alpha)
    return out


Y, X = np.mgrid[: SIDE + 2 * PAD, : SIDE + 2 * PAD]
WHOLE = np.ones(X.shape, np.float32)


def _noise(rng: np.random.Generator, blur: float, low: float = 0, high: float = 255) -> Plane:
    noise = rng.normal(size=X.shape).astype(np.float32)
    noise = cv2.GaussianBlur(noise, (0, 0), blur) if blur else noise
    noise = (noise - noise.mean()) / noise.std()
    return np.asarray(np.clip((low + high) / 2 + noise * (high - low) / 5, low, high), np.float32)


def _layer(
    picture: NDArray[np.float64] | float, opacity: NDArray[np.float64] | float, px: float
) -> Layer:
    return (WHOLE * picture).astype(np.float32), (WHOLE * opacity).astype(np.float32), px


def _dots(rng: np.random.Generator) -> list[Layer]:
    dots = ((X % 5 < 2) & (Y % 5 < 2)) * (rng.random(X.shape) < 0.7)
    return [_layer(120 + 60 * ((X // 12) % 2), 1, 0.6), _layer(20, dots, 1.6)]


def _wires(rng: np.random.Generator) -> list[Layer]:
    lines = (np.abs((X + 0.4 * Y) % 17 - 8) < 0.8) | (np.abs((X - 0.7 * Y) % 29 - 14) < 0.8)
    return [(_noise(rng, 2, 60, 200), WHOLE, -1.0), _layer(250, lines, 3.0)]


def _highlight(rng: np.random.Generator) -> list[Layer]:
    glow = np.exp(-((X - 70) ** 2 + (Y - 70) ** 2) / 300) + 0.7 * np.exp(
        -((X - 45) ** 2 + (Y - 90) ** 2) / 40
    )
    return [(_noise(rng, 3, 20, 120), WHOLE, 2.0), _layer(255, glow, -3.0)]


# layers, and the standard deviation of noise that each camera has for itself
KINDS: dict[str, tuple[Callable[[np.random.Generator], list[Layer]], float]] = {
    "dots over stripes": (_dots, 3.0),
    # the raster of a sensor stays where it is
    "fixed dither": (
        lambda rng: [
            (_noise(rng, 4), WHOLE, 1.7),
            _layer(np.where((X + Y) % 2, 70, 185), 0.4, 0.0),
        ],
        0.0,
    ),
    "thin wires": (_wires, 0.0),
    "moving highlight": (_highlight, 0.0),
    "repetition": (lambda rng: [_layer(128 + 90 * np.sin(X * 2.1) * np.sin(Y * 2.3), 1, 1.5)], 2.0),
    "reflecting glass": (
        lambda rng: [(_noise(rng, 2), WHOLE, 2.0), (_noise(rng, 2), 0.5 * WHOLE, -2.0)],
        0.0,
    ),
    "fine texture": (lambda rng: [(_noise(rng, 0), WHOLE, 1.4)], 4.0),
    "fine texture, flat": (lambda rng: [(_noise(rng, 0), WHOLE, 0.3)], 4.0),
    "noise in the dark": (lambda rng: [(_noise(rng, 3, 10, 24), WHOLE, 0.8)], 6.0),
    "noise alone": (lambda rng: [(_noise(rng, 0, 100, 101), WHOLE, 0.0)], 20.0),
    "ordinary": (lambda rng: [(_noise(rng, 2), WHOLE, 1.5)], 0.0),
}


def scene(
    kind: str, kept: int = 2
) -> tuple[LightField, dict[tuple[float, float], NDArray[np.uint8]]]:
    """A field of kept x kept views with estimated disparity, and the views between them by
    place.
    """
    make, noise = KINDS[kind]
    rng = np.random.default_rng(len(kind))
    layers = make(rng)
    side = (kept - 1) * STEPS + 1
    exact = {
        (r, c): _view(layers, r, c) + rng.normal(0, noise, (SIDE, SIDE))
        for r in range(side)
        for c in range(side)
    }
    drawn = {
        (r / STEPS, c / STEPS): np.clip(np.rint(view), 0, 255).astype(np.uint8)
        for (r, c), view in exact.items()
    }
    views = np.stack([[drawn[float(r), float(c)] for c in range(kept)] for r in range(kept)])[
        None, :, :, None
    ]
    unknown = np.zeros((1, kept, kept, SIDE // 2, SIDE // 2), np.int8)
    field = subsample(light_field(views, unknown, 1.0, 0.0, 0.0), range(kept), range(kept))
    return field, {place: view for place, view in drawn.items() if place[0] % 1 or place[1] % 1}
