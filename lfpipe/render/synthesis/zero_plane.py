"""The zero plane: the disparity in the plane of the screen."""

from lfpipe.config import Render
from lfpipe.scene.lightfield import LightField

# zero planes to offer, from the farthest to the nearest point of a scene; the smallest step
PLANES, MIN_STEP_PX = 40, 0.01
UNKNOWN_PX = (-2.0, 2.0)  # disparities if they are unknown, or all equal


def zero_plane_px(field: LightField, render: Render) -> float:
    """render.zero_plane_px as a number, px per view."""
    return field.border_px[1] if isinstance(render.zero_plane_px, str) else render.zero_plane_px


def zero_planes_px(low_px: float, high_px: float) -> tuple[float, float, float]:
    """(minimum, maximum, step) of the zero planes to offer: the disparities of a scene, low_px to
    high_px, and half their range beyond either end.
    """
    low_px, high_px = (low_px, high_px) if high_px > low_px else UNKNOWN_PX
    step_px = float(f"{max((high_px - low_px) / PLANES, MIN_STEP_PX):.0g}")
    margin_px = max((high_px - low_px) / 2, 10 * MIN_STEP_PX)
    return low_px - margin_px, high_px + margin_px, step_px
