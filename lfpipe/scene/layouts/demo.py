"""The demo scenes: a card and balls in grass on a table, in front of a papered wall with an eye
chart; marbles; a meadow.

Lengths are px of the centre view. The table extends to its horizon, where disparity is constant;
nearer objects appear lower, as for a camera that looks down slightly.
The views are rendered one by one: only a name and a size are stored.
"""

from functools import cache, lru_cache, partial

import cv2
import numpy as np

from lfpipe import config
from lfpipe.files.safe_files import json_fields
from lfpipe.scene import demo_drawing as drawing
from lfpipe.scene.demo_drawing import TEXELS, Ball, Floats, Picture, Quad, Solid, draw_view
from lfpipe.scene.pack import DEMO_MARKER, DEMO_SIZE_PX
from lfpipe.scene.source import Geometry, GridTransform, Listing, SceneSource, read_bytes

OFFSET_PX = 8.0  # disparity between infinity and the plane of zero disparity
VANISHING = (256.0, 60.0)  # vanishing point of lines straight away from the camera
WALL_D = -2.0
TABLE_SLOPE = 0.0215  # disparity per px down the table
# depth of a ball in disparity over its radius in px: slightly rounder than a real ball
BALL_DEPTH = 0.0075
MARGIN = 48.0  # around the centre view, which the outermost cameras see
PAPER = (238, 232, 216)


@cache  # describing and drawing a scene both call it
def solids_of(name: str, scale: float = 1.0) -> list[Solid]:
    """The solids of a scene of `demo.NAMES`, back to front; deterministic. scale: of its views,
    against DEMO_SIZE_PX.
    """
    rng = np.random.default_rng(9)
    objects = {"marbles": _marbles, "meadow": _meadow}.get(name, _still_life)
    return [solid.scaled(scale) for solid in (*_room(rng, scale), *objects(rng, scale))]


def _table_y(d: float) -> float:
    """The height at which the table has disparity d: its plane reaches infinity at the height of
    the vanishing point.
    """
    return VANISHING[1] + (d + OFFSET_PX) / TABLE_SLOPE


def _upright(
    texture: Picture, left: float, top: float, right: float, bottom: float, d: float
) -> Quad:
    return Quad(
        texture, np.array([[left, top, d], [right, top, d], [right, bottom, d], [left, bottom, d]])
    )


def _lying(texture: Picture, x: float, half: float, d_far: float, d_near: float) -> Quad:
    """A rectangle on the table, centred at x and `half` to either side of it at its near edge."""

    def edge(d: float) -> list[list[float]]:
        # of lengths, which shrink towards the vanishing point
        scale = (d + OFFSET_PX) / (d_near + OFFSET_PX)
        middle = VANISHING[0] + (x - VANISHING[0]) * scale
        return [[middle - half * scale, _table_y(d), d], [middle + half * scale, _table_y(d), d]]

    return Quad(texture, np.array([*edge(d_far), *edge(d_near)[::-1]]))


def _room(rng: np.random.Generator, scale: float) -> list[Solid]:
    """The wall with the eye chart, and the table."""
    seam = _table_y(WALL_D)
    side = round((DEMO_SIZE_PX + 2 * MARGIN) * TEXELS)
    chart = drawing.poster(232, 308, drawing.LETTERS, (PAPER, PAPER), (40, 34, 34), (84, 62, 40))
    wall = drawing.wall(rng, round((seam + MARGIN) * TEXELS), side)
    return [
        _upright(
            drawing.opaque(wall, scale), -MARGIN, -MARGIN, DEMO_SIZE_PX + MARGIN, seam, WALL_D
        ),
        _upright(drawing.shadow(0.5), 330, 76, 474, 240, WALL_D),
        _upright(drawing.opaque(chart, scale), 336, 62, 452, 216, WALL_D + 0.06),
        _lying(
            drawing.opaque(drawing.wood(rng, 300, 800, (92, 54, 30), (178, 120, 72)), scale),
            VANISHING[0],
            580,
            WALL_D,
            2.6,
        ),
        _lying(drawing.shadow(0.5), VANISHING[0], 700, WALL_D - 0.4, WALL_D + 0.5),
    ]


def _still_life(rng: np.random.Generator, scale: float) -> list[Solid]:
    ends = ((262.0, 0.35), (374.0, -0.45))  # of the card: x and disparity
    feet = [[x, _table_y(d), d] for x, d in ends]
    tops = [[x, y - 152.0 * (d + OFFSET_PX) / (ends[0][1] + OFFSET_PX), d] for x, y, d in feet]
    card = drawing.poster(260, 330, drawing.TITLE, ((206, 74, 48), (150, 36, 52)), PAPER, PAPER)
    solids = [
        *_ball(drawing.red, rng, 90, -1.25, 50),
        *_ball(drawing.marble, rng, 372, -1.1, 44),
        Quad(drawing.opaque(card, scale), np.array([*tops, *feet[::-1]])),
        *_ball(drawing.planet, rng, 190, 0.25, 56),
        *_ball(drawing.blue, rng, 424, 0.95, 38),
        *_ball(drawing.marble, rng, 306, 1.45, 22),
    ]
    return solids + [
        _grass(rng, x, 565, d, 75, 250, 15) for x, d in ((34, 1.55), (486, 1.75), (76, 1.95))
    ]


def _marbles(rng: np.random.Generator, _scale: float) -> list[Solid]:
    """Balls of four kinds in a spiral from the wall to the viewer."""
    kinds = (drawing.planet, drawing.blue, drawing.marble, drawing.red)
    solids: list[Solid] = []
    for k, (d, turn) in enumerate(
        zip(np.linspace(-1.6, 1.7, 14).tolist(), np.linspace(0.4, 3.6 * np.pi, 14), strict=True)
    ):
        solids += _ball(
            kinds[k % 4], rng, 256 + (90 + 6 * k) * float(np.sin(turn)), d, 16 + 1.6 * k
        )
    return solids


def _meadow(rng: np.random.Generator, _scale: float) -> list[Solid]:
    """Tufts of grass at many depths, with balls between them: many occlusions."""
    solids: list[Solid] = []
    for k, d in enumerate(np.linspace(-1.5, 1.9, 12).tolist()):
        solids.append(
            _grass(rng, 60 + 392 * (k * 5 % 12) / 11, _table_y(d), d, 55 + 4 * k, 110 + 8 * k, 12)
        )
        if k % 3 == 1:
            solids += _ball(
                drawing.red if k % 2 else drawing.planet, rng, 452 - 30 * k, d + 0.02, 18 + k
            )
    return solids


def _grass(
    rng: np.random.Generator, x: float, foot: float, d: float, half: float, tall: float, blades: int
) -> Quad:
    texture = drawing.grass(rng, round(tall * TEXELS), round(2 * half * TEXELS), blades)
    return _upright(texture, x - half, foot - tall, x + half, foot, d)


def _ball(
    texture: drawing.Texture, rng: np.random.Generator, x: float, d: float, radius: float
) -> list[Solid]:
    """The shadow of a ball on the table at disparity d, and the ball.

    At its middle, a texel has the size of a px.
    """
    shadow = _lying(
        drawing.shadow(0.5),
        x + 0.35 * radius,
        1.4 * radius,
        d - 0.012 * radius,
        d + 0.008 * radius,
    )
    surface = texture(rng, round(np.pi * radius), round(2 * np.pi * radius))
    return [
        shadow,
        Ball(
            texture=surface,
            x=x,
            y=_table_y(d) - 0.9 * radius,
            d=d,
            radius=radius,
            depth=radius * BALL_DEPTH,
            gloss=0.5,
        ),
    ]


NAME = "demo"
GRID = 9  # views a side, as in the HCI benchmark, whose cameras have
# this focal length and width of the sensor, and about this focus
FOCAL_MM, SENSOR_MM, FOCUS_M = 100.0, 35.0, 1.5


def detect(listing: Listing) -> int | None:
    return 100 if DEMO_MARKER in listing.names else None


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    path = listing.file(DEMO_MARKER)
    fields = json_fields(read_bytes(path), str(path), "remove the folder; lfpipe makes it again")
    size_px = fields.integer("size_px", 32, 4096)
    scale = max(size_px / DEMO_SIZE_PX, 1.0)
    solids = solids_of(fields.text("scene"), scale)

    @lru_cache(GRID * GRID)
    def view(row: int, col: int) -> tuple[Picture, Floats]:
        drawn_px = round(DEMO_SIZE_PX * scale)
        picture, disparity = draw_view(solids, col - GRID // 2, row - GRID // 2, drawn_px)
        if size_px == drawn_px:
            return picture, disparity
        sides = size_px, size_px
        small = cv2.resize(
            disparity * np.float32(size_px / drawn_px), sides, interpolation=cv2.INTER_NEAREST
        )
        return np.asarray(
            cv2.resize(picture, sides, interpolation=cv2.INTER_AREA), np.uint8
        ), np.asarray(small, np.float32)

    geometry = Geometry(
        # offset = baseline * focal length * width / (focus distance * sensor width),
        # as in the HCI benchmark's tools
        baseline_mm=OFFSET_PX / DEMO_SIZE_PX * FOCUS_M * 1000 * SENSOR_MM / FOCAL_MM,
        focus_distance_mm=FOCUS_M * 1000,
        focal_length_px=FOCAL_MM / SENSOR_MM * size_px,
    )
    truth = {
        place: partial(lambda row, col: view(row, col)[1], *place)
        for place in np.ndindex(GRID, GRID)
    }
    return SceneSource(
        layout=NAME,
        path=listing.path,
        files=(path,),
        rows=GRID,
        cols=GRID,
        read=lambda frame, row, col: view(row, col)[0],
        height_px=size_px,
        width_px=size_px,
        turn=GridTransform(),
        rendered=True,
        truth=truth,
        turn_by="the demo is rendered in this order",
        geometry=geometry,
    )
