"""The disparity that lies in the plane of the screen, and the steps by which a person moves it.

What the border of a picture cuts off must not stand before the screen: a window violation, which the eyes cannot fuse. `auto`
puts the nearest thing at the left and right border into the screen; what is in the middle may come forward.
"""

import math

from lfpipe.config import Render
from lfpipe.scene.lightfield import LightField

STEPS = 40  # from the farthest to the nearest of a scene
LEAST_PX = 0.01
UNKNOWN_PX = (-2.0, 2.0)  # if disparities are unknown, or all equal


def zero_plane_px(field: LightField, render: Render) -> float:
    """render.zero_plane_px as a number, px per view."""
    return field.border_px[1] if isinstance(render.zero_plane_px, str) else render.zero_plane_px


def depth_step_px(low_px: float, high_px: float) -> float:
    """One press of a key: 1, 2 or 5 times a power of ten. low_px, high_px: disparities of the scene."""
    low_px, high_px = (low_px, high_px) if high_px > low_px else UNKNOWN_PX
    least_px = max((high_px - low_px) / STEPS, LEAST_PX)
    decade = 10.0 ** math.floor(math.log10(least_px) + 1e-9)
    return next(factor * decade for factor in (1, 2, 5, 10) if factor * decade >= least_px * (1 - 1e-9))


def depth_range_px(low_px: float, high_px: float) -> tuple[float, float]:
    """Zero planes to offer: the disparities of the scene and half their range beyond either end."""
    low_px, high_px = (low_px, high_px) if high_px > low_px else UNKNOWN_PX
    room = max((high_px - low_px) / 2, 10 * LEAST_PX)
    return low_px - room, high_px + room
