"""The demo's still life: an eye chart on a papered wall; on a table before it a crate, balls, a card with text, and grass.

Lengths are px of a 512x512 centre view. The table rises to its horizon, where a point would stand still: nearer objects appear
lower, as for a camera that looks down a little.
"""

import cv2
import numpy as np

from lfpipe.scene import demo_textures as textures
from lfpipe.scene.demo_layers import Ball, Picture, Quad, Solid
from lfpipe.scene.demo_textures import TEXELS

OFFSET_PX = 8.0  # disparity between infinity and the plane of zero disparity
VANISHING = (256.0, 60.0)  # vanishing point of lines straight away from the camera
WALL_D = -2.0
TABLE_SLOPE = 0.0215  # disparity per px down the table
BALL_DEPTH = 0.0075  # depth of a ball in disparity over its radius in px: a little rounder than life
MARGIN = 48.0  # around the centre view, which the outermost cameras see
BLUE = ((240, 196, 40), (30, 84, 150))  # of checked balls
RED = ((236, 232, 220), (176, 30, 44))


def solids_of(name: str, size_px: int) -> list[Solid]:
    """The solids of a scene of `demo.NAMES`, back to front, for views of size_px x size_px; always the same picture."""
    rng = np.random.default_rng(9)
    objects = {"marbles-1": _marbles, "meadow-1": _meadow}.get(name, _still_life)
    return [solid.scaled(size_px / 512) for solid in (*_room(rng), *objects(rng))]


def table_y(d: float) -> float:
    """The height at which the table has disparity d: its plane reaches infinity at the height of the vanishing point."""
    return VANISHING[1] + (d + OFFSET_PX) / TABLE_SLOPE


def _behind(x: float, y: float, d_from: float, d_to: float) -> list[float]:
    """The point at d_to straight behind (x, y, d_from)."""
    scale = (d_to + OFFSET_PX) / (d_from + OFFSET_PX)
    return [VANISHING[0] + (x - VANISHING[0]) * scale, VANISHING[1] + (y - VANISHING[1]) * scale, d_to]


def _upright(texture: Picture, left: float, top: float, right: float, bottom: float, d: float) -> Quad:
    return Quad(texture, np.array([[left, top, d], [right, top, d], [right, bottom, d], [left, bottom, d]]))


def _room(rng: np.random.Generator) -> list[Solid]:
    """The wall with the eye chart, and the table, both with the shadows of the still life."""
    seam = table_y(WALL_D)
    wall = textures.wall(rng, round((seam + MARGIN) * TEXELS), round((512 + 2 * MARGIN) * TEXELS))
    for x, y, wide, high, strength in ((140, seam, 95, 150, 0.42), (420, seam, 120, 70, 0.35), (404, 152, 52, 70, 0.5)):
        at_y = len(wall) if y == seam else (y + MARGIN) * TEXELS
        textures.shade(wall, ((x + MARGIN) * TEXELS, at_y), (wide * TEXELS, high * TEXELS), strength)
    table, near_d, half = textures.wood(rng, 900, 1600, (92, 54, 30), (178, 120, 72)), 2.6, 580.0
    near = [[VANISHING[0] + side, table_y(near_d), near_d] for side in (-half, half)]
    far = [_behind(x, y, near_d, WALL_D) for x, y, _ in near]
    corners = np.array([*far, *near[::-1]])
    edges = np.array([[0, 0], [1600, 0], [1600, 900], [0, 900]], np.float32)
    to_texture = cv2.getPerspectiveTransform(corners[:, :2].astype(np.float32), edges)
    for x, d, wide in ((150, -1.3, 110), (384, -1.05, 52), (318, -0.1, 64), (204, 0.3, 62), (436, 1.0, 42), (312, 1.48, 25)):
        at = cv2.perspectiveTransform(np.array([[[x, table_y(d)]]], np.float32), to_texture)[0, 0]
        textures.shade(table, (float(at[0]), float(at[1])), (wide * 1.25, wide * 0.9), 0.62)
    return [
        _upright(textures.opaque(wall), -MARGIN, -MARGIN, 512 + MARGIN, seam, WALL_D),
        _upright(textures.opaque(textures.chart(232, 308)), 336, 62, 452, 216, WALL_D + 0.06),
        Quad(textures.opaque(table), corners),
    ]


def _still_life(rng: np.random.Generator) -> list[Solid]:
    planks = textures.wood(rng, 120, 300, (140, 90, 44), (214, 166, 104))
    solids = _box(textures.crate(rng, 300, 300), planks, 66, 152, 150, -1.15, -1.75)
    solids.append(_ball(textures.marble(rng, 500, 1000), 372, -1.1, 44, 0.5))
    ends = ((262.0, 0.35), (374.0, -0.45))  # of the card: x and disparity
    feet = [[x, table_y(d), d] for x, d in ends]
    tops = [[x, y - 152.0 * (d + OFFSET_PX) / (ends[0][1] + OFFSET_PX), d] for x, y, d in feet]
    solids.append(Quad(textures.opaque(textures.card(260, 330)), np.array([*tops, *feet[::-1]])))
    solids.append(_ball(textures.planet(rng, 500, 1000), 190, 0.25, 56, 0.35))
    solids.append(_ball(textures.checked(400, 800, 8, *BLUE), 424, 0.95, 38, 0.6))
    solids.append(_ball(textures.checked(300, 600, 6, *RED), 306, 1.45, 22, 0.6))
    for x, d in ((34.0, 1.55), (486.0, 1.75), (76.0, 1.95)):
        blades = textures.grass(rng, 250 * TEXELS, 150 * TEXELS, 15)
        solids.append(_upright(blades, x - 75, 315, x + 75, 565, d))
    return solids


def _marbles(rng: np.random.Generator) -> list[Solid]:
    """Balls of four kinds in a spiral from the wall to the viewer."""
    kinds = (
        textures.planet(rng, 400, 800),
        textures.checked(400, 800, 8, *BLUE),
        textures.marble(rng, 400, 800),
        textures.checked(300, 600, 6, *RED),
    )
    far_to_near, turns = np.linspace(-1.6, 1.7, 14), np.linspace(0.4, 3.6 * np.pi, 14)
    return [
        _ball(kinds[k % 4], 256 + (90 + 6 * k) * float(np.sin(turns[k])), float(d), 16 + 1.6 * k, 0.5)
        for k, d in enumerate(far_to_near)
    ]


def _meadow(rng: np.random.Generator) -> list[Solid]:
    """Tufts of grass at many depths, with balls between them: much hides much."""
    solids: list[Solid] = []
    for k, d in enumerate(np.linspace(-1.5, 1.9, 12).tolist()):
        x, foot = 60 + 392 * (k * 5 % 12) / 11, table_y(d)
        half, tall = 55 + 4 * k, 110 + 8 * k
        blades = textures.grass(rng, round(tall * TEXELS), round(2 * half * TEXELS), 12)
        solids.append(_upright(blades, x - half, foot - tall, x + half, foot, d))
        if k % 3 == 1:
            ball = textures.checked(300, 600, 6, (236, 232, 220), (200, 60, 30)) if k % 2 else textures.planet(rng, 300, 600)
            solids.append(_ball(ball, 452 - 30 * k, d + 0.02, 18 + k, 0.5))
    return solids


def _ball(texture: Picture, x: float, d: float, radius: float, gloss: float) -> Ball:
    """A ball that lies on the table at disparity d."""
    return Ball(texture, x, table_y(d) - 0.9 * radius, d, radius, radius * BALL_DEPTH, gloss)


def _box(
    front: textures.Floats, side: textures.Floats, x: float, width: float, height: float, d: float, d_back: float
) -> list[Solid]:
    """A box on the table, its front's lower left corner at x and d; only the sides that the centre view may see."""
    foot = table_y(d)
    near = [[x, foot - height, d], [x + width, foot - height, d], [x + width, foot, d], [x, foot, d]]  # clockwise from top left
    far = [_behind(at_x, at_y, d, d_back) for at_x, at_y, _ in near]
    faces = (
        (side * 0.52, [near[1], far[1], far[2], near[2]]),
        (side * 0.9, [far[0], near[0], near[3], far[3]]),
        (side * 1.22, [far[0], far[1], near[1], near[0]]),
        (front * 0.86, near),
    )
    return [Quad(textures.opaque(texture), np.array(corners)) for texture, corners in faces]
