"""Exact light fields of simple solids: textured quads and balls, painted back to front; and their
textures: wallpaper, an eye chart, wood, balls, grass. Colours are RGB, lengths of textures are in
texels, TEXELS per px.

Space is (X, Y, d): px of the centre view and disparity in px per grid step, nearer is larger. The
camera u columns right of and v rows below the centre one sees the point (X, Y, d) at (X - d*u, Y -
d*v). Rays are straight lines and planes are planes, so a quad is one homography per view, and its
disparity is linear in the pixels of that view.
"""

from collections.abc import Callable
from typing import Any

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


Colour = tuple[int, int, int]
Texture = Callable[[np.random.Generator, int, int], Picture]  # (rng, height, width)

TEXELS = 2  # of a flat picture per px of a view; `opaque` removes detail that a view cannot show


def noise(
    rng: np.random.Generator, height: int, width: int, grain: tuple[float, float], octaves: int = 4
) -> Floats:
    """Smooth noise about 0, standard deviation 1.

    grain: (vertical, horizontal) size of its largest features.
    """
    total = np.zeros((height, width), np.float32)
    for octave in range(octaves):
        cells = [
            max(2, int(np.ceil(n * 2**octave / g)) + 2)
            for n, g in zip((height, width), grain, strict=True)
        ]
        field = rng.standard_normal(cells).astype(np.float32)
        total += cv2.resize(field, (width, height), interpolation=cv2.INTER_CUBIC) * 0.55**octave
    return np.asarray((total - total.mean()) / total.std(), np.float32)


def mixed(share: NDArray[np.floating], dark: Colour | Floats, light: Colour | Floats) -> Floats:
    """A mixture of two colours, float32 (h, w, 3). share (h, w): of the light one; is clipped."""
    weight = np.clip(share, 0, 1).astype(np.float32)[..., None]
    return np.asarray(
        (1 - weight) * np.asarray(dark, np.float32) + weight * np.asarray(light, np.float32),
        np.float32,
    )


def opaque(colour: NDArray[Any], scale: float = 1.0) -> Picture:
    """A texture of a flat picture without detail finer than a px, which would cause moire when the
    view changes. scale: of the view, against SIZE_PX.
    """
    sigma = 0.5 * TEXELS / scale
    picture = cv2.GaussianBlur(np.clip(colour, 0, 255).astype(np.uint8), (0, 0), sigma)
    return np.dstack([picture, np.full(picture.shape[:2], 255, np.uint8)])


def wood(rng: np.random.Generator, height: int, width: int, dark: Colour, light: Colour) -> Floats:
    warp = noise(rng, height, width, (height / 2, width / 1.5), 3)
    rings = np.sin(np.arange(height)[:, None] / 2.6 + 3.0 * warp)
    fibre = noise(rng, height, width, (1.5, 60), 2)
    return mixed(0.5 + 0.22 * rings + 0.16 * fibre + 0.06 * warp, dark, light)


def wall(rng: np.random.Generator, height: int, width: int) -> Picture:
    """Wallpaper with pairs of leaves, lit from above, left of its middle."""
    tile = np.full((72, 144, 3), (126, 150, 136), np.uint8)
    for across, down in ((36, 24), (108, 60)):
        for tilt in (-32, 32):
            cv2.ellipse(
                tile,
                (across + tilt // 4, down),
                (6, 17),
                -tilt,
                0,
                360,
                (92, 128, 98),
                -1,
                cv2.LINE_AA,
            )
    cv2.line(tile, (0, 0), (0, 72), (150, 172, 154), 3)
    paper = np.tile(tile, (height // 72 + 1, width // 144 + 1, 1))[:height, :width]
    low = height // 8, width // 8  # illumination is smooth
    y, x = np.ogrid[: 1 : low[0] * 1j, : 1 : low[1] * 1j]
    light = (1.0 - 0.52 * np.hypot(x - 0.32, y - 0.22)).astype(np.float32) + 0.05 * noise(
        rng, *low, (22, 22)
    )
    light = cv2.resize(light, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(cv2.multiply(paper, cv2.merge([light] * 3), dtype=cv2.CV_8U), np.uint8)


# text, its height and the height of its middle, as shares of the poster's height
LETTERS = (
    ("E", 0.2, 0.27),
    ("F P", 0.125, 0.469),
    ("T O Z", 0.09, 0.612),
    ("L P E D", 0.066, 0.726),
    ("P E C F D", 0.05, 0.82),
    ("E D F C Z P", 0.038, 0.9),
)
TITLE = (
    ("LIGHT", 0.11, 0.16),
    ("FIELD", 0.11, 0.32),
    ("one picture", 0.05, 0.5),
    ("for each eye,", 0.05, 0.605),
    ("from wherever", 0.05, 0.71),
    ("you look", 0.05, 0.815),
)


def poster(
    width: int,
    height: int,
    lines: tuple[tuple[str, float, float], ...],
    paper: tuple[Colour, Colour],
    ink: Colour,
    edge: Colour,
) -> Picture:
    """Lines of text on paper whose colour changes downwards, with a frame."""
    picture = mixed(np.linspace(0, 1, height)[:, None].repeat(width, 1), *paper).astype(np.uint8)
    cv2.rectangle(picture, (6, 6), (width - 7, height - 7), edge, 12)
    face = cv2.FONT_HERSHEY_DUPLEX
    for text, size, middle in lines:
        thick = max(1, round(size * height / 7))
        scale = size * height / cv2.getTextSize(text, face, 1.0, 1)[0][1]
        (w, h), _ = cv2.getTextSize(text, face, scale, thick)
        at = round(width / 2 - w / 2), round(middle * height + h / 2)
        cv2.putText(picture, text, at, face, scale, ink, thick, cv2.LINE_AA)
    return picture


def planet(rng: np.random.Generator, height: int, width: int) -> Picture:
    lie = noise(rng, height, width, (height / 2.5, width / 5), 6)
    sea = mixed(0.5 + 0.25 * lie, (18, 52, 120), (52, 128, 176))
    land = mixed(0.1 + 0.4 * lie, (92, 124, 54), (206, 182, 120))
    clouds = 0.8 * noise(rng, height, width, (height / 6, width / 6), 5) - 0.7
    return mixed(
        np.minimum(clouds, 0.85), mixed((lie - 0.15) * 8, sea, land), (245, 245, 245)
    ).astype(np.uint8)


def marble(rng: np.random.Generator, height: int, width: int) -> Picture:
    bands = 6 * np.arange(width) / width + 1.3 * noise(
        rng, height, width, (height / 2, width / 4), 5
    )
    return mixed(np.abs(np.sin(np.pi * bands)) ** 0.45, (120, 40, 30), (240, 226, 206)).astype(
        np.uint8
    )


def _checked(one: Colour, other: Colour) -> Texture:
    def checked(_rng: np.random.Generator, height: int, width: int) -> Picture:
        y, x = np.ogrid[:height, :width]
        wave = np.sin(2 * np.pi * x / width * 7) * np.sin(np.pi * y / height * 7)
        return mixed(0.5 + wave * height / 25, one, other).astype(np.uint8)  # edges one texel wide

    return checked


blue, red = _checked((240, 196, 40), (30, 84, 150)), _checked((236, 232, 220), (176, 30, 44))


def grass(rng: np.random.Generator, height: int, width: int, blades: int) -> Picture:
    colour = np.full((height, width, 3), (70, 110, 44), np.uint8)
    alpha = np.zeros((height, width), np.uint8)
    t = np.linspace(0, 1, 24)
    for _ in range(blades):
        foot = rng.uniform(0.12, 0.88) * width
        lean = rng.normal(0, 0.2) * width
        tall = rng.uniform(0.55, 0.97) * height
        x = foot + lean * t**2
        y = height - tall * t * (1 - 0.12 * t)
        half = 2.3 * TEXELS * (1 - t) ** 0.6 + 0.35 * TEXELS
        edges = (
            np.column_stack([x - half, y]),
            np.column_stack([x + half, y])[::-1],
            np.column_stack([x, y]),
        )
        left, right, rib = (np.round(edge * 16).astype(np.int32) for edge in edges)
        green = rng.uniform(0.75, 1.25)
        cv2.fillPoly(
            colour,
            [np.concatenate([left, right])],
            (92 * green, 150 * green, 46 * green),
            cv2.LINE_8,
            4,
        )
        cv2.polylines(
            colour, [rib], False, (130 * green, 190 * green, 70 * green), 1, cv2.LINE_AA, 4
        )
        cv2.fillPoly(alpha, [np.concatenate([left, right])], 255, cv2.LINE_AA, 4)
    blended = cv2.multiply(
        cv2.GaussianBlur(colour, (0, 0), 0.3 * TEXELS), cv2.merge([alpha] * 3), scale=1 / 255
    )
    return np.dstack([blended, alpha])


def shadow(strength: float) -> Picture:
    """A soft black blob. strength: at most 0.5, so that the surface below keeps its disparity."""
    y, x = np.ogrid[-1:1:64j, -1:1:64j]
    blob = np.zeros((64, 64, 4), np.uint8)
    blob[..., 3] = 254 * strength * np.clip(1 - x * x - y * y, 0, 1) ** 1.5
    return blob
