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
LIGHT /= np.linalg.norm(LIGHT)
SUPERSAMPLE = 3  # fine px to one px of a view, along either side


def _span(low: float, high: float, limit: int) -> slice:
    return slice(max(0, int(np.floor(low))), max(0, min(limit, int(np.ceil(high)) + 1)))


def _fine(rows: slice, cols: slice) -> tuple[slice, slice]:
    n = SUPERSAMPLE
    return slice(rows.start * n, rows.stop * n), slice(cols.start * n, cols.stop * n)


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

    def paint(self, fine: Picture, disparity: Floats, u: float, v: float) -> None:
        """Paints the quad over the existing picture, as the camera at grid offset (u, v) sees it.

        Disparity is set where the texture covers more than half of a pixel's centre.
        """
        seen = self.corners[:, :2] - self.corners[:, 2:] * np.array([u, v])
        height, width = disparity.shape
        cols, rows = (_span(x.min(), x.max(), limit) for x, limit in zip(seen.T, (width, height), strict=True))
        if rows.stop > rows.start and cols.stop > cols.start:
            window, origin = fine[_fine(rows, cols)], np.array([cols.start, rows.start])
            _blend(window, self._warped(self.texture, (seen + 0.5 - origin) * SUPERSAMPLE - 0.5, window))
        alpha = self._warped(np.ascontiguousarray(self.texture[..., 3]), seen, disparity)
        gx, gy, d0 = np.linalg.solve(np.column_stack([seen[[0, 1, 3]], np.ones(3)]), self.corners[[0, 1, 3], 2])
        y, x = np.nonzero(alpha > 127)
        disparity[y, x] = gx * x + gy * y + d0

    def _warped(self, texture: Picture, corners: NDArray[np.float64], like: NDArray[np.generic]) -> Picture:
        """texture with its corners at px of a picture of the size of `like`."""
        h, w = texture.shape[:2]
        # The texture's edge, not the centre of its first texel, lies on the corner; pixel i covers i - 1/2 .. i + 1/2.
        source = np.array([[0, 0], [w, 0], [w, h], [0, h]], np.float32) - 0.5
        matrix = cv2.getPerspectiveTransform(source, corners.astype(np.float32))
        return np.asarray(cv2.warpPerspective(texture, matrix, like.shape[1::-1], flags=cv2.INTER_LINEAR), np.uint8)

    def scaled(self, scale: float) -> "Quad":
        """The same for views of another size. A texture finer than the picture would alias."""
        texture = self.texture
        if scale < 1:
            size = [max(2, round(n * scale)) for n in texture.shape[1::-1]]
            texture = np.asarray(cv2.resize(texture, size, interpolation=cv2.INTER_AREA), np.uint8)
        return Quad(texture, self.corners * scale)


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

    def paint(self, fine: Picture, disparity: Floats, u: float, v: float) -> None:
        """Paints the ball over the existing picture, as the camera at grid offset (u, v) sees it."""
        reach = self.radius * 1.02 + self.depth * float(np.hypot(u, v)) + 1
        centre = self.y - self.d * v, self.x - self.d * u
        rows, cols = (_span(at - reach, at + reach, limit) for at, limit in zip(centre, disparity.shape, strict=True))
        if rows.stop <= rows.start or cols.stop <= cols.start:
            return
        window = _fine(rows, cols)
        y, x = (np.asarray((np.arange(s.start, s.stop) + 0.5) / SUPERSAMPLE - 0.5, np.float32) for s in window)
        depth, inside = self._hit(x[None, :], y[:, None], u, v)
        colour = self._colour(x[None, :] + depth * u, y[:, None] + depth * v, depth)
        np.copyto(fine[window], colour, where=inside[..., None])
        y, x = (np.arange(s.start, s.stop, dtype=np.float32) for s in (rows, cols))
        depth, inside = self._hit(x[None, :], y[:, None], u, v)
        np.copyto(disparity[rows, cols], depth, where=inside)

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
        at_x, at_y = (longitude * (w - 1)).astype(np.float32), (latitude * (h - 1)).astype(np.float32)
        base = cv2.remap(self.texture, at_x, at_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        # lamp, room, and light from the table
        lit = 0.34 + 0.72 * np.clip(normal @ LIGHT, 0, 1) + 0.06 * np.clip(normal[..., 1], 0, 1)
        half = LIGHT + np.array([0, 0, 1])
        shine = self.gloss * np.clip(normal @ (half / np.linalg.norm(half)), 0, 1) ** 60
        return np.asarray(np.clip(base * lit[..., None] + 255 * shine[..., None], 0, 255), np.uint8)

    def scaled(self, scale: float) -> "Ball":
        """The same for views of another size."""
        lengths = {name: getattr(self, name) * scale for name in ("x", "y", "d", "radius", "depth")}
        return attrs.evolve(self, **lengths)


Solid = Quad | Ball


def render_view(solids: list[Solid], size_px: int, u: float, v: float) -> tuple[Picture, Floats]:
    """The view of the camera at grid offset (u, v) from the centre: uint8 (size_px, size_px, 3) BGR and its exact disparity.

    solids: back to front, together covering the whole view. disparity: float32 in px per grid step, at the pixel's centre.
    """
    fine = np.zeros((size_px * SUPERSAMPLE, size_px * SUPERSAMPLE, 3), np.uint8)
    disparity = np.full((size_px, size_px), np.nan, np.float32)
    for solid in solids:
        solid.paint(fine, disparity, u, v)
    return np.asarray(cv2.resize(fine, (size_px, size_px), interpolation=cv2.INTER_AREA), np.uint8), disparity
