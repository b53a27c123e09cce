"""The demo's still life: an eye chart on a papered wall; on a table before it a crate, balls, a card with text, and grass.

Lengths are px of a 512x512 centre view. The table rises to its horizon, where a point would stand still: nearer objects appear
lower, as for a camera that looks down a little.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.scene.demo_layers import Ball, Picture, Quad, Solid

Floats = NDArray[np.float32]
Colour = tuple[int, int, int]  # red, green, blue

OFFSET_PX = 8.0  # disparity between infinity and the plane of zero disparity
VANISHING = (256.0, 60.0)  # vanishing point of lines straight away from the camera
WALL_D = -2.0
TABLE_SLOPE = 0.0215  # disparity per px down the table
TEXELS = 2  # texture px to one px of the picture
BALL_DEPTH = 0.0075  # depth of a ball in disparity over its radius in px: a little rounder than life


def table_y(d: float) -> float:
    """The height at which the table has disparity d: its plane reaches infinity at the height of the vanishing point."""
    return VANISHING[1] + (d + OFFSET_PX) / TABLE_SLOPE


def _seen_from(x: float, y: float, d_from: float, d_to: float) -> tuple[float, float]:
    """The position in the centre view of the point straight behind (x, y, d_from), at d_to."""
    scale = (d_to + OFFSET_PX) / (d_from + OFFSET_PX)
    return VANISHING[0] + (x - VANISHING[0]) * scale, VANISHING[1] + (y - VANISHING[1]) * scale


def _noise(rng: np.random.Generator, height: int, width: int, grain: tuple[float, float], octaves: int = 4) -> Floats:
    """Smooth noise about 0, standard deviation 1. grain: (vertical, horizontal) size of its largest features in px."""
    total = np.zeros((height, width), np.float32)
    for octave in range(octaves):
        cells = [max(2, int(np.ceil(n * 2**octave / g)) + 2) for n, g in zip((height, width), grain, strict=True)]
        field = rng.standard_normal(cells).astype(np.float32)
        total += cv2.resize(field, (width, height), interpolation=cv2.INTER_CUBIC) * 0.55**octave
    return np.asarray((total - total.mean()) / total.std(), np.float32)


def _coloured(value: Floats, dark: Colour, light: Colour) -> Floats:
    """value 0..1 between two colours given as (red, green, blue); float32 BGR."""
    mix = np.clip(value, 0, 1)
    planes = [np.float32(low) * (1 - mix) + np.float32(high) * mix for low, high in zip(dark[::-1], light[::-1], strict=True)]
    return np.asarray(cv2.merge(planes), np.float32)


def _opaque(colour: Floats) -> Picture:
    picture = np.clip(colour + 0.5, 0, 255).astype(np.uint8)
    picture = cv2.GaussianBlur(picture, (0, 0), 0.35 * TEXELS)  # nothing finer than a px: no moiré when the view changes
    return np.dstack([picture, np.full(picture.shape[:2], 255, np.uint8)])


def _wood(rng: np.random.Generator, height: int, width: int, dark: Colour, light: Colour) -> Floats:
    rows = np.arange(height, dtype=np.float32)[:, None]
    warp = _noise(rng, height, width, (height / 2, width / 1.5), 3)
    rings = np.sin(rows / (3.2 * TEXELS) + 3.0 * warp)
    fibre = _noise(rng, height, width, (1.5 * TEXELS, 60 * TEXELS), 2)
    return _coloured(0.5 + 0.22 * rings + 0.16 * fibre + 0.06 * warp, dark, light)


def _text(picture: Floats, text: str, centre: tuple[float, float], height: float, colour: Colour) -> None:
    """Writes text about centre (x, y), both in texels."""
    face = cv2.FONT_HERSHEY_DUPLEX
    (_, unit), _ = cv2.getTextSize(text, face, 1.0, 1)
    scale = height / unit
    thick = max(1, round(height / 7))
    (w, h), _ = cv2.getTextSize(text, face, scale, thick)
    ink = np.zeros(picture.shape[:2], np.uint8)  # putText supports only 8 bits
    cv2.putText(ink, text, (round(centre[0] - w / 2), round(centre[1] + h / 2)), face, scale, 255, thick, cv2.LINE_AA)
    picture += (ink / np.float32(255))[..., None] * (np.array(colour[::-1], np.float32) - picture)


def _wall(rng: np.random.Generator, height: int, width: int) -> Floats:
    y, x = (np.arange(count, dtype=np.float32) / TEXELS for count in (height, width))
    paper = _coloured(0.5 + 0.1 * _noise(rng, height, width, (90, 90)), (96, 122, 112), (168, 188, 170))
    pitch = 34  # px between motifs; in the next column they stand half as much lower
    tile_y, tile_x = y[: pitch * TEXELS, None], x[None, : 2 * pitch * TEXELS]
    px, py = (tile_x % pitch) - pitch / 2, ((tile_y + np.floor(tile_x / pitch) % 2 * pitch / 2) % pitch) - pitch / 2
    for tilt in (-0.6, 0.6):  # two leaves to a motif
        cos, sin = np.cos(tilt), np.sin(tilt)
        along, across = cos * py + sin * px, -sin * py + cos * px
        leaf = np.clip(3.2 - np.hypot(across * 2.6, along - 3) * 0.36, 0, 1)
        vein = np.clip(1.2 - np.abs(across) * 1.6, 0, 1) * leaf
        leaf, vein = (_tiled(part, height, width)[..., None] for part in (leaf * 0.85, vein * 26))
        paper += leaf * (np.array([92, 132, 96], np.float32) - paper) + vein
    stripe = np.clip(1.1 - np.abs((x % (2 * pitch)) - pitch) * 1.2, 0, 1)
    paper += (stripe * 30)[:, None] * np.array([0.7, 0.9, 1.0], np.float32)
    light = 1.1 - 0.0013 * np.hypot(x - width / TEXELS * 0.32, (y[:, None] - height / TEXELS * 0.22) * 1.2)
    return np.asarray(paper * light[..., None], np.float32)


def _tiled(tile: Floats, height: int, width: int) -> Floats:
    """tile, repeated over height and width."""
    return np.tile(tile, (-(-height // tile.shape[0]), -(-width // tile.shape[1])))[:height, :width]


LETTERS = (("E", 0.20), ("F P", 0.125), ("T O Z", 0.09), ("L P E D", 0.066), ("P E C F D", 0.05), ("E D F C Z P", 0.038))


def _chart(width: int, height: int) -> Floats:
    picture = np.full((height, width, 3), (216, 232, 238), np.float32)
    cv2.rectangle(picture, (0, 0), (width - 1, height - 1), (40, 62, 84), round(0.10 * width))
    y = 0.17 * height
    for line, size in LETTERS:
        _text(picture, line, (width / 2, y + size * height / 2), size * height, (34, 34, 40))
        y += (size + 0.036) * height
    return picture


def _card(width: int, height: int) -> Floats:
    ramp = np.linspace(0, 1, height, dtype=np.float32)[:, None].repeat(width, 1)
    picture = np.ascontiguousarray(_coloured(ramp, (206, 74, 48), (150, 36, 52)))
    cv2.rectangle(picture, (8, 8), (width - 9, height - 9), (196, 224, 240), 3)
    _text(picture, "LIGHT", (width / 2, 0.16 * height), 0.11 * height, (250, 240, 214))
    _text(picture, "FIELD", (width / 2, 0.32 * height), 0.11 * height, (250, 240, 214))
    for k, line in enumerate(("one picture", "for each eye,", "from wherever", "you look")):
        _text(picture, line, (width / 2, (0.50 + 0.105 * k) * height), 0.050 * height, (246, 222, 196))
    return picture


def _planet(rng: np.random.Generator, height: int, width: int) -> Picture:
    lie = _noise(rng, height, width, (height / 2.5, width / 5), 6)
    sea = _coloured(0.5 + 0.25 * lie, (18, 52, 120), (52, 128, 176))
    land = _coloured(0.1 + 0.4 * lie, (92, 124, 54), (206, 182, 120))
    shore = np.clip((lie - 0.15) * 8, 0, 1)[..., None]
    cloud = np.clip(_noise(rng, height, width, (height / 6, width / 6), 5) * 0.8 - 0.7, 0, 0.85)[..., None]
    mixed = (sea * (1 - shore) + land * shore) * (1 - cloud) + 245 * cloud
    return np.asarray(cv2.GaussianBlur(np.clip(mixed, 0, 255).astype(np.uint8), (0, 0), 1.0), np.uint8)


def _checked(height: int, width: int, cells: int, one: Colour, other: Colour) -> Picture:
    y, x = np.mgrid[0:height, 0:width]
    wave = np.sin(2 * np.pi * x / width * cells) * np.sin(np.pi * y / height * cells)
    return np.asarray(_coloured(np.asarray(0.5 + wave * 12, np.float32), one, other), np.uint8)


def _marble(rng: np.random.Generator, height: int, width: int) -> Picture:
    x = np.arange(width, dtype=np.float32)[None, :] / width
    bands = 6 * x + 1.3 * _noise(rng, height, width, (height / 2, width / 4), 5)
    veins = np.asarray(np.abs(np.sin(np.pi * bands)) ** 0.45, np.float32)
    return np.asarray(_coloured(veins, (120, 40, 30), (240, 226, 206)), np.uint8)


def _grass(rng: np.random.Generator, height: int, width: int, blades: int) -> Picture:
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


def _shade(picture: Floats, at: tuple[float, float], reach: tuple[float, float], strength: float) -> None:
    """Darkens picture about `at` (x, y) as a soft shadow, in px of the texture."""
    cols, rows = (slice(max(0, round(middle - 6 * far)), round(middle + 6 * far)) for middle, far in zip(at, reach, strict=True))
    window = picture[rows, cols]  # beyond, a float32 does not get darker
    y, x = (np.arange(n, dtype=np.float32)[span] for n, span in zip(picture.shape[:2], (rows, cols), strict=True))
    fall = np.exp(-0.5 * (((x - at[0]) / reach[0]) ** 2 + ((y[:, None] - at[1]) / reach[1]) ** 2))
    window *= (1 - strength * fall)[..., None]


def _box(front: Floats, side: Floats, x: float, width: float, height: float, d: float, d_back: float) -> list[Solid]:
    """A box on the table, its front's lower left corner at x and d; only the sides that the centre view may see."""
    left, right, foot = x, x + width, table_y(d)
    top = foot - height
    back = [_seen_from(a, top, d, d_back) for a in (left, right)]
    back_foot = [_seen_from(a, foot, d, d_back) for a in (left, right)]
    faces: list[Solid] = []
    lid = np.array([[*back[0], d_back], [*back[1], d_back], [right, top, d], [left, top, d]])
    flank_right = np.array([[right, top, d], [*back[1], d_back], [*back_foot[1], d_back], [right, foot, d]])
    flank_left = np.array([[*back[0], d_back], [left, top, d], [left, foot, d], [*back_foot[0], d_back]])
    faces += [Quad(_opaque(side * 0.52), flank_right), Quad(_opaque(side * 0.9), flank_left), Quad(_opaque(side * 1.22), lid)]
    faces.append(Quad(_opaque(front * 0.86), np.array([[left, top, d], [right, top, d], [right, foot, d], [left, foot, d]])))
    return faces


def _crate(rng: np.random.Generator, width: int, height: int) -> Floats:
    picture = np.ascontiguousarray(_wood(rng, height, width, (150, 98, 48), (222, 176, 112)))
    for k in range(1, 4):
        cv2.line(picture, (0, k * height // 4), (width, k * height // 4), (28, 48, 74), 3)
    rim = round(0.09 * width)
    frame = _wood(rng, height, width, (128, 80, 40), (200, 150, 92))
    inner = np.zeros((height, width), np.uint8)
    inner[rim:-rim, rim:-rim] = 1
    picture[inner == 0] = frame[inner == 0]
    cv2.rectangle(picture, (rim, rim), (width - rim, height - rim), (26, 44, 66), 2)
    _text(picture, "9 x 9", (width / 2, 0.40 * height), 0.17 * height, (62, 34, 20))
    _text(picture, "THIS SIDE UP", (width / 2, 0.66 * height), 0.072 * height, (62, 34, 20))
    return picture


def still_life(size_px: int, name: str = "still-life-1") -> list[Solid]:
    """The solids of a scene of `demo.NAMES`, back to front, for views of size_px x size_px; always the same picture."""
    rng = np.random.default_rng(9)
    reach = 48.0  # margin around the centre view that the outermost cameras see
    seam = table_y(WALL_D)
    wall = _wall(rng, round((seam + reach) * TEXELS), round((512 + 2 * reach) * TEXELS))
    _shade(wall, ((140 + reach) * TEXELS, wall.shape[0]), (95 * TEXELS, 150 * TEXELS), 0.42)
    _shade(wall, ((420 + reach) * TEXELS, wall.shape[0]), (120 * TEXELS, 70 * TEXELS), 0.35)
    _shade(wall, ((404 + reach) * TEXELS, (152 + reach) * TEXELS), (52 * TEXELS, 70 * TEXELS), 0.5)
    solids: list[Solid] = [
        Quad(_opaque(wall), np.array([[x, y, WALL_D] for x, y in _corners(-reach, -reach, 512 + reach, seam)])),
        Quad(_opaque(_chart(232, 308)), np.array([[x, y, WALL_D + 0.06] for x, y in _corners(336, 62, 452, 216)])),
    ]
    solids.append(_table(rng))
    if not name.startswith("still-life"):
        solids += _marbles(rng) if name.startswith("marbles") else _meadow(rng)
        return [_scaled(solid, size_px / 512) for solid in solids]
    planks = _wood(rng, 120, 300, (140, 90, 44), (214, 166, 104))
    solids += _box(_crate(rng, 300, 300), planks, 66, 152, 150, -1.15, -1.75)
    solids.append(_ball(_marble(rng, 500, 1000), 372, -1.1, 44, 0.5))
    card_left, card_right = 262.0, 374.0
    d_left, d_right = 0.35, -0.45
    foot_left, foot_right = table_y(d_left), table_y(d_right)
    tall = 152.0 * np.array([1.0, (d_right + OFFSET_PX) / (d_left + OFFSET_PX)])
    card = [[card_left, foot_left - tall[0], d_left], [card_right, foot_right - tall[1], d_right]]
    card += [[card_right, foot_right, d_right], [card_left, foot_left, d_left]]
    solids.append(Quad(_opaque(_card(260, 330)), np.array(card)))
    solids.append(_ball(_planet(rng, 500, 1000), 190, 0.25, 56, 0.35))
    solids.append(_ball(_checked(400, 800, 8, (240, 196, 40), (30, 84, 150)), 424, 0.95, 38, 0.6))
    solids.append(_ball(_checked(300, 600, 6, (236, 232, 220), (176, 30, 44)), 306, 1.45, 22, 0.6))
    for x, d in ((34.0, 1.55), (486.0, 1.75), (76.0, 1.95)):
        blades = _grass(rng, 250 * TEXELS, 150 * TEXELS, 15)
        foot = 530.0
        solids.append(Quad(blades, np.array([[a, b, d] for a, b in _corners(x - 75, foot - 215, x + 75, foot + 35)])))
    return [_scaled(solid, size_px / 512) for solid in solids]


def _marbles(rng: np.random.Generator) -> list[Solid]:
    """Balls of four kinds in a spiral from the wall to the viewer."""
    kinds = (
        _planet(rng, 400, 800),
        _checked(400, 800, 8, (240, 196, 40), (30, 84, 150)),
        _marble(rng, 400, 800),
        _checked(300, 600, 6, (236, 232, 220), (176, 30, 44)),
    )
    far_to_near = np.linspace(-1.6, 1.7, 14)
    turns = np.linspace(0.4, 3.6 * np.pi, 14)
    return [
        _ball(kinds[k % 4], 256 + (90 + 6 * k) * float(np.sin(turns[k])), float(d), 16 + 1.6 * k, 0.5)
        for k, d in enumerate(far_to_near)
    ]


def _meadow(rng: np.random.Generator) -> list[Solid]:
    """Tufts of grass at many depths, with balls between them: much hides much."""
    solids: list[Solid] = []
    for k, d in enumerate(np.linspace(-1.5, 1.9, 12)):
        x, foot = 60 + 392 * (k * 5 % 12) / 11, table_y(float(d))
        half, tall = 55 + 4 * k, 110 + 8 * k
        blades = _grass(rng, round(tall * TEXELS), round(2 * half * TEXELS), 12)
        solids.append(Quad(blades, np.array([[a, b, d] for a, b in _corners(x - half, foot - tall, x + half, foot)])))
        if k % 3 == 1:
            ball = _checked(300, 600, 6, (236, 232, 220), (200, 60, 30)) if k % 2 else _planet(rng, 300, 600)
            solids.append(_ball(ball, 452 - 30 * k, float(d) + 0.02, 18 + k, 0.5))
    return solids


def _corners(left: float, top: float, right: float, bottom: float) -> list[tuple[float, float]]:
    return [(left, top), (right, top), (right, bottom), (left, bottom)]


def _ball(texture: Picture, x: float, d: float, radius: float, gloss: float) -> Ball:
    """A ball that lies on the table at disparity d."""
    return Ball(texture, x, table_y(d) - 0.9 * radius, d, radius, radius * BALL_DEPTH, gloss)


def _table(rng: np.random.Generator) -> Quad:
    """The table top from the wall to before the picture's lower edge, with the shadows of the objects on it."""
    near_d, half = 2.6, 580.0
    wood = _wood(rng, 900, 1600, (92, 54, 30), (178, 120, 72))
    near_y = table_y(near_d)
    near = [[VANISHING[0] - half, near_y, near_d], [VANISHING[0] + half, near_y, near_d]]
    far_left, far_right = (_seen_from(x, near_y, near_d, WALL_D) for x, _, _ in near)
    corners = np.array([[*far_left, WALL_D], [*far_right, WALL_D], near[1], near[0]])
    to_texture = cv2.getPerspectiveTransform(
        corners[:, :2].astype(np.float32), np.array([[0, 0], [1600, 0], [1600, 900], [0, 900]], np.float32)
    )
    for x, d, wide in ((150, -1.3, 110), (384, -1.05, 52), (318, -0.1, 64), (204, 0.3, 62), (436, 1.0, 42), (312, 1.48, 25)):
        at = cv2.perspectiveTransform(np.array([[[x, table_y(d)]]], np.float32), to_texture)[0, 0]
        _shade(wood, (float(at[0]), float(at[1])), (wide * 1.25, wide * 0.9), 0.62)
    return Quad(_opaque(wood), corners)


def _scaled(solid: Solid, scale: float) -> Solid:
    """The same scene for views of another size: scales lengths and disparities."""
    if isinstance(solid, Quad):
        texture = solid.texture
        if scale < 1:  # a texture finer than the picture would alias
            size = [max(2, round(n * scale)) for n in (texture.shape[1], texture.shape[0])]
            texture = np.asarray(cv2.resize(texture, size, interpolation=cv2.INTER_AREA), np.uint8)
        return Quad(texture, solid.corners * scale)
    assert isinstance(solid, Ball)
    x, y, d, radius, depth = (value * scale for value in (solid.x, solid.y, solid.d, solid.radius, solid.depth))
    return Ball(solid.texture, x, y, d, radius, depth, solid.gloss)
