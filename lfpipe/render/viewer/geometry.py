"""Alpha from the viewer's distance, the screen and the scene's disparities; it determines the eye
distance on the view grid.

The eyes are S views apart, `alpha = IPD_px / S`. A scene of baseline b and focus distance F, seen
from distance Z with eye distance e, has true depth at `S_true = e F / (b Z)`. Fewer views flatten
it by `g = S / S_true`, in stereo and in motion alike, so the scene stays rigid. The comfort limit
is the limit of fusion: on the screen, the two images of a point of disparity d are `S |d - zero
plane| pitch` apart, at most 1 degree of visual angle and 3 % of the picture's width.

Objects that the border cuts off must not appear in front of the screen: a window violation, which
the eyes cannot fuse. The zero plane `auto` puts the nearest thing at the left and right border at
the screen; objects in the middle may appear in front.
"""

import math

import attrs

from lfpipe.config import Config, options
from lfpipe.config.camera_pose import camera_focal_px
from lfpipe.eyes import MIN_EYE_DISTANCE_PX
from lfpipe.render.display.display import PICTURE_MM as PICTURE_MM
from lfpipe.render.synthesis.viewpoint import zero_plane_px
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.source import Geometry

SEAT_MM = 600.0  # assumed distance of the viewer until a face is seen
DISTANCE = options()["screen.distance_mm"]
# limits that most people fuse immediately: docs/comfort.md
FUSED_RAD = math.radians(1.0)
FUSED_WIDTH = 0.03
DEFAULT_VIEWS = 4.0  # between the eyes, if the disparities are unknown
FULL_DEPTH = 0.995  # share of true depth that is shown as all of it
MIN_VIEWS = 1e-3  # so that alpha stays finite


@attrs.frozen(kw_only=True)
class Parallax:
    """The chosen alpha and the reason; `str()` returns everything in lines, for the log."""

    alpha_px: float
    """Camera px per view."""
    views_between_eyes: float
    """S."""
    comfort_views: float | None
    """The largest comfortable S; None if unknown."""
    true_views: float | None
    """S_true; None if unknown."""
    distance_mm: float
    eyes_px: float
    """Eye distance in the camera picture."""
    zero_plane_px: float
    """The disparity in the plane of the screen that S was chosen for."""
    reasons: tuple[str, ...]

    @property
    def compression(self) -> float | None:
        """g, None if the capture's geometry is unknown."""
        return self.views_between_eyes / self.true_views if self.true_views else None

    def differs_from(self, other: "Parallax") -> bool:
        """Whether a person should be informed: another number of views between the eyes, or a
        distance changed by 15 %.
        """
        return (
            abs(self.views_between_eyes - other.views_between_eyes) > 0.005
            or abs(self.alpha_px / other.alpha_px - 1) > 0.15
        )

    @property
    def summary(self) -> str:
        """One line, for a viewer who has just sat down."""
        seat = f"you sit {self.distance_mm / 10:.0f} cm from the screen"
        share, comfort_views = self.compression, self.comfort_views or math.inf
        if share is None:
            return seat
        if share < FULL_DEPTH:
            why = " for comfort" * (self.views_between_eyes >= comfort_views * FULL_DEPTH)
            return f"{seat}; depth is reduced to {share:.0%}{why}"
        return f"{seat}; depth is true"

    def __str__(self) -> str:
        views = f"{self.views_between_eyes:.2f} views between the eyes"
        return "\n  ".join(
            (f"alpha {self.alpha_px:.2f} px/view, {views}", self.summary, *self.reasons)
        )


def parallax(
    config: Config,
    field: LightField,
    frame_width_px: int,
    eyes_px: float | None,
    picture_mm: float | None = None,
) -> Parallax:
    """Chooses alpha.

    frame_width_px: of the camera picture. eyes_px: eye distance in it; None, or an impossible
    value, before a face is seen. picture_mm: `Display.width_mm`.
    """
    render, screen = config.render, config.screen
    eyes_mm = screen.eyes_mm
    focal_px = camera_focal_px(config, frame_width_px)
    measured_px = (
        eyes_px
        if eyes_px is not None and MIN_EYE_DISTANCE_PX <= eyes_px <= frame_width_px
        else None
    )
    if screen.distance_mm != "auto":
        distance_mm, why = float(screen.distance_mm), "configured"
    elif measured_px is not None:
        distance_mm = min(max(focal_px * eyes_mm / measured_px, DISTANCE.low), DISTANCE.high)
        why = f"eyes {measured_px:.0f} px apart"
    else:
        distance_mm, why = SEAT_MM, "assumed until a face is detected"
    reasons = [f"viewer {distance_mm:.0f} mm from the screen ({why})"]
    eye_distance_px = measured_px or focal_px * eyes_mm / distance_mm
    width_mm = picture_mm or PICTURE_MM
    source = "on this monitor" if picture_mm else "assumed: monitor size unknown"
    if screen.width_mm != "auto":
        width_mm, source = float(screen.width_mm), "configured"

    zero_px = zero_plane_px(field, render)
    comfort, limit = _comfort_views(zero_px, field, distance_mm, eyes_mm, width_mm)
    true = _true_views(zero_px, field.geometry, distance_mm, eyes_mm)
    if isinstance(render.alpha_px, str):
        reasons.append(f"picture {width_mm:.0f} mm wide ({source})")
        views, why = _automatic_views(field, render.depth, (comfort, limit), true)
        alpha_px = eye_distance_px / views
    else:
        alpha_px, why = render.alpha_px, "from render.alpha_px"
        views = eye_distance_px / alpha_px
    reasons.append(f"{views:.2f} views between the eyes: {why}")
    if comfort is not None and views > comfort * (1 + 1e-9):
        reasons.append(
            f"beyond the comfort limit of {comfort:.2f} views ({limit}): use render.alpha_px of at"
            f" least {eye_distance_px / comfort:.1f}"
        )
    if zero_px and render.zero_plane_px == "auto":
        reasons.append(
            f"screen at {zero_px:+.2f} px/view: the nearest at the left and right border is in it"
        )
    return Parallax(
        alpha_px=alpha_px,
        views_between_eyes=views,
        comfort_views=comfort,
        true_views=true,
        distance_mm=distance_mm,
        eyes_px=eye_distance_px,
        zero_plane_px=zero_px,
        reasons=tuple(reasons),
    )


def _automatic_views(
    field: LightField, depth: float, comfort: tuple[float | None, str], true: float | None
) -> tuple[float, str]:
    """S from comfort to true depth, or to the whole grid if that is unknown, and the reason."""
    count, axis = (field.cols, "columns") if field.cols > 1 else (field.rows, "rows")
    half = (
        f"half of the {count} {axis}; the other half is room to move"
        if count > 1
        else "the scene has one view"
    )
    limits = [(max(count - 1, 1) / 2, half), (comfort[0] or DEFAULT_VIEWS, comfort[1])]
    if true is not None:
        limits.append((true, "true depth"))
    views, why = min(limits)
    views = max(views, MIN_VIEWS)
    most = max(float(count - 1) if true is None else true, views)
    if not depth or most <= views:
        return views, why
    return (
        views * (most / views) ** depth,
        f"{depth:.0%} of the way to {'the whole grid' if true is None else 'true depth'}",
    )


def _comfort_views(
    zero_px: float, field: LightField, distance_mm: float, eyes_mm: float, width_mm: float
) -> tuple[float | None, str]:
    """The largest S at which everything can be fused, and the limit that decides; None if
    disparities are unknown. A first flow determines their range, before there are maps.
    """
    pitch_mm = width_mm / field.width_px
    behind_mm = (zero_px - field.disparity_min_px) * pitch_mm
    before_mm = (field.disparity_max_px - zero_px) * pitch_mm
    extent_mm = max(abs(behind_mm), abs(before_mm))
    if not extent_mm > 0:
        return None, "disparities unknown"
    limits = [
        (FUSED_RAD * distance_mm / extent_mm, "1 degree between the eyes' images"),
        (
            FUSED_WIDTH * width_mm / extent_mm,
            f"{FUSED_WIDTH:.0%} of the picture's width between the eyes' images",
        ),
    ]
    if behind_mm > 0:
        limits.append((eyes_mm / behind_mm, "the eyes must not diverge"))
    return min(limits)


def _true_views(
    zero_px: float, capture: Geometry, distance_mm: float, eyes_mm: float
) -> float | None:
    """S_true, from baseline over the distance of the zero plane; None if the capture is unknown."""
    if not capture.baseline_mm or not capture.focus_distance_mm:
        return None
    slope = capture.baseline_mm / capture.focus_distance_mm + (
        zero_px / capture.focal_length_px if capture.focal_length_px else 0.0
    )
    return eyes_mm / (slope * distance_mm) if slope > 0 else None
