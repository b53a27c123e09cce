"""Steps of the depth controls in proportion to the scene: 20 px per view need larger steps than 0.4 px."""

import math

STEPS = 40  # from the farthest to the nearest of a scene
LEAST_PX = 0.01
UNKNOWN_PX = (-2.0, 2.0)  # if disparities are unknown, or all equal


def depth_step_px(low_px: float, high_px: float) -> float:
    """One press of a key: 1, 2 or 5 times a power of ten. low_px, high_px: disparities of the scene."""
    low_px, high_px = (low_px, high_px) if high_px > low_px else UNKNOWN_PX
    wanted = max((high_px - low_px) / STEPS, LEAST_PX)
    decade = 10.0 ** math.floor(math.log10(wanted) + 1e-9)
    return next(factor * decade for factor in (1, 2, 5, 10) if factor * decade >= wanted * (1 - 1e-9))


def depth_range_px(low_px: float, high_px: float) -> tuple[float, float]:
    """Zero planes to offer: the disparities of the scene and half their range beyond either end."""
    low_px, high_px = (low_px, high_px) if high_px > low_px else UNKNOWN_PX
    room = max((high_px - low_px) / 2, 10 * LEAST_PX)
    return low_px - room, high_px + room
