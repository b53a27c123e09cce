"""Textures of the demo's scenes: wallpaper, an eye chart, wood, balls, grass. Lengths are texels, TEXELS to a px."""

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.scene.demo_layers import Picture

Floats = NDArray[np.float32]
Colour = tuple[int, int, int]  # red, green, blue

TEXELS = 2  # texture px to one px of the picture


def noise(rng: np.random.Generator, height: int, width: int, grain: tuple[float, float], octaves: int = 4) -> Floats:
    """Smooth noise about 0, standard deviation 1. grain: (vertical, horizontal) size of its largest features in px."""
    total = np.zeros((height, width), np.float32)
    for octave in range(octaves):
        cells = [max(2, int(np.ceil(n * 2**octave / g)) + 2) for n, g in zip((height, width), grain, strict=True)]
        field = rng.standard_normal(cells).astype(np.float32)
        total += cv2.resize(field, (width, height), interpolation=cv2.INTER_CUBIC) * 0.55**octave
    return np.asarray((total - total.mean()) / total.std(), np.float32)


def coloured(value: Floats, dark: Colour, light: Colour) -> Floats:
    """value 0..1 between two colours given as (red, green, blue); float32 BGR."""
    mix = np.clip(value, 0, 1)
    planes = [np.float32(low) * (1 - mix) + np.float32(high) * mix for low, high in zip(dark[::-1], light[::-1], strict=True)]
    return np.asarray(cv2.merge(planes), np.float32)


def opaque(colour: Floats) -> Picture:
    picture = np.clip(colour + 0.5, 0, 255).astype(np.uint8)
    picture = cv2.GaussianBlur(picture, (0, 0), 0.35 * TEXELS)  # nothing finer than a px: no moiré when the view changes
    return np.dstack([picture, np.full(picture.shape[:2], 255, np.uint8)])


def wood(rng: np.random.Generator, height: int, width: int, dark: Colour, light: Colour) -> Floats:
    rows = np.arange(height, dtype=np.float32)[:, None]
    warp = noise(rng, height, width, (height / 2, width / 1.5), 3)
    rings = np.sin(rows / (3.2 * TEXELS) + 3.0 * warp)
    fibre = noise(rng, height, width, (1.5 * TEXELS, 60 * TEXELS), 2)
    return coloured(0.5 + 0.22 * rings + 0.16 * fibre + 0.06 * warp, dark, light)


def text(picture: Floats, text: str, centre: tuple[float, float], height: float, colour: Colour) -> None:
    """Writes text about centre (x, y), both in texels."""
    face = cv2.FONT_HERSHEY_DUPLEX
    (_, unit), _ = cv2.getTextSize(text, face, 1.0, 1)
    scale = height / unit
    thick = max(1, round(height / 7))
    (w, h), _ = cv2.getTextSize(text, face, scale, thick)
    ink = np.zeros(picture.shape[:2], np.uint8)  # putText supports only 8 bits
    cv2.putText(ink, text, (round(centre[0] - w / 2), round(centre[1] + h / 2)), face, scale, 255, thick, cv2.LINE_AA)
    picture += (ink / np.float32(255))[..., None] * (np.array(colour[::-1], np.float32) - picture)


def wall(rng: np.random.Generator, height: int, width: int) -> Floats:
    y, x = (np.arange(count, dtype=np.float32) / TEXELS for count in (height, width))
    paper = coloured(0.5 + 0.1 * noise(rng, height, width, (90, 90)), (96, 122, 112), (168, 188, 170))
    pitch = 34  # px between motifs; in the next column they stand half as much lower
    tile_y, tile_x = y[: pitch * TEXELS, None], x[None, : 2 * pitch * TEXELS]
    px, py = (tile_x % pitch) - pitch / 2, ((tile_y + np.floor(tile_x / pitch) % 2 * pitch / 2) % pitch) - pitch / 2
    for tilt in (-0.6, 0.6):  # two leaves to a motif
        cos, sin = np.cos(tilt), np.sin(tilt)
        along, across = cos * py + sin * px, -sin * py + cos * px
        leaf = np.clip(3.2 - np.hypot(across * 2.6, along - 3) * 0.36, 0, 1)
        vein = np.clip(1.2 - np.abs(across) * 1.6, 0, 1) * leaf
        repeats = -(-height // leaf.shape[0]), -(-width // leaf.shape[1])
        leaf, vein = (np.tile(tile, repeats)[:height, :width, None] for tile in (leaf * 0.85, vein * 26))
        paper += leaf * (np.array([92, 132, 96], np.float32) - paper) + vein
    stripe = np.clip(1.1 - np.abs((x % (2 * pitch)) - pitch) * 1.2, 0, 1)
    paper += (stripe * 30)[:, None] * np.array([0.7, 0.9, 1.0], np.float32)
    light = 1.1 - 0.0013 * np.hypot(x - width / TEXELS * 0.32, (y[:, None] - height / TEXELS * 0.22) * 1.2)
    return np.asarray(paper * light[..., None], np.float32)


LETTERS = (("E", 0.20), ("F P", 0.125), ("T O Z", 0.09), ("L P E D", 0.066), ("P E C F D", 0.05), ("E D F C Z P", 0.038))


def chart(width: int, height: int) -> Floats:
    picture = np.full((height, width, 3), (216, 232, 238), np.float32)
    cv2.rectangle(picture, (0, 0), (width - 1, height - 1), (40, 62, 84), round(0.10 * width))
    y = 0.17 * height
    for line, size in LETTERS:
        text(picture, line, (width / 2, y + size * height / 2), size * height, (34, 34, 40))
        y += (size + 0.036) * height
    return picture


def card(width: int, height: int) -> Floats:
    ramp = np.linspace(0, 1, height, dtype=np.float32)[:, None].repeat(width, 1)
    picture = np.ascontiguousarray(coloured(ramp, (206, 74, 48), (150, 36, 52)))
    cv2.rectangle(picture, (8, 8), (width - 9, height - 9), (196, 224, 240), 3)
    text(picture, "LIGHT", (width / 2, 0.16 * height), 0.11 * height, (250, 240, 214))
    text(picture, "FIELD", (width / 2, 0.32 * height), 0.11 * height, (250, 240, 214))
    for k, line in enumerate(("one picture", "for each eye,", "from wherever", "you look")):
        text(picture, line, (width / 2, (0.50 + 0.105 * k) * height), 0.050 * height, (246, 222, 196))
    return picture


def planet(rng: np.random.Generator, height: int, width: int) -> Picture:
    lie = noise(rng, height, width, (height / 2.5, width / 5), 6)
    sea = coloured(0.5 + 0.25 * lie, (18, 52, 120), (52, 128, 176))
    land = coloured(0.1 + 0.4 * lie, (92, 124, 54), (206, 182, 120))
    shore = np.clip((lie - 0.15) * 8, 0, 1)[..., None]
    cloud = np.clip(noise(rng, height, width, (height / 6, width / 6), 5) * 0.8 - 0.7, 0, 0.85)[..., None]
    mixed = (sea * (1 - shore) + land * shore) * (1 - cloud) + 245 * cloud
    return np.asarray(cv2.GaussianBlur(np.clip(mixed, 0, 255).astype(np.uint8), (0, 0), 1.0), np.uint8)


def checked(height: int, width: int, cells: int, one: Colour, other: Colour) -> Picture:
    y, x = np.mgrid[0:height, 0:width]
    wave = np.sin(2 * np.pi * x / width * cells) * np.sin(np.pi * y / height * cells)
    return np.asarray(coloured(np.asarray(0.5 + wave * 12, np.float32), one, other), np.uint8)


def marble(rng: np.random.Generator, height: int, width: int) -> Picture:
    x = np.arange(width, dtype=np.float32)[None, :] / width
    bands = 6 * x + 1.3 * noise(rng, height, width, (height / 2, width / 4), 5)
    veins = np.asarray(np.abs(np.sin(np.pi * bands)) ** 0.45, np.float32)
    return np.asarray(coloured(veins, (120, 40, 30), (240, 226, 206)), np.uint8)


def grass(rng: np.random.Generator, height: int, width: int, blades: int) -> Picture:
    colour = np.zeros((height, width, 3), np.float32)
    colour[:] = (44, 110, 70)
    alpha = np.zeros((height, width), np.uint8)
    t = np.linspace(0, 1, 40)
    for _ in range(blades):
        foot, lean, tall = rng.uniform(0.12, 0.88) * width, rng.normal(0, 0.2) * width, rng.uniform(0.55, 0.97) * height
        x, y = foot + lean * t**2, height - tall * t * (1 - 0.12 * t)
        half = 2.3 * TEXELS * (1 - t) ** 0.6 + 0.35 * TEXELS
        outline = np.concatenate([np.column_stack([x - half, y]), np.column_stack([x + half, y])[::-1]])
        points = np.round(outline * 16).astype(np.int32)
        green = rng.uniform(0.75, 1.25)
        cv2.fillPoly(colour, [points], (46 * green, 150 * green, 92 * green), cv2.LINE_8, 4)
        rib = np.round(np.column_stack([x, y]) * 16).astype(np.int32)
        cv2.polylines(colour, [rib], False, (70 * green, 190 * green, 130 * green), 1, cv2.LINE_AA, 4)
        cv2.fillPoly(alpha, [points], 255, cv2.LINE_AA, 4)
    picture = cv2.GaussianBlur(np.clip(colour, 0, 255).astype(np.uint8), (0, 0), 0.3 * TEXELS)
    return np.dstack([(picture * (alpha[..., None] / 255) + 0.5).astype(np.uint8), alpha])


def shade(picture: Floats, at: tuple[float, float], reach: tuple[float, float], strength: float) -> None:
    """Darkens picture about `at` (x, y) as a soft shadow, in px of the texture."""
    cols, rows = (slice(max(0, round(middle - 6 * far)), round(middle + 6 * far)) for middle, far in zip(at, reach, strict=True))
    window = picture[rows, cols]  # beyond, a float32 does not get darker
    y, x = (np.arange(n, dtype=np.float32)[span] for n, span in zip(picture.shape[:2], (rows, cols), strict=True))
    fall = np.exp(-0.5 * (((x - at[0]) / reach[0]) ** 2 + ((y[:, None] - at[1]) / reach[1]) ** 2))
    window *= (1 - strength * fall)[..., None]


def crate(rng: np.random.Generator, width: int, height: int) -> Floats:
    picture = np.ascontiguousarray(wood(rng, height, width, (150, 98, 48), (222, 176, 112)))
    for k in range(1, 4):
        cv2.line(picture, (0, k * height // 4), (width, k * height // 4), (28, 48, 74), 3)
    rim = round(0.09 * width)
    frame = wood(rng, height, width, (128, 80, 40), (200, 150, 92))
    inner = np.zeros((height, width), np.uint8)
    inner[rim:-rim, rim:-rim] = 1
    picture[inner == 0] = frame[inner == 0]
    cv2.rectangle(picture, (rim, rim), (width - rim, height - rim), (26, 44, 66), 2)
    text(picture, "9 x 9", (width / 2, 0.40 * height), 0.17 * height, (62, 34, 20))
    text(picture, "THIS SIDE UP", (width / 2, 0.66 * height), 0.072 * height, (62, 34, 20))
    return picture
