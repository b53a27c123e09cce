"""Light fields drawn from solids whose every view is known, for choosing constants of disparity:
much that hides much, thin things, little texture, up to 90 px between views that are kept.
"""

from collections.abc import Callable, Sequence

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.scene.demo import SIZE_PX
from lfpipe.scene.demo_drawing import Ball, Quad, Solid, draw_view
from lfpipe.scene.demo_scenes import solids_of

Floats = NDArray[np.float64]
SIDE = 7  # views of a grid
MARGIN_PX = 120  # around the middle view, which the others see
WIDE_PX = SIZE_PX + 2 * MARGIN_PX
RGB = 3


def noise(
    rng: np.random.Generator, height: int, width: int, blur_px: float, low: float, high: float
) -> Floats:
    """Smooth noise of values low to high, (height, width)."""
    values = cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), blur_px)
    values = (values - values.mean()) / values.std()
    return np.asarray(np.clip((low + high) / 2 + values * (high - low) / 5, low, high), np.float64)


def painted(
    grey: Floats,
    place: tuple[float, float, float, float],
    disparity_px: float | Sequence[float],
    opacity: Floats | None = None,
) -> Quad:
    """A flat picture. place: left, top, right, bottom; disparity_px: of all, or of each corner."""
    alpha = np.ones(grey.shape) if opacity is None else opacity
    texture = np.dstack([*[grey * alpha] * RGB, 255 * alpha]).astype(np.uint8)
    left, top, right, bottom = place
    d = np.broadcast_to(disparity_px, 4)
    corners = [(left, top, d[0]), (right, top, d[1]), (right, bottom, d[2]), (left, bottom, d[3])]
    return Quad(texture, np.array(corners, np.float64))


def wall(grey: Floats, disparity_px: float | Sequence[float]) -> Quad:
    end_px = SIZE_PX + MARGIN_PX
    return painted(grey, (-MARGIN_PX, -MARGIN_PX, end_px, end_px), disparity_px)


def teeth(seed: int, near_px: float, blur_px: float, contrast: float) -> list[Solid]:
    """Wedges before a slanted wall, gaps between them down to nothing."""
    rng = np.random.default_rng(seed)
    low, high = 128 - contrast, 128 + contrast
    y, _ = np.mgrid[:SIZE_PX, :WIDE_PX]
    phase = np.cumsum(1 / np.linspace(70, 14, WIDE_PX)) % 1
    wedges = cv2.GaussianBlur((np.abs(phase - 0.5) * 2 < 1 - y / SIZE_PX) * 1.0, (0, 0), 0.5)
    front = noise(rng, SIZE_PX, WIDE_PX, blur_px, low + 15, high + 15)
    return [
        wall(
            noise(rng, WIDE_PX, WIDE_PX, blur_px, low, high),
            (-near_px, -near_px, 0.6 * near_px, 0.6 * near_px),
        ),
        painted(front, (-MARGIN_PX, 10, SIZE_PX + MARGIN_PX, SIZE_PX - 20), near_px, wedges),
    ]


def stripes(seed: int) -> list[Solid]:
    """Bands of upright stripes, 40 to 3 px wide, before a wall."""
    rng = np.random.default_rng(seed)
    solids: list[Solid] = [wall(noise(rng, WIDE_PX, WIDE_PX, 0.8, 90, 150), -1.5)]
    for k, width_px in enumerate((40, 24, 12, 6, 3)):
        opacity = np.mgrid[:60, :WIDE_PX][1] // width_px % 2 == 0
        front = noise(rng, 60, WIDE_PX, 0.8, 100 + 10 * k, 170 + 10 * k)
        place = (-MARGIN_PX, 30.0 + 95 * k, SIZE_PX + MARGIN_PX, 90.0 + 95 * k)
        solids.append(painted(front, place, 1.5, opacity * 1.0))
    return solids


def dots(seed: int) -> list[Solid]:
    """Dots of 1.5 to 14 px on three planes before a wall."""
    rng = np.random.default_rng(seed)
    solids: list[Solid] = [wall(noise(rng, WIDE_PX, WIDE_PX, 1.2, 80, 170), -1.2)]
    for d in (-0.4, 0.4, 1.2):
        opacity = np.zeros((WIDE_PX, WIDE_PX))
        for row, col in np.ndindex(8, 8):
            at = int(WIDE_PX * (col + 0.5 + 0.3 * d) / 8), int(WIDE_PX * (row + 0.4 - 0.3 * d) / 8)
            cv2.circle(opacity, at, int(1.5 + 1.8 * row), 1.0, -1)
        front = noise(rng, WIDE_PX, WIDE_PX, 1.2, 60 + 60 * d, 200)
        end_px = SIZE_PX + MARGIN_PX
        solids.append(painted(front, (-MARGIN_PX, -MARGIN_PX, end_px, end_px), d, opacity))
    return solids


def plain_room(seed: int, near_px: float, far_px: float) -> list[Solid]:
    """A wall, a floor, posts, balls and boards with hardly any texture."""
    rng = np.random.default_rng(seed)

    def shade(height: int, width: int) -> Floats:
        y, x = np.mgrid[:height, :width] / max(height, width)
        angle = rng.uniform(0, 2 * np.pi)
        ramp = 0.6 + 0.5 * (np.cos(angle) * x + np.sin(angle) * y)
        values = rng.uniform(60, 220) * ramp + rng.normal(0, 0.8, ramp.shape)
        return np.asarray(np.clip(values, 0, 255), np.float64)

    floor = (far_px, far_px, 0.9 * near_px, 0.9 * near_px)
    solids: list[Solid] = [
        painted(shade(300, 300), (-200, -200, SIZE_PX + 200, SIZE_PX * 0.6), far_px),
        painted(shade(300, 300), (-300, SIZE_PX * 0.55, SIZE_PX + 300, SIZE_PX + 150), floor),
    ]
    for k, share in enumerate(np.linspace(0.15, 0.95, 9).tolist()):
        d = far_px + (near_px - far_px) * share
        x, y = float(rng.uniform(30, SIZE_PX - 30)), SIZE_PX * (0.5 + 0.35 * share)
        half = 30 + 60 * share
        if k % 3 == 0:
            solids.append(painted(shade(200, 20), (x - 6, y - 220, x + 6, y + 10), d))
        elif k % 3 == 1:
            surface = np.full((64, 128, RGB), rng.integers(60, 220), np.uint8)
            depth = 0.04 * (near_px - far_px)
            solids.append(
                Ball(
                    texture=surface,
                    x=x,
                    y=y - 20,
                    d=d,
                    radius=24 + 30 * share,
                    depth=depth,
                    gloss=0.5,
                )
            )
        else:
            solids.append(painted(shade(80, 80), (x - half, y - 1.4 * half, x + half, y), d))
    return solids


def wires(seed: int, near_px: float, far_px: float) -> list[Solid]:
    """Wires of 1 to 4 px before a wall."""
    rng = np.random.default_rng(seed)
    back = (far_px, far_px, 0.7 * far_px, 0.7 * far_px)
    solids: list[Solid] = [wall(noise(rng, WIDE_PX, WIDE_PX, 3, 60, 160), back)]
    for d in np.linspace(0.3 * far_px, near_px, 5).tolist():
        opacity = np.zeros((420, 420))
        for _ in range(4):
            top, bottom = rng.integers(0, 420, 2).tolist()
            cv2.line(opacity, (top, 0), (bottom, 420), 1.0, int(rng.integers(1, 5)))
        x, y, tone = rng.uniform(-40, 140), rng.uniform(0, 90), rng.uniform(30, 225)
        front = noise(rng, 420, 420, 2, tone - 25, tone + 25)
        solids.append(painted(front, (x, y, x + 420, y + 420), d, opacity))
    return solids


def fence(seed: int, lattice: bool) -> list[Solid]:
    """Posts, or a lattice, of 5 px before a textured wall."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:WIDE_PX, :WIDE_PX]
    bars = (x % 41 < 5) | (lattice & (y % 41 < 5))
    end_px = SIZE_PX + MARGIN_PX
    front = noise(rng, WIDE_PX, WIDE_PX, 3, 190, 220)
    return [
        wall(noise(rng, WIDE_PX, WIDE_PX, 1.2, 70, 150), -1.0),
        painted(front, (-MARGIN_PX, -MARGIN_PX, end_px, end_px), 2.0, bars * 1.0),
    ]


def demo(name: str, spacing: float) -> list[Solid]:
    """A scene of the demo with its cameras this many times as far apart."""
    solids: list[Solid] = []
    for solid in solids_of(name):
        if isinstance(solid, Quad):
            solids.append(Quad(solid.texture, solid.corners * (1, 1, spacing)))
        else:
            deeper = attrs.evolve(solid, d=solid.d * spacing, depth=solid.depth * spacing)
            solids.append(deeper)
    return solids


# solids, and the standard deviation of the noise of each camera
SCENES: dict[str, tuple[Callable[[], list[Solid]], float]] = {
    "still life": (lambda: demo("still-life", 1), 0.7),
    "marbles": (lambda: demo("marbles", 1), 0.7),
    "meadow": (lambda: demo("meadow", 1), 0.7),
    "still life, wide": (lambda: demo("still-life", 4), 0.7),
    "marbles, wide": (lambda: demo("marbles", 4), 0.7),
    "meadow, wide": (lambda: demo("meadow", 4), 0.7),
    "teeth, fine": (lambda: teeth(1, 2.0, 1.0, 107), 3.0),
    "teeth, smooth": (lambda: teeth(31, 1.5, 2.5, 60), 2.0),
    "teeth, plain": (lambda: teeth(33, 2.0, 5.0, 30), 1.0),
    "stripes": (lambda: stripes(2), 2.0),
    "fence": (lambda: fence(5, lattice=False), 1.0),
    "lattice": (lambda: fence(6, lattice=True), 1.0),
    "dots": (lambda: dots(3), 4.0),
    "plain room": (lambda: plain_room(13, 4, -4), 0.7),
    "plain room, wide": (lambda: plain_room(11, 8.4, -10), 0.7),
    "wires": (lambda: wires(22, 2, -1), 2.0),
    "wires, wide": (lambda: wires(21, 9, -6), 0.7),
}


def views_of(name: str) -> NDArray[np.uint8]:
    """The views of a scene: uint8 (SIDE, SIDE, 1, SIZE_PX, SIZE_PX)."""
    draw, sigma = SCENES[name]
    solids = draw()
    rng = np.random.default_rng(7)
    out = np.empty((SIDE, SIDE, 1, SIZE_PX, SIZE_PX), np.uint8)
    middle = (SIDE - 1) / 2
    for row, col in np.ndindex(SIDE, SIDE):
        picture, _ = draw_view(solids, col - middle, row - middle)
        grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) + rng.normal(0, sigma, picture.shape[:2])
        out[row, col, 0] = np.clip(np.rint(grey), 0, 255)
    return out
