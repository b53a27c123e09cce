"""The demo's still life: an eye chart on a papered wall; on a table before it a crate, balls, a card with text, and grass.

Lengths are px of a 512x512 centre view. The table rises to its horizon, where a point would stand still: nearer objects appear
lower, as for a camera that looks down a little.
"""

import cv2
import numpy as np

from lfpipe.scene import demo_textures as textures
from lfpipe.scene.demo_layers import Ball, Picture, Quad, Solid

OFFSET_PX = 8.0  # disparity between infinity and the plane of zero disparity
VANISHING = (256.0, 60.0)  # vanishing point of lines straight away from the camera
WALL_D = -2.0
TABLE_SLOPE = 0.0215  # disparity per px down the table
BALL_DEPTH = 0.0075  # depth of a ball in disparity over its radius in px: a little rounder than life


def table_y(d: float) -> float:
    """The height at which the table has disparity d: its plane reaches infinity at the height of the vanishing point."""
    return VANISHING[1] + (d + OFFSET_PX) / TABLE_SLOPE


def _seen_from(x: float, y: float, d_from: float, d_to: float) -> tuple[float, float]:
    """The position in the centre view of the point straight behind (x, y, d_from), at d_to."""
    scale = (d_to + OFFSET_PX) / (d_from + OFFSET_PX)
    return VANISHING[0] + (x - VANISHING[0]) * scale, VANISHING[1] + (y - VANISHING[1]) * scale


def _box(
    front: textures.Floats, side: textures.Floats, x: float, width: float, height: float, d: float, d_back: float
) -> list[Solid]:
    """A box on the table, its front's lower left corner at x and d; only the sides that the centre view may see."""
    left, right, foot = x, x + width, table_y(d)
    top = foot - height
    back = [_seen_from(a, top, d, d_back) for a in (left, right)]
    back_foot = [_seen_from(a, foot, d, d_back) for a in (left, right)]
    faces: list[Solid] = []
    lid = np.array([[*back[0], d_back], [*back[1], d_back], [right, top, d], [left, top, d]])
    flank_right = np.array([[right, top, d], [*back[1], d_back], [*back_foot[1], d_back], [right, foot, d]])
    flank_left = np.array([[*back[0], d_back], [left, top, d], [left, foot, d], [*back_foot[0], d_back]])
    faces += [
        Quad(textures.opaque(side * 0.52), flank_right),
        Quad(textures.opaque(side * 0.9), flank_left),
        Quad(textures.opaque(side * 1.22), lid),
    ]
    faces.append(
        Quad(textures.opaque(front * 0.86), np.array([[left, top, d], [right, top, d], [right, foot, d], [left, foot, d]]))
    )
    return faces


def still_life(size_px: int, name: str = "still-life-1") -> list[Solid]:
    """The solids of a scene of `demo.NAMES`, back to front, for views of size_px x size_px; always the same picture."""
    rng = np.random.default_rng(9)
    reach = 48.0  # margin around the centre view that the outermost cameras see
    seam = table_y(WALL_D)
    wall = textures.wall(rng, round((seam + reach) * textures.TEXELS), round((512 + 2 * reach) * textures.TEXELS))
    textures.shade(wall, ((140 + reach) * textures.TEXELS, wall.shape[0]), (95 * textures.TEXELS, 150 * textures.TEXELS), 0.42)
    textures.shade(wall, ((420 + reach) * textures.TEXELS, wall.shape[0]), (120 * textures.TEXELS, 70 * textures.TEXELS), 0.35)
    textures.shade(
        wall,
        ((404 + reach) * textures.TEXELS, (152 + reach) * textures.TEXELS),
        (52 * textures.TEXELS, 70 * textures.TEXELS),
        0.5,
    )
    solids: list[Solid] = [
        Quad(textures.opaque(wall), np.array([[x, y, WALL_D] for x, y in _corners(-reach, -reach, 512 + reach, seam)])),
        Quad(
            textures.opaque(textures.chart(232, 308)), np.array([[x, y, WALL_D + 0.06] for x, y in _corners(336, 62, 452, 216)])
        ),
    ]
    solids.append(_table(rng))
    if not name.startswith("still-life"):
        solids += _marbles(rng) if name.startswith("marbles") else _meadow(rng)
        return [_scaled(solid, size_px / 512) for solid in solids]
    planks = textures.wood(rng, 120, 300, (140, 90, 44), (214, 166, 104))
    solids += _box(textures.crate(rng, 300, 300), planks, 66, 152, 150, -1.15, -1.75)
    solids.append(_ball(textures.marble(rng, 500, 1000), 372, -1.1, 44, 0.5))
    card_left, card_right = 262.0, 374.0
    d_left, d_right = 0.35, -0.45
    foot_left, foot_right = table_y(d_left), table_y(d_right)
    tall = 152.0 * np.array([1.0, (d_right + OFFSET_PX) / (d_left + OFFSET_PX)])
    card = [[card_left, foot_left - tall[0], d_left], [card_right, foot_right - tall[1], d_right]]
    card += [[card_right, foot_right, d_right], [card_left, foot_left, d_left]]
    solids.append(Quad(textures.opaque(textures.card(260, 330)), np.array(card)))
    solids.append(_ball(textures.planet(rng, 500, 1000), 190, 0.25, 56, 0.35))
    solids.append(_ball(textures.checked(400, 800, 8, (240, 196, 40), (30, 84, 150)), 424, 0.95, 38, 0.6))
    solids.append(_ball(textures.checked(300, 600, 6, (236, 232, 220), (176, 30, 44)), 306, 1.45, 22, 0.6))
    for x, d in ((34.0, 1.55), (486.0, 1.75), (76.0, 1.95)):
        blades = textures.grass(rng, 250 * textures.TEXELS, 150 * textures.TEXELS, 15)
        foot = 530.0
        solids.append(Quad(blades, np.array([[a, b, d] for a, b in _corners(x - 75, foot - 215, x + 75, foot + 35)])))
    return [_scaled(solid, size_px / 512) for solid in solids]


def _marbles(rng: np.random.Generator) -> list[Solid]:
    """Balls of four kinds in a spiral from the wall to the viewer."""
    kinds = (
        textures.planet(rng, 400, 800),
        textures.checked(400, 800, 8, (240, 196, 40), (30, 84, 150)),
        textures.marble(rng, 400, 800),
        textures.checked(300, 600, 6, (236, 232, 220), (176, 30, 44)),
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
        blades = textures.grass(rng, round(tall * textures.TEXELS), round(2 * half * textures.TEXELS), 12)
        solids.append(Quad(blades, np.array([[a, b, d] for a, b in _corners(x - half, foot - tall, x + half, foot)])))
        if k % 3 == 1:
            ball = textures.checked(300, 600, 6, (236, 232, 220), (200, 60, 30)) if k % 2 else textures.planet(rng, 300, 600)
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
    wood = textures.wood(rng, 900, 1600, (92, 54, 30), (178, 120, 72))
    near_y = table_y(near_d)
    near = [[VANISHING[0] - half, near_y, near_d], [VANISHING[0] + half, near_y, near_d]]
    far_left, far_right = (_seen_from(x, near_y, near_d, WALL_D) for x, _, _ in near)
    corners = np.array([[*far_left, WALL_D], [*far_right, WALL_D], near[1], near[0]])
    to_texture = cv2.getPerspectiveTransform(
        corners[:, :2].astype(np.float32), np.array([[0, 0], [1600, 0], [1600, 900], [0, 900]], np.float32)
    )
    for x, d, wide in ((150, -1.3, 110), (384, -1.05, 52), (318, -0.1, 64), (204, 0.3, 62), (436, 1.0, 42), (312, 1.48, 25)):
        at = cv2.perspectiveTransform(np.array([[[x, table_y(d)]]], np.float32), to_texture)[0, 0]
        textures.shade(wood, (float(at[0]), float(at[1])), (wide * 1.25, wide * 0.9), 0.62)
    return Quad(textures.opaque(wood), corners)


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
