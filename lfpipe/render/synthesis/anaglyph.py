"""Two views in one picture, for any glasses: each view is projected to planes, then the planes are
mixed.

Every method of the form `M_left @ left + M_right @ right` becomes

    plane_k = w_k . RGB of one eye
    channel = own_gain * own plane + cross_gain * cross plane

w sums to 1, so a plane of a grey view is that grey; the gains sum to 1, so grey stays grey. The
planes are built once per stored view and can be warped like any picture. Mixing is a function
of two bytes, so one table of 65536 entries suffices for linear light, code values and any ghost
compensation. Planes are clipped and rounded to bytes before: against one float64 matrix, saturated
random colours deviate by up to 13 (Dubois), 40 (green/magenta) and 41 (amber/blue) levels in linear
light, photographs by 4 to 6. Methods without cross terms need no mixing: their picture is one merge
of three planes.

The cross rows of the red/cyan Dubois matrix are multiples of the other eye's own rows, to 0.004 per
coefficient, so three planes suffice. Otherwise (amber/blue, parts of green/magenta), the cross row
is a separate plane.

Matrices: FFmpeg vf_stereo3d (colour, grey, half-colour), Wimmer, Dubois 2001 (red/cyan) and Dubois
2009 (the others). Wimmer's omits the gamma of 1.5 on red that some copies have. With it, grey
differs between the eyes (mid grey by 11 L*), and photographs have a rivalry of 12 L* instead of
0.4.

For 3-D screens, two views are arranged in the screen's own pixels: after scaling, so that rows are
preserved.
"""

from functools import lru_cache
from typing import NamedTuple

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.files.codecs import fit_area
from lfpipe.host.worker import add
from lfpipe.scene.optical_flow import LUMA

Weights = tuple[float, float, float]

RED: Weights = (1.0, 0.0, 0.0)
GREEN: Weights = (0.0, 1.0, 0.0)
BLUE: Weights = (0.0, 0.0, 1.0)
NONE: Weights = (0.0, 0.0, 0.0)

# Rows: red, green and blue of the output,
# from (red, green, blue) of the left eye and of the right eye.
MATRICES: dict[
    str, tuple[tuple[Weights, Weights], tuple[Weights, Weights], tuple[Weights, Weights]]
] = {
    "colour": ((RED, NONE), (NONE, GREEN), (NONE, BLUE)),
    "grey": ((LUMA, NONE), (NONE, LUMA), (NONE, LUMA)),
    "half-colour": ((LUMA, NONE), (NONE, GREEN), (NONE, BLUE)),
    "wimmer": (((0.0, 0.7, 0.3), NONE), (NONE, GREEN), (NONE, BLUE)),
    "dubois": (
        ((0.4561, 0.500484, 0.176381), (-0.0434706, -0.0879388, -0.00155529)),
        ((-0.0400822, -0.0378246, -0.0157589), (0.378476, 0.73364, -0.0184503)),
        ((-0.0152161, -0.0205971, -0.00546856), (-0.0721527, -0.112961, 1.2264)),
    ),
    "dubois-green-magenta": (
        ((-0.062, -0.158, -0.039), (0.529, 0.705, 0.024)),
        ((0.284, 0.668, 0.143), (-0.016, -0.015, -0.065)),
        ((-0.015, -0.027, 0.021), (0.009, 0.075, 0.937)),
    ),
    "dubois-amber-blue": (
        ((1.062, -0.205, 0.299), (-0.016, -0.123, -0.017)),
        ((-0.026, 0.908, 0.068), (0.006, 0.062, -0.017)),
        ((-0.038, -0.173, 0.022), (0.094, 0.185, 0.911)),
    ),
}

# Luminance of red, green and blue through the left and the right glass,
# from measured spectra (`bench.simulator.metrics.GLASS`).
LEAKS = {
    **dict.fromkeys(
        ("colour", "grey", "half-colour", "wimmer", "dubois"),
        ((0.0922, 0.0135, 0.0001), (0.0009, 0.2381, 0.0658)),
    ),
    "dubois-green-magenta": ((0.0006, 0.1266, 0.0170), (0.1174, 0.0153, 0.0043)),
}
MIN_LEAK = 0.01  # a smaller leak is invisible: the right filter of red/cyan transmits 0.4 %
WIDE_LUT = int(cv2.__version__.split(".")[0]) >= 5  # cv2.LUT takes 16-bit indices
SHARED_TOLERANCE = 0.015  # a cross row this close to a multiple of an own row uses the own plane


class Plane(NamedTuple):
    """A plane computed from one eye's view."""

    eye: int  # 0 left, 1 right
    weights: Weights  # of its red, green and blue; they sum to 1
    linear: bool  # whether they apply to linear light instead of code values

    @property
    def channels(self) -> tuple[int, ...]:
        """The stored channels that it is computed from; a single one is the plane itself."""
        return tuple(k for k, weight in enumerate(self.weights) if weight)


@attrs.frozen
class Channel:
    """One output channel: own_gain * own + cross_gain * cross."""

    own: int  # index of a plane
    cross: int | None = None  # index of a plane; None: the channel is the own plane itself
    own_gain: float = 1.0
    cross_gain: float = 0.0

    @property
    def pair(self) -> tuple[int, int] | None:
        """The indices of both planes, the lower first; None without a cross plane."""
        if self.cross is None:
            return None
        return min(self.own, self.cross), max(self.own, self.cross)


@attrs.frozen
class Recipe:
    """The composition of an output picture."""

    planes: tuple[Plane, ...]
    channels: tuple[Channel, Channel, Channel]  # red, green, blue
    linear: bool  # whether planes are mixed in linear light instead of code values


def decoded(code: NDArray[np.float64]) -> NDArray[np.float64]:
    """sRGB code values 0..1 as linear light 0..1 (IEC 61966-2-1)."""
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)


def encoded(light: NDArray[np.float64]) -> NDArray[np.float64]:
    """Linear light, clipped to 0..1, as sRGB code values 0..1."""
    light = np.clip(light, 0.0, 1.0)
    return np.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055)


def _unit(row: Weights) -> tuple[Weights, float]:
    """row scaled to the sum 1, and its sum."""
    total = add(row)
    return (row[0] / total, row[1] / total, row[2] / total), total


@lru_cache(maxsize=64)
def recipe(anaglyph: str, light: str = "linear", ghost_compensation: float = 0.0) -> Recipe:
    """The recipe of a glasses method.

    anaglyph: a key of MATRICES. light: "linear" or "gamma"; it affects only methods with cross
    terms, because the others do not sum the views. ghost_compensation: 0..100 %, the share to
    subtract of the light that leaks through the other eye's filter: green through red; blue through
    green and green through magenta. The spectra of amber/blue glasses are unknown: the matrix
    determines their share. A channel is raised by the amount that it loses on grey: grey stays
    grey. A channel with an empty row stays dark, as for red/green glasses.
    """
    stated = MATRICES[anaglyph]
    dark = [not any((*left, *right)) for left, right in stated]
    # a dark channel has the planes of another one
    rows = [stated[dark.index(False)] if no else row for row, no in zip(stated, dark, strict=True)]
    crossed = any(sum(map(abs, row[0])) > 0 and sum(map(abs, row[1])) > 0 for row in rows)
    linear = crossed and light == "linear"
    eyes = [int(abs(sum(right)) > abs(sum(left))) for left, right in rows]
    planes: dict[Plane, int] = {}  # and their indices

    def plane(eye: int, weights: Weights) -> int:
        return planes.setdefault(Plane(eye, weights, linear), len(planes))

    own = [_unit(row[eye]) for row, eye in zip(rows, eyes, strict=True)]
    index = [plane(eye, weights) for (weights, _), eye in zip(own, eyes, strict=True)]
    channels: list[Channel] = []
    for c, (row, eye) in enumerate(zip(rows, eyes, strict=True)):
        other = row[1 - eye]
        if not any(other):
            channels.append(Channel(index[c]))
            continue
        weights, total = _unit(other)
        errors = {
            max(abs(a - total * b) for a, b in zip(other, own[k][0], strict=True)): index[k]
            for k in range(3)
            if eyes[k] != eye
        }
        near = min(errors)
        cross = errors[near] if near <= SHARED_TOLERANCE else plane(1 - eye, weights)
        gain = own[c][1] / (own[c][1] + total)
        channels.append(Channel(index[c], cross, gain, 1.0 - gain))
    if ghost_compensation > 0 and anaglyph in LEAKS:
        channels = _compensated(channels, eyes, LEAKS[anaglyph], ghost_compensation / 100)
    red, green, blue = (
        Channel(one.own, one.own, 0.0, 0.0) if no else one
        for one, no in zip(channels, dark, strict=True)
    )
    return Recipe(tuple(planes), (red, green, blue), light == "linear")


def _compensated(
    channels: list[Channel], eyes: list[int], glasses: tuple[Weights, Weights], share: float
) -> list[Channel]:
    """The channels, with a share of the leak subtracted from the brightest channel of each eye.

    Light through a filter: main + leak * other. (1 + leak) * own view - leak * other leaves only
    the own view.
    """
    compensated = list(channels)
    for eye, through in enumerate(glasses):
        main = max((c for c in range(3) if eyes[c] == eye), key=lambda c: through[c])
        others = [c for c in range(3) if eyes[c] != eye]
        worst = max(others, key=lambda c: through[c])
        leak = add(through[c] for c in others) / through[main]
        if leak >= MIN_LEAK:
            cross_gain = (1 - share) * channels[main].cross_gain + share * -leak * channels[
                worst
            ].own_gain
            compensated[main] = Channel(
                channels[main].own, channels[worst].own, 1.0 - cross_gain, cross_gain
            )
    return compensated


@lru_cache(maxsize=64)
def _table(channel: Channel, linear: bool) -> NDArray[np.uint8]:
    """(1, 65536) uint8: the channel for every pair of bytes, the first one of its pair of planes in
    the low byte of the index.
    """
    code = np.arange(256) / 255.0
    light = decoded(code) if linear else code
    low, high = channel.own_gain, channel.cross_gain
    if channel.pair != (channel.own, channel.cross):
        low, high = high, low
    mixed = high * light[:, None] + low * light[None, :]
    value = encoded(mixed) if linear else np.clip(mixed, 0.0, 1.0)
    return np.rint(value * 255).astype(np.uint8).reshape(1, -1)


class Mixer:
    """Mixes planes of one size to a picture; owns its buffers, so a call allocates nothing."""

    def __init__(self, recipe: Recipe, size_px: tuple[int, int]) -> None:
        """size_px: (height, width) of the planes."""
        self._own = [channel.own for channel in recipe.channels]
        # of channels with a cross plane: the pair of planes, the table, and scratch
        self._mixed = {
            k: (channel.pair, _table(channel, recipe.linear), np.empty(size_px, np.uint8))
            for k, channel in enumerate(recipe.channels)
            if channel.pair
        }
        # two planes as one index into a table
        self._pairs = {pair: np.empty((*size_px, 2), np.uint8) for pair, *_ in self._mixed.values()}

    def mix(
        self, planes: list[NDArray[np.uint8]], out: NDArray[np.uint8], rows: slice = slice(None)
    ) -> NDArray[np.uint8]:
        """Mixes planes, uint8 (height, width) in the recipe's order, into out, uint8 (height,
        width, 3) BGR. rows: only these; two threads may mix different rows.
        """
        for (low, high), index in self._pairs.items():
            cv2.merge([planes[low][rows], planes[high][rows]], index[rows])
        channels = [planes[own][rows] for own in self._own]
        for k, (pair, table, scratch) in self._mixed.items():
            channels[k] = scratch[rows]
            wide_lookup(self._pairs[pair][rows].view("<u2")[..., 0], table, channels[k])
        cv2.merge(channels[::-1], out[rows])
        return out


def wide_lookup(
    index: NDArray[np.uint16], table: NDArray[np.uint8], out: NDArray[np.uint8]
) -> None:
    """out = table[0][index]; table: (1, 65536).

    `cv2.LUT` takes 8 bits only before OpenCV 5, which plain pip cannot install.
    """
    if WIDE_LUT:
        cv2.LUT(index, table, out)
    else:
        np.take(table[0], index, out=out, mode="clip")


class PlaneBuilder:
    """Builds a plane from a stored view: a sum of weighted light in 16 bits, converted back to code
    values.
    """

    def __init__(self, size_px: tuple[int, int]) -> None:
        """size_px: (height, width) of the views."""
        self._plus, self._minus, self._term = np.empty((3, *size_px), np.uint16)

    def build(self, view: NDArray[np.uint8], plane: Plane) -> NDArray[np.uint8]:
        """The plane, uint8 (height, width): a new array, or a channel of the view itself.

        view: uint8 (3, height, width), red, green, blue.
        """
        first, *others = plane.channels
        if not others:
            return np.asarray(view[first])
        terms, back = _plane_tables(plane.weights, plane.linear)
        for sign, total in ((1, self._plus), (-1, self._minus)):
            of_sign = [k for k, weight in enumerate(plane.weights) if sign * weight > 0]
            for number, channel in enumerate(of_sign):
                cv2.LUT(view[channel], terms[channel], self._term if number else total)
                if number:
                    cv2.add(total, self._term, total)
        if min(plane.weights) < 0:
            cv2.subtract(self._plus, self._minus, self._plus)
        out = np.empty(view.shape[1:], np.uint8)
        wide_lookup(self._plus, back, out)
        return out


@lru_cache(maxsize=64)
def _plane_tables(
    weights: Weights, linear: bool
) -> tuple[list[NDArray[np.uint16]], NDArray[np.uint8]]:
    """Per channel (1, 256) uint16 of |weight| * light, and (1, 65536) uint8 from their sum back to
    code values.

    The scale lets the positive terms together reach 65535 and no more, so sums never saturate.
    """
    code = np.arange(256) / 255.0
    light = decoded(code) if linear else code
    scale = 65530.0 / add(max(weight, 0.0) for weight in weights)
    terms = [
        np.rint(abs(weight) * scale * light).astype(np.uint16).reshape(1, -1) for weight in weights
    ]
    level = np.arange(65536) / scale
    value = encoded(level) if linear else np.clip(level, 0.0, 1.0)
    return terms, np.rint(value * 255).astype(np.uint8).reshape(1, -1)


def encode(left: NDArray[np.uint8], right: NDArray[np.uint8], how: Recipe) -> NDArray[np.uint8]:
    """The anaglyph of two pictures, uint8 (height, width, 3) BGR each, as a new one: for notebooks,
    metrics and tests.
    """
    views = [
        np.ascontiguousarray(picture[..., ::-1].transpose(2, 0, 1)) for picture in (left, right)
    ]
    builder = PlaneBuilder(left.shape[:2])
    planes = [builder.build(views[plane.eye], plane) for plane in how.planes]
    return Mixer(how, left.shape[:2]).mix(planes, np.empty_like(left))


def scale_into(picture: NDArray[np.uint8], out: NDArray[np.uint8]) -> None:
    """Scales picture into out, which has equally many channels: cubic to enlarge (as fast as
    linear), by area to shrink; a copy if the sizes are equal.
    """
    way = cv2.INTER_AREA if out.size < picture.size else cv2.INTER_CUBIC
    cv2.resize(picture, (out.shape[1], out.shape[0]), dst=out, interpolation=way)


Pair = tuple[NDArray[np.uint8], NDArray[np.uint8]]


def arrange_stereo_pair(
    pair: Pair,
    how: str,
    screen_px: tuple[int, int],
    first_row: int = 0,
    out: NDArray[np.uint8] | None = None,
) -> NDArray[np.uint8]:
    """The picture, uint8 (height, width, 3) BGR, of exactly screen_px (width, height); written to
    out if that has the size.

    pair: left and right view. how: "row-interleaved" (even rows of the screen to the left eye) or
    "side-by-side" (each view squeezed into its half, so that a 3-D screen that stretches the halves
    shows it in its own shape). first_row: the row of the screen on which the picture begins.
    """
    width, height = screen_px
    if out is None or out.shape != (height, width, 3):
        out = np.empty((height, width, 3), np.uint8)
    x, y, w, h = fit_area((pair[0].shape[1], pair[0].shape[0]), screen_px)
    if (w, h) != screen_px:
        out[:] = 0
    for eye, view in enumerate(pair):
        if how == "side-by-side":
            left, right = (eye * width + x) // 2, (eye * width + x + w) // 2
            if left < right:  # else the screen is too narrow for two
                scale_into(view, out[y : y + h, left:right])
            continue
        whole = np.empty((h, w, 3), np.uint8)
        scale_into(view, whole)
        row = (eye - first_row - y) % 2  # of the area: on the screen it is row first_row + y + row
        out[y + row : y + h : 2, x : x + w] = whole[row::2]
    return out
