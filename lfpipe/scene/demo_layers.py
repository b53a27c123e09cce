"""Exact light-field rendering of simple solids: textured quads and balls, painted back to front.

Space is (X, Y, d): px of the centre view and disparity in px per grid step, nearer is larger. The camera u columns right of and v
rows below the centre one sees the point (X, Y, d) at (X - d*u, Y - d*v). Rays are straight lines and planes are planes, so a quad
is one homography per view, and its disparity is linear in the pixels of that view.
"""

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
Floats = NDArray[np.float32]
LIGHT = np.array([-0.45, -0.62, 0.64], np.float32)  # towards the lamp: left, above, before


@attrs.define
class Canvas:
    """One view while it is painted. fine: uint8 (height*super, width*super, 3) BGR; disparity: float32 (height, width)."""

    fine: Picture
    disparity: Floats
    super: int


def _span(low: float, high: float, limit: int) -> slice:
    return slice(max(0, int(np.floor(low))), max(0, min(limit, int(np.ceil(high)) + 1)))


def _blend(target: Picture, picture: Picture) -> None:
    """target = picture over target, in place; picture is BGRA, pre-multiplied."""
    alpha = cv2.extractChannel(picture, 3)
    cv2.copyTo(cv2.cvtColor(picture, cv2.COLOR_BGRA2BGR), cv2.inRange(alpha, 255, 255), target)
    if (rim := cv2.findNonZero(cv2.inRange(alpha, 1, 254))) is not None:
        x, y = rim.reshape(-1, 2).T
        above, below = picture[y, x], target[y, x].astype(np.uint16)
        target[y, x] = np.minimum((below * (255 - above[:, 3:].astype(np.uint16)) + 127) // 255 + above[:, :3], 255)


@attrs.frozen(eq=False)
class Quad:
    """A flat picture.

    texture: uint8 (h, w, 4) BGRA, pre-multiplied. corners: float (4, 3) of (X, Y, d), clockwise from top left, in one plane.
    """

    texture: Picture
    corners: NDArray[np.float64]

    def paint(self, canvas: Canvas, u: float, v: float) -> None:
        """Paints the quad over the existing picture, as the camera at grid offset (u, v) sees it.

        Disparity is set where the texture covers more than half of a pixel's centre.
        """
        seen = self.corners[:, :2] - self.corners[:, 2:] * np.array([u, v])
        self._paint_colour(canvas, seen)
        self._paint_disparity(canvas, seen)

    def _warped(
        self, texture: Picture, seen: NDArray[np.float64], origin: tuple[float, float], scale: int, size: tuple[int, int]
    ) -> Picture:
        h, w = self.texture.shape[:2]
        # The texture's edge, not the centre of its first texel, lies on the corner; pixel i covers i - 1/2 .. i + 1/2.
        source = np.array([[0, 0], [w, 0], [w, h], [0, h]], np.float32) - 0.5
        target = (seen + 0.5 - np.array(origin)) * scale - 0.5
        matrix = cv2.getPerspectiveTransform(source, target.astype(np.float32))
        return np.asarray(cv2.warpPerspective(texture, matrix, size, flags=cv2.INTER_LINEAR), np.uint8)

    def _paint_colour(self, canvas: Canvas, seen: NDArray[np.float64]) -> None:
        height, width = canvas.disparity.shape
        rows, cols = _span(seen[:, 1].min(), seen[:, 1].max(), height), _span(seen[:, 0].min(), seen[:, 0].max(), width)
        size = (cols.stop - cols.start) * canvas.super, (rows.stop - rows.start) * canvas.super
        if min(size) <= 0:
            return
        warped = self._warped(self.texture, seen, (cols.start, rows.start), canvas.super, size)
        y, x = rows.start * canvas.super, cols.start * canvas.super
        _blend(canvas.fine[y : y + size[1], x : x + size[0]], warped)

    def _paint_disparity(self, canvas: Canvas, seen: NDArray[np.float64]) -> None:
        height, width = canvas.disparity.shape
        alpha = self._warped(np.ascontiguousarray(self.texture[..., 3]), seen, (0, 0), 1, (width, height))
        basis = np.column_stack([seen[[0, 1, 3]], np.ones(3)])
        gx, gy, d0 = np.linalg.solve(basis, self.corners[[0, 1, 3], 2])
        y, x = np.nonzero(alpha > 127)
        canvas.disparity[y, x] = gx * x + gy * y + d0


@attrs.frozen(eq=False)
class Ball:
    """A ball of radius px about (x, y, d) that reaches depth px/step before and behind its middle.

    texture: uint8 (h, w, 3) BGR, wrapped around it; gloss: strength of the highlight, 0 to 1.
    """

    texture: Picture
    x: float
    y: float
    d: float
    radius: float
    depth: float
    gloss: float

    def paint(self, canvas: Canvas, u: float, v: float) -> None:
        """Paints the ball over the existing picture, as the camera at grid offset (u, v) sees it."""
        height, width = canvas.disparity.shape
        reach = self.radius * 1.02 + self.depth * float(np.hypot(u, v)) + 1
        at_x, at_y = self.x - self.d * u, self.y - self.d * v
        rows, cols = _span(at_y - reach, at_y + reach, height), _span(at_x - reach, at_x + reach, width)
        if rows.stop <= rows.start or cols.stop <= cols.start:
            return
        n = canvas.super
        fine_y = np.asarray((np.arange(rows.start * n, rows.stop * n) + 0.5) / n - 0.5, np.float32)
        fine_x = np.asarray((np.arange(cols.start * n, cols.stop * n) + 0.5) / n - 0.5, np.float32)
        depth, inside = self._hit(fine_x[None, :], fine_y[:, None], u, v)
        colour = self._colour(fine_x[None, :] + depth * u, fine_y[:, None] + depth * v, depth)
        window = canvas.fine[rows.start * n : rows.stop * n, cols.start * n : cols.stop * n]
        np.copyto(window, colour, where=inside[..., None])
        y = np.arange(rows.start, rows.stop, dtype=np.float32)
        x = np.arange(cols.start, cols.stop, dtype=np.float32)
        depth, inside = self._hit(x[None, :], y[:, None], u, v)
        np.copyto(canvas.disparity[rows, cols], depth, where=inside)

    def _hit(self, x: Floats, y: Floats, u: float, v: float) -> tuple[Floats, NDArray[np.bool_]]:
        """Disparity of the nearest point on the ray of pixel (x, y), and whether there is one.

        ((x + d u - X)/R)^2 + ((y + d v - Y)/R)^2 + ((d - D)/depth)^2 = 1 solved for its larger d.
        """
        px, py = (x + self.d * u - self.x) / self.radius, (y + self.d * v - self.y) / self.radius
        ku, kv, kd = u / self.radius, v / self.radius, 1 / self.depth
        a = ku * ku + kv * kv + kd * kd
        half_b = px * ku + py * kv
        root = half_b * half_b - a * (px * px + py * py - 1)
        near = (np.sqrt(np.maximum(root, 0)) - half_b) / a
        return np.asarray(near + self.d, np.float32), np.asarray(root > 0)

    def _colour(self, x: Floats, y: Floats, d: Floats) -> Picture:
        normal = np.stack([(x - self.x) / self.radius, (y - self.y) / self.radius, (d - self.d) / self.depth], -1)
        h, w = self.texture.shape[:2]
        longitude = np.arctan2(normal[..., 0], normal[..., 2]) / (2 * np.pi) + 0.5
        latitude = np.arcsin(np.clip(normal[..., 1], -1, 1)) / np.pi + 0.5
        base = cv2.remap(
            self.texture,
            (longitude * (w - 1)).astype(np.float32),
            (latitude * (h - 1)).astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        facing = normal @ (LIGHT / np.linalg.norm(LIGHT))
        lit = 0.34 + 0.72 * np.clip(facing, 0, 1) + 0.06 * np.clip(normal[..., 1], 0, 1)  # lamp, room, and light from the table
        half = LIGHT / np.linalg.norm(LIGHT) + np.array([0, 0, 1])
        shine = self.gloss * np.clip(normal @ (half / np.linalg.norm(half)), 0, 1) ** 60
        return np.asarray(np.clip(base * lit[..., None] + 255 * shine[..., None], 0, 255), np.uint8)


Solid = Quad | Ball


def render_view(
    solids: list[Solid], width_px: int, height_px: int, u: float, v: float, supersample: int = 3
) -> tuple[Picture, Floats]:
    """The view of the camera at grid offset (u, v) from the centre: uint8 (height, width, 3) BGR and its exact disparity.

    solids: back to front, together covering the whole view. disparity: float32 (height, width) in px per grid step, at the
    pixel's centre.
    """
    fine = np.zeros((height_px * supersample, width_px * supersample, 3), np.uint8)
    canvas = Canvas(fine, np.full((height_px, width_px), np.nan, np.float32), supersample)
    for solid in solids:
        solid.paint(canvas, u, v)
    picture = cv2.resize(fine, (width_px, height_px), interpolation=cv2.INTER_AREA)
    return np.asarray(picture, np.uint8), canvas.disparity
