"""Draws a spinning ball that `lfpipe up live:ring:ball` shows while it is drawn.

Usage: python live_scene.py grid|eyes

grid: 3x3 views and their disparity in every frame. eyes: the two views that both eyes need, with
their disparity, from the viewpoints that lfpipe predicts.
"""

import contextlib
import sys
import time

import numpy as np

import lfpipe

SIZE_PX = 256  # of a view, both sides
GRID = 3
FAR_PX = -3.0  # disparity of the wall, px per view
NEAR_PX, DEPTH_PX = 2.0, 3.0  # of the middle of the ball, and its radius along disparity
RADIUS_PX = 70.0
RATE_HZ = 30.0


def wall(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Brightness of the wall, 0 to 1."""
    return np.asarray(0.55 + 0.2 * np.sin(x / 6) * np.sin(y / 9) + 0.1 * np.sin((x + y) / 25))


def draw(row: float, col: float, t_s: float) -> tuple[np.ndarray, np.ndarray]:
    """The view at (row, col) of the grid: uint8 (height, width, 3) BGR; its disparity, float (half
    height, half width).

    A point (X, Y) of disparity d is seen at X - d * u, Y - d * v from u columns right of the middle
    of the grid and v rows below it.
    """
    u, v = col - (GRID - 1) / 2, row - (GRID - 1) / 2
    y, x = np.mgrid[:SIZE_PX, :SIZE_PX] - (SIZE_PX - 1) / 2
    grey = wall(x + FAR_PX * u, y + FAR_PX * v)
    disparity = np.full(x.shape, FAR_PX)
    # the nearest point of an ellipsoid on the ray of each pixel
    ray = np.array([u / RADIUS_PX, v / RADIUS_PX, 1 / DEPTH_PX])
    across, down = (x + NEAR_PX * u) / RADIUS_PX, (y + NEAR_PX * v) / RADIUS_PX
    half = across * ray[0] + down * ray[1]
    root = half**2 - (ray @ ray) * (across**2 + down**2 - 1)
    depth = (np.sqrt(np.maximum(root, 0)) - half) / (ray @ ray)
    nx, ny, nz = across + depth * ray[0], down + depth * ray[1], depth * ray[2]
    turned = np.arctan2(nx, np.maximum(nz, 1e-6)) + t_s
    ball = 0.5 + 0.4 * np.sign(np.sin(6 * turned) * np.sin(8 * ny))
    on_ball = root > 0
    colour = np.stack([grey, grey * 0.9, grey * 0.8], axis=-1)
    shade = np.clip(0.4 + 0.6 * nz, 0, 1)
    colour[on_ball] = (np.stack([ball * 0.4, ball * 0.6, ball], axis=-1) * shade[..., None])[
        on_ball
    ]
    disparity[on_ball] = (NEAR_PX + depth)[on_ball]
    return (255 * np.clip(colour, 0, 1)).astype(np.uint8), disparity[::2, ::2]


def main() -> None:
    """Draws until Ctrl-C."""
    if sys.argv[1:] not in (["grid"], ["eyes"]):
        sys.exit(__doc__)
    size_px = (SIZE_PX, SIZE_PX)
    with lfpipe.LiveScene("ball", rows=GRID, cols=GRID, size_px=size_px) as scene:
        print("now run: lfpipe up live:ring:ball", flush=True)
        while True:
            t_s = time.monotonic()
            wanted = scene.wanted()
            if sys.argv[1] == "eyes" and wanted is not None:
                places = [wanted.left, wanted.right]
                drawn = [draw(*place, t_s) for place in places]
                views, disparities = (np.stack(part) for part in zip(*drawn, strict=True))
                scene.write(views, disparities, positions=places)
            else:
                drawn = [draw(row, col, t_s) for row, col in np.ndindex(GRID, GRID)]
                views, disparities = (np.stack(part) for part in zip(*drawn, strict=True))
                grid = (GRID, GRID)
                scene.write(
                    views.reshape(*grid, *views.shape[1:]),
                    disparities.reshape(*grid, *disparities.shape[1:]),
                )
            time.sleep(max(0.0, t_s + 1 / RATE_HZ - time.monotonic()))


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        main()
