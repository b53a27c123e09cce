"""Alpha from the viewer's distance, the screen and the scene's disparities: how far apart the eyes are on the grid of views.

The eyes are S views apart, `alpha = IPD_px / S`. A scene of baseline b and focus distance F, seen from distance Z by eyes e
apart, is true to nature at `S_true = e F / (b Z)`. Fewer views flatten it by `g = S / S_true`, in stereo and in motion alike, so
the scene stays rigid. The limit of comfort is what the eyes can fuse: on the screen the two images of a point of disparity d are
`S |d - zero plane| pitch` apart, at most 1 degree of visual angle and 3 % of the picture's width.

What the border of a picture cuts off must not stand before the screen: a window violation, which the eyes cannot fuse. The zero
plane `auto` puts the nearest thing at the left and right border into the screen; what is in the middle may come forward.
"""

import math

import attrs

from lfpipe.config import Config, Render, SceneSummary
from lfpipe.config.camera_pose import EYES_MM, camera_focal_px
from lfpipe.errors import UserError
from lfpipe.scene.lightfield import Geometry, LightField

PICTURE_MM = 530.0  # width of a picture that fills a 24 inch screen, used if the monitor size is unknown
SEAT_MM = 600.0  # assumed distance of the viewer until a face is seen
BANK_CARD_MM = 85.60  # ISO/IEC 7810 ID-1
FUSED_RAD = math.radians(1.0)
FUSED_WIDTH = 0.03
DEFAULT_VIEWS = 4.0  # between the eyes, if the disparities are unknown
LEAST_VIEWS = 1e-3
LEAST_EYES_PX = 0.5  # eyes closer together than this are not a face's


@attrs.frozen
class Parallax:
    """The chosen alpha and the reason; `str()` gives the lines that `lfpipe up` prints.

    alpha_px: camera px per view. views_between_eyes: S. compression: g, None if the capture's geometry is unknown. comfort_views,
    true_views: the largest comfortable S and the S of nature, None if unknown. exceeds_comfort: S > comfort_views.
    zero_plane_px: the disparity in the plane of the screen that S was chosen for.
    """

    alpha_px: float
    views_between_eyes: float
    compression: float | None
    comfort_views: float | None
    true_views: float | None
    exceeds_comfort: bool
    distance_mm: float
    eyes_px: float
    reasons: tuple[str, ...]
    zero_plane_px: float = 0.0

    def differs_from(self, other: "Parallax") -> bool:
        """Whether a person should be informed: another number of views between the eyes, or a distance changed by 15 %."""
        views = abs(self.views_between_eyes - other.views_between_eyes) > 0.005
        return views or abs(self.alpha_px / other.alpha_px - 1) > 0.15 or self.exceeds_comfort != other.exceeds_comfort

    def __str__(self) -> str:
        depth = "unknown (no baseline or focus distance)" if self.compression is None else f"{self.compression:.2f} of true depth"
        lines = [f"alpha {self.alpha_px:.2f} px/view, {self.views_between_eyes:.2f} views between the eyes, depth {depth}"]
        return "\n".join(lines + [f"  {reason}" for reason in self.reasons])


def alpha_is_automatic(config: Config) -> bool:
    """Whether alpha is computed from the viewer's distance, instead of given."""
    return isinstance(config.render.alpha_px, str)


def focal_px_from(size_px: float, size_mm: float, distance_mm: float) -> float:
    """Focal length in px from an object of known size at a known distance: eyes (EYES_MM) or a bank card (BANK_CARD_MM).

    Raises UserError unless all three are positive.
    """
    if not all(math.isfinite(value) and value > 0 for value in (size_px, size_mm, distance_mm)):
        raise UserError(
            f"no focal length from {size_px:g} px, {size_mm:g} mm at {distance_mm:g} mm", "all three must be positive numbers"
        )
    return size_px * distance_mm / size_mm


def picture_mm(config: Config, shown_mm: float | None) -> float:
    """Width of the picture on the screen: as configured, as the display reports (shown_mm), or PICTURE_MM."""
    return float(config.screen.width_mm) if config.screen.width_mm != "auto" else shown_mm or PICTURE_MM


def parallax(
    config: Config,
    field: LightField,
    frame_width_px: int,
    eyes_px: float | None,
    eyes_mm: float | None = None,
    shown_mm: float | None = None,
) -> Parallax:
    """Chooses alpha.

    frame_width_px: of the camera picture. eyes_px: distance between the eyes in it; None, or a value no face has, before a face
    is seen. eyes_mm: the viewer's own distance between the eyes if it was learnt, else EYES_MM. shown_mm: `Display.width_mm`.
    Raises UserError for alpha_px = "true" and a scene whose capture is unknown.
    """
    focal_px = camera_focal_px(config, frame_width_px)
    seen = eyes_px if eyes_px is not None and LEAST_EYES_PX <= eyes_px <= frame_width_px else None
    reasons: list[str] = []
    if eyes_mm is None:
        eyes_mm = EYES_MM
    else:
        reasons.append(f"eyes {eyes_mm:.0f} mm apart, learnt from the iris")
    if config.screen.distance_mm != "auto":
        distance_mm = float(config.screen.distance_mm)
        reasons.append(f"viewer {distance_mm:.0f} mm from the screen (configured)")
    elif seen is not None:
        distance_mm = min(max(focal_px * eyes_mm / seen, 50.0), 50000.0)
        reasons.append(f"viewer {distance_mm:.0f} mm from the screen (eyes {seen:.0f} px apart)")
    else:
        distance_mm = SEAT_MM
        reasons.append(f"assuming a viewer {distance_mm:.0f} mm from the screen until a face is detected")
    eyes = seen if seen is not None else focal_px * eyes_mm / distance_mm

    width_mm = picture_mm(config, shown_mm)
    zero_px = zero_plane_px(field, config.render)
    comfort, why = _comfort_views(zero_px, field, distance_mm, eyes_mm, width_mm)
    slope = _slope(zero_px, field.geometry)
    true = None if slope is None else eyes_mm / (slope * distance_mm)
    count, axis = (field.cols, "columns") if field.cols > 1 else (field.rows, "rows")
    room = max(count - 1, 1) / 2
    if config.render.alpha_px == "true":
        if true is None:
            raise _unknown_capture(field.name)
        views = true
        reasons.append(f"{views:.2f} views between the eyes give true depth")
    elif config.render.alpha_px == "auto":
        if config.screen.width_mm == "auto":
            known = f"picture {width_mm:.0f} mm wide on this monitor"
            reasons.append(known if shown_mm else f"assuming a picture {width_mm:.0f} mm wide (monitor size unknown)")
        half = f"half of the {count} {axis}; the other half is room to move" if count > 1 else "the scene has one view"
        limits = [(room, half)]
        if comfort is None:
            limits.append((DEFAULT_VIEWS, "disparities unknown"))
        else:
            limits.append((comfort, why))
        if true is not None:
            limits.append((true, "true depth"))
        views, reason = min(limits)
        views = max(views, LEAST_VIEWS)
        most = max(true if true is not None else float(count - 1), views)
        if config.render.depth and most > views:
            views *= (most / views) ** config.render.depth
            reason = f"{config.render.depth:.0%} of the way to {'true depth' if true is not None else 'the whole grid'}"
        reasons.append(f"{views:.2f} views between the eyes: {reason}")
    else:
        views = eyes / float(config.render.alpha_px)
        reasons.append(f"{views:.2f} views between the eyes, from render.alpha_px")
    exceeds = comfort is not None and views > comfort * (1 + 1e-9)
    if exceeds and comfort is not None:
        best = eyes / comfort
        reasons.append(f"beyond the comfort limit of {comfort:.2f} views ({why}): use render.alpha_px of at least {best:.1f}")
    near_px = field.disparity_max_px  # with this zero plane the edge of the screen cuts off nothing in front of it
    if isinstance(config.render.zero_plane_px, str):
        if zero_px:
            reasons.append(f"screen at {zero_px:+.2f} px/view: the nearest at the left and right border is in it")
    elif near_px > zero_px:
        reasons.append(f"near objects are in front of the screen; render.zero_plane_px={near_px:.2f} puts everything behind it")
    return Parallax(
        alpha_px=eyes / views if isinstance(config.render.alpha_px, str) else config.render.alpha_px,
        views_between_eyes=views,
        compression=None if true is None else views / true,
        comfort_views=comfort,
        true_views=true,
        exceeds_comfort=exceeds,
        distance_mm=distance_mm,
        eyes_px=eyes,
        reasons=tuple(reasons),
        zero_plane_px=zero_px,
    )


def _comfort_views(
    zero: float, field: LightField, distance_mm: float, eyes_mm: float, width_mm: float
) -> tuple[float | None, str]:
    """The most views between the eyes at which everything can be fused, and the limit that decides; None if disparities are
    unknown.
    """
    pitch_mm = width_mm / field.width_px
    extent_mm = max(abs(field.disparity_max_px - zero), abs(field.disparity_min_px - zero)) * pitch_mm
    if field.disparity_source == "none" or not extent_mm > 0:
        return None, "disparities unknown"
    behind_mm = max(zero - field.disparity_min_px, 0.0) * pitch_mm
    limits = [
        (FUSED_RAD * distance_mm / extent_mm, "1 degree between the eyes' images"),
        (FUSED_WIDTH * width_mm / extent_mm, f"{FUSED_WIDTH:.0%} of the picture's width between the eyes' images"),
    ]
    if behind_mm > 0:
        limits.append((eyes_mm / behind_mm, "the eyes must not diverge"))
    return min(limits)


def _slope(zero_px: float, known: Geometry | SceneSummary) -> float | None:
    """Baseline over the distance of the zero plane; None if the capture is unknown."""
    if not known.baseline_mm or not known.focus_distance_mm:
        return None
    slope = known.baseline_mm / known.focus_distance_mm
    if known.focal_length_px:
        slope += zero_px / known.focal_length_px
    return slope if slope > 0 else None


def check_geometry(config: Config, scene: SceneSummary) -> None:
    """Raises UserError if config cannot show the scene: render.alpha_px = "true" needs a known capture."""
    plane = config.render.zero_plane_px  # auto lies within the scene, which is before the cameras
    zero_px = 0.0 if isinstance(plane, str) else plane
    if config.render.alpha_px == "true" and scene.needs_tracking and _slope(zero_px, scene) is None:
        raise _unknown_capture(scene.name)


def _unknown_capture(name: str) -> UserError:
    return UserError(
        f'render.alpha_px = "true": the baseline and focus distance of {name or "this scene"} are not known',
        'use render.alpha_px = "auto", or a number',
    )


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
