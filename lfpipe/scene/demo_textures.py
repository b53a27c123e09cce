"""Textures of the demo scenes: wallpaper, an eye chart, wood, balls, grass. Colours are RGB.
Lengths are in texels, TEXELS per px.
"""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.scene.demo_drawing import Floats, Picture

Colour = tuple[int, int, int]
Texture = Callable[[np.random.Generator, int, int], Picture]  # (rng, height, width)

TEXELS = 2  # of a flat picture per px of a view; `opaque` removes detail that a view cannot show


def noise(
    rng: np.random.Generator, height: int, width: int, grain: tuple[float, float], octaves: int = 4
) -> Floats:
    """Smooth noise about 0, standard deviation 1.

    grain: (vertical, horizontal) size of its largest features.
    """
    total = np.zeros((height, width), np.float32)
    for octave in range(octaves):
        cells = [
            max(2, int(np.ceil(n * 2**octave / g)) + 2)
            for n, g in zip((height, width), grain, strict=True)
        ]
        field = rng.standard_normal(cells).astype(np.float32)
        total += cv2.resize(field, (width, height), interpolation=cv2.INTER_CUBIC) * 0.55**octave
    return np.asarray((total - total.mean()) / total.std(), np.float32)


def mixed(share: NDArray[np.floating], dark: Colour | Floats, light: Colour | Floats) -> Floats:
    """A mixture of two colours, float32 (h, w, 3). share (h, w): of the light one; is clipped."""
    weight = np.clip(share, 0, 1).astype(np.float32)[..., None]
    return np.asarray(
        (1 - weight) * np.asarray(dark, np.float32) + weight * np.asarray(light, np.float32),
        np.float32,
    )


def opaque(colour: NDArray[Any], scale: float = 1.0) -> Picture:
    """A texture of a flat picture without detail finer than a px, which would cause moire when the
    view changes. scale: of the view, against SIZE_PX.
    """
    sigma = 0.5 * TEXELS / scale
    picture = cv2.GaussianBlur(np.clip(colour, 0, 255).astype(np.uint8), (0, 0), sigma)
    return np.dstack([picture, np.full(picture.shape[:2], 255, np.uint8)])


def wood(rng: np.random.Generator, height: int, width: int, dark: Colour, light: Colour) -> Floats:
    warp = noise(rng, height, width, (height / 2, width / 1.5), 3)
    rings = np.sin(np.arange(height)[:, None] / 2.6 + 3.0 * warp)
    fibre = noise(rng, height, width, (1.5, 60), 2)
    return mixed(0.5 + 0.22 * rings + 0.16 * fibre + 0.06 * warp, dark, light)


def wall(rng: np.random.Generator, height: int, width: int) -> Picture:
    """Wallpaper with pairs of leaves, lit from above, left of its middle."""
    tile = np.full((72, 144, 3), (126, 150, 136), np.uint8)
    for across, down in ((36, 24), (108, 60)):
        for tilt in (-32, 32):
            cv2.ellipse(
                tile,
                (across + tilt // 4, down),
                (6, 17),
                -tilt,
                0,
                360,
                (92, 128, 98),
                -1,
                cv2.LINE_AA,
            )
    cv2.line(tile, (0, 0), (0, 72), (150, 172, 154), 3)
    paper = np.tile(tile, (height // 72 + 1, width // 144 + 1, 1))[:height, :width]
    low = height // 8, width // 8  # illumination is smooth
    y, x = np.ogrid[: 1 : low[0] * 1j, : 1 : low[1] * 1j]
    light = (1.0 - 0.52 * np.hypot(x - 0.32, y - 0.22)).astype(np.float32) + 0.05 * noise(
        rng, *low, (22, 22)
    )
    light = cv2.resize(light, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(cv2.multiply(paper, cv2.merge([light] * 3), dtype=cv2.CV_8U), np.uint8)


# text, its height and the height of its middle, as shares of the poster's height
LETTERS = (
    ("E", 0.2, 0.27),
    ("F P", 0.125, 0.469),
    ("T O Z", 0.09, 0.612),
    ("L P E D", 0.066, 0.726),
    ("P E C F D", 0.05, 0.82),
    ("E D F C Z P", 0.038, 0.9),
)
TITLE = (
    ("LIGHT", 0.11, 0.16),
    ("FIELD", 0.11, 0.32),
    ("one picture", 0.05, 0.5),
    ("for each eye,", 0.05, 0.605),
    ("from wherever", 0.05, 0.71),
    ("you look", 0.05, 0.815),
)


def poster(
    width: int,
    height: int,
    lines: tuple[tuple[str, float, float], ...],
    paper: tuple[Colour, Colour],
    ink: Colour,
    edge: Colour,
) -> Picture:
    """Lines of text on paper whose colour changes downwards, with a frame."""
    picture = mixed(np.linspace(0, 1, height)[:, None].repeat(width, 1), *paper).astype(np.uint8)
    cv2.rectangle(picture, (6, 6), (width - 7, height - 7), edge, 12)
    face = cv2.FONT_HERSHEY_DUPLEX
    for text, size, middle in lines:
        thick = max(1, round(size * height / 7))
        scale = size * height / cv2.getTextSize(text, face, 1.0, 1)[0][1]
        (w, h), _ = cv2.getTextSize(text, face, scale, thick)
        at = round(width / 2 - w / 2), round(middle * height + h / 2)
        cv2.putText(picture, text, at, face, scale, ink, thick, cv2.LINE_AA)
    return picture


def planet(rng: np.random.Generator, height: int, width: int) -> Picture:
    lie = noise(rng, height, width, (height / 2.5, width / 5), 6)
    sea = mixed(0.5 + 0.25 * lie, (18, 52, 120), (52, 128, 176))
    land = mixed(0.1 + 0.4 * lie, (92, 124, 54), (206, 182, 120))
    clouds = 0.8 * noise(rng, height, width, (height / 6, width / 6), 5) - 0.7
    return mixed(
        np.minimum(clouds, 0.85), mixed((lie - 0.15) * 8, sea, land), (245, 245, 245)
    ).astype(np.uint8)


def marble(rng: np.random.Generator, height: int, width: int) -> Picture:
    bands = 6 * np.arange(width) / width + 1.3 * noise(
        rng, height, width, (height / 2, width / 4), 5
    )
    return mixed(np.abs(np.sin(np.pi * bands)) ** 0.45, (120, 40, 30), (240, 226, 206)).astype(
        np.uint8
    )


def _checked(one: Colour, other: Colour) -> Texture:
    def checked(_rng: np.random.Generator, height: int, width: int) -> Picture:
        y, x = np.ogrid[:height, :width]
        wave = np.sin(2 * np.pi * x / width * 7) * np.sin(np.pi * y / height * 7)
        return mixed(0.5 + wave * height / 25, one, other).astype(np.uint8)  # edges one texel wide

    return checked


blue, red = _checked((240, 196, 40), (30, 84, 150)), _checked((236, 232, 220), (176, 30, 44))


def grass(rng: np.random.Generator, height: int, width: int, blades: int) -> Picture:
    colour = np.full((height, width, 3), (70, 110, 44), np.uint8)
    alpha = np.zeros((height, width), np.uint8)
    t = np.linspace(0, 1, 24)
    for _ in range(blades):
        foot = rng.uniform(0.12, 0.88) * width
        lean = rng.normal(0, 0.2) * width
        tall = rng.uniform(0.55, 0.97) * height
        x = foot + lean * t**2
        y = height - tall * t * (1 - 0.12 * t)
        half = 2.3 * TEXELS * (1 - t) ** 0.6 + 0.35 * TEXELS
        edges = (
            np.column_stack([x - half, y]),
            np.column_stack([x + half, y])[::-1],
            np.column_stack([x, y]),
        )
        left, right, rib = (np.round(edge * 16).astype(np.int32) for edge in edges)
        green = rng.uniform(0.75, 1.25)
        cv2.fillPoly(
            colour,
            [np.concatenate([left, right])],
            (92 * green, 150 * green, 46 * green),
            cv2.LINE_8,
            4,
        )
        cv2.polylines(
            colour, [rib], False, (130 * green, 190 * green, 70 * green), 1, cv2.LINE_AA, 4
        )
        cv2.fillPoly(alpha, [np.concatenate([left, right])], 255, cv2.LINE_AA, 4)
    blended = cv2.multiply(
        cv2.GaussianBlur(colour, (0, 0), 0.3 * TEXELS), cv2.merge([alpha] * 3), scale=1 / 255
    )
    return np.dstack([blended, alpha])


def shadow(strength: float) -> Picture:
    """A soft black blob. strength: at most 0.5, so that the surface below keeps its disparity."""
    y, x = np.ogrid[-1:1:64j, -1:1:64j]
    blob = np.zeros((64, 64, 4), np.uint8)
    blob[..., 3] = 254 * strength * np.clip(1 - x * x - y * y, 0, 1) ** 1.5
    return blob
