"""Exact light fields of simple solids: textured quads and balls, painted back to front.

Space is (X, Y, d): px of the centre view and disparity in px per grid step, nearer is larger. The
camera u columns right of and v rows below the centre one sees the point (X, Y, d) at (X - d*u, Y -
d*v). Rays are straight lines and planes are planes, so a quad is one homography per view, and its
disparity is linear in the pixels of that view.
"""

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.scene.pack import DEMO_SIZE_PX

Picture = NDArray[np.uint8]
Floats = NDArray[np.float32]
Window = tuple[slice, slice]  # rows and columns of a view


# about a unit vector, towards the lamp: left, above, before
LIGHT = np.array([-0.45, -0.62, 0.64], np.float32)
# the normal that mirrors the lamp: between it and the viewer
HIGHLIGHT = np.array([-0.249, -0.343, 0.906], np.float32)


def _window(points: NDArray[np.float64], size_px: int) -> Window:
    """The part of a view that contains points (n, 2) as (x, y), at least one px."""
    low = np.clip(np.floor(points.min(axis=0)), 0, size_px - 1).astype(int)
    high = np.clip(np.ceil(points.max(axis=0)) + 1, low + 1, size_px).astype(int)
    return slice(low[1], high[1]), slice(low[0], high[0])


@attrs.frozen(eq=False)
class Quad:
    """A flat picture."""

    texture: Picture
    """uint8 (h, w, 4): RGB and alpha, pre-multiplied."""
    corners: NDArray[np.float64]
    """float (4, 3) of (X, Y, d), clockwise from top left, in one plane."""

    def scaled(self, scale: float) -> "Quad":
        """For views of another size."""
        return attrs.evolve(self, corners=self.corners * scale)

    def projected(self, u: float, v: float, size_px: int) -> tuple[Window, Picture, Floats]:
        """The window of a view that the quad covers; there its colours, pre-multiplied RGBA, and
        its disparity.
        """
        at = self.corners[:, :2] - self.corners[:, 2:] * (u, v)
        rows, cols = window = _window(at, size_px)
        h, w = self.texture.shape[:2]
        # The texture's edge, not the centre of its first texel, lies on the corner; pixel i covers
        # i - 1/2 .. i + 1/2.
        edges = np.array([[0, 0], [w, 0], [w, h], [0, h]], np.float32) - np.float32(0.5)
        matrix = cv2.getPerspectiveTransform(
            edges, (at - (cols.start, rows.start)).astype(np.float32)
        )
        size = cols.stop - cols.start, rows.stop - rows.start
        colour = cv2.warpPerspective(self.texture, matrix, size, flags=cv2.INTER_LINEAR)
        across, down, d = np.linalg.solve(
            np.column_stack([at[[0, 1, 3]], np.ones(3)]), self.corners[[0, 1, 3], 2]
        )
        y, x = np.ogrid[window]
        return (
            window,
            np.asarray(colour, np.uint8),
            np.asarray(across * x + down * y + d, np.float32),
        )


@attrs.frozen(eq=False, kw_only=True)
class Ball:
    """A ball with its centre at (x, y, d)."""

    texture: Picture
    """uint8 (h, w, 3) RGB, wrapped around the ball."""
    x: float
    y: float
    d: float
    radius: float  # px
    depth: float  # radius along d, in disparity
    gloss: float  # strength of the highlight, 0 to 1

    def scaled(self, scale: float) -> "Ball":
        """For views of another size."""
        lengths = {name: getattr(self, name) * scale for name in ("x", "y", "d", "radius", "depth")}
        return attrs.evolve(self, **lengths)

    def projected(self, u: float, v: float, size_px: int) -> tuple[Window, Picture, Floats]:
        """As `Quad.projected`.

        The nearest point on the ray of pixel (x, y) is the larger solution d of
        ((x + d u - X)/R)^2 + ((y + d v - Y)/R)^2 + ((d - D)/depth)^2 = 1.
        """
        reach = self.radius * 1.02 + self.depth * np.hypot(u, v) + 1
        centre = np.array([self.x - self.d * u, self.y - self.d * v])
        window = _window(np.stack([centre - reach, centre + reach]), size_px)
        y, x = (axis.astype(np.float32) for axis in np.ogrid[window])
        px, py = (x - centre[0]) / self.radius, (y - centre[1]) / self.radius
        ku, kv, kd = u / self.radius, v / self.radius, 1 / self.depth
        a = ku * ku + kv * kv + kd * kd
        half_b = px * ku + py * kv
        root = half_b * half_b - a * (px * px + py * py - 1)
        nearer = (np.sqrt(np.maximum(root, 0)) - half_b) / a
        # px inside the outline; root / a falls by 2 per radius along it
        alpha = np.clip(0.5 + root / a * self.radius / 2, 0, 1)
        colour = self._colour(px + nearer * ku, py + nearer * kv, nearer * kd) * alpha[..., None]
        return (
            window,
            np.dstack([colour, 255 * alpha]).astype(np.uint8),
            np.asarray(nearer + self.d, np.float32),
        )

    def _colour(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """Colours float32 (h, w, 3) of the points of the surface with these normals."""
        h, w = self.texture.shape[:2]
        longitude = np.arctan2(x, z) / (2 * np.pi) + 0.5
        latitude = np.arcsin(np.clip(y, -1, 1)) / np.pi + 0.5
        at = (longitude * (w - 1)).astype(np.float32), (latitude * (h - 1)).astype(np.float32)
        base = cv2.remap(self.texture, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        normal = np.stack([x, y, z], axis=-1)
        # ambient light, lamp, and light reflected by the table
        lit = 0.34 + 0.72 * np.clip(normal @ LIGHT, 0, 1) + 0.06 * np.clip(y, 0, 1)
        shine = 255 * self.gloss * np.clip(normal @ HIGHLIGHT, 0, 1) ** 60
        return np.asarray(np.clip(base * lit[..., None] + shine[..., None], 0, 255), np.float32)


Solid = Quad | Ball


def draw_view(
    solids: list[Solid], u: float, v: float, size_px: int = DEMO_SIZE_PX
) -> tuple[Picture, Floats]:
    """The view of the camera at grid offset (u, v) from the centre: uint8 (size_px, size_px, 3) RGB
    and its exact disparity.

    solids: back to front, together covering the whole view. disparity: float32 in px per grid step,
    at the pixel's centre, of the surface that covers more than half of the pixel.
    """
    picture = np.zeros((size_px, size_px, 3), np.uint8)
    disparity = np.full((size_px, size_px), np.nan, np.float32)
    for solid in solids:
        window, colour, depth = solid.projected(u, v, size_px)
        alpha = colour[..., 3]
        below = cv2.multiply(picture[window], cv2.merge([255 - alpha] * 3), scale=1 / 255)
        picture[window] = cv2.add(below, cv2.cvtColor(colour, cv2.COLOR_RGBA2RGB))
        np.copyto(disparity[window], depth, where=alpha > 127)
    return picture, disparity
