"""Classifies a scene by its measurements; all thresholds are here.

Before packing, a few small views (`plausibility`) show whether the pictures are a light field.
Afterwards, held-out views of the pack (`render.synthesis.scoring`) select the rendering method.
"""

import enum
from collections.abc import Mapping, Sequence
from typing import Self

import attrs
import numpy as np

from lfpipe.config.quality import METHODS

# Pictures are refused if views are poorly predicted from two neighbours and no disparity explains
# the flow (it must be equal to both neighbours, along the line of cameras), or if they change in
# focus or size, which a camera that moves sideways does not cause. The thresholds separate 211
# disturbed and drawn light fields (at least 0.38 explained and 30 dB, or 0.64 and 24 dB) from 40
# synthetic sets of other pictures (focus stacks with and without breathing, refocused pictures,
# walks around a box, portraits, clips, zooms, turns, exposures), of which 37 are refused.
POOR_DB = 26.0  # of views predicted from two others
EXPLAINED = 0.6  # share of their detail that one disparity explains
UNEXPLAINED = 0.15  # share below which they do not fit together, whatever their quality
# Enough for the middle of all lines to skip other views.
FINE_DB = 30.0
FINE_SHARE = 0.7
NOTHING_PX = 0.3  # between the farthest views: less motion counts as none
WORTH_DB = 0.25  # minimum gain of a costlier method: a smaller one is invisible
WARPED_PX = 0.5  # minimum disparity to warp if no view can be held out
BLEND_PX = 2.0  # maximum disparity at which a cross-fade shows hardly any double edges


class SceneKind(enum.Enum):
    """The kind of a set of pictures."""

    LIGHT_FIELD = enum.auto()
    ONE_VIEW = enum.auto()  # nothing moves between the pictures
    TOO_FAR_APART = enum.auto()  # no intermediate views can be rendered
    NOT_A_LIGHT_FIELD = enum.auto()


@attrs.frozen
class Classification:
    """The kind of a scene's pictures, and the reason."""

    kind: SceneKind
    reason: str = ""  # for people; "" for a light field


@attrs.frozen(kw_only=True)
class Measurements:
    """Measurements of a few small views of a scene."""

    held_out_db: float  # PSNR of views predicted from two neighbours, median
    explained: float  # share of textured pixels whose flow one disparity explains
    change: str = ""  # any change that a camera moving sideways does not cause
    moved_px: float = np.inf  # motion between the farthest views, of nearly all of their detail
    # motion between two views that flow misses, in shares of the width
    missed_motion: tuple[float, float] | None = None

    @classmethod
    def median(cls, samples: Sequence[Self], **more: object) -> Self:
        """The medians of some samples."""
        return cls(
            held_out_db=float(np.median([sample.held_out_db for sample in samples])),
            explained=float(np.median([sample.explained for sample in samples])),
            **more,  # type: ignore[arg-type]
        )

    @property
    def fine(self) -> bool:
        """Whether other views need no analysis."""
        return self.held_out_db >= FINE_DB and self.explained >= FINE_SHARE

    @property
    def classification(self) -> Classification:
        """The classification that follows from these measurements."""
        poor = self.held_out_db < POOR_DB
        unexplained = self.explained < UNEXPLAINED
        if self.change and not (poor and unexplained):
            return Classification(
                SceneKind.NOT_A_LIGHT_FIELD,
                f"the pictures do not fit together as a light field: {self.change}",
            )
        if self.missed_motion is None and (unexplained or (poor and self.explained < EXPLAINED)):
            return Classification(
                SceneKind.NOT_A_LIGHT_FIELD,
                "these are different pictures, not one scene from several places",
            )
        if self.moved_px < NOTHING_PX and self.held_out_db > POOR_DB:
            return Classification(
                SceneKind.ONE_VIEW, "nothing moves between these pictures: one of them is shown"
            )
        if self.missed_motion is not None:
            share = max(map(abs, self.missed_motion))
            return Classification(
                SceneKind.TOO_FAR_APART,
                f"the views are too far apart ({share:.0%} of the width): no views are"
                " made between them",
            )
        return Classification(SceneKind.LIGHT_FIELD)


def best_method(scores: Mapping[str, float], reach_px: float, has_disparity: bool) -> str:
    """The method that `auto` selects for a scene of several views.

    scores: PSNR in dB of held-out views by method. Selects the cheapest method that no costlier
    one beats by WORTH_DB. Without scores, the largest disparity, reach_px, decides.
    """
    if scores:
        enough_db = max(scores.values()) - WORTH_DB
        cheapest_first = reversed(METHODS)
        return next(name for name in cheapest_first if scores.get(name, -np.inf) >= enough_db)
    if has_disparity and reach_px >= WARPED_PX:
        return "warp2"
    return "blend" if reach_px <= BLEND_PX else "nearest"
