"""The summary of a scene for a session, so that only render opens the pack."""

from lfpipe import config
from lfpipe.config import SceneSummary
from lfpipe.scene.cache import cache_dir
from lfpipe.scene.lightfield import LightField


def summarize(field: LightField, settings: config.Scene) -> SceneSummary:
    """The summary of an opened pack of the cache that settings name."""
    known = field.geometry
    return SceneSummary(
        pack=str(cache_dir(settings) / "scenes" / str(field.manifest["key"])),
        name=field.name,
        rows=field.rows,
        cols=field.cols,
        height_px=field.height_px,
        width_px=field.width_px,
        method=field.method,
        has_disparity=field.disparity is not None,
        scores={name: float(score) for name, score in field.manifest.get("scores", {}).items()},
        baseline_mm=known.baseline_mm,
        focus_distance_mm=known.focus_distance_mm,
        focal_length_px=known.focal_length_px,
        disparity_min_px=float(field.disparity_min_px),
        disparity_max_px=float(field.disparity_max_px),
        half_turned=field.half_turned,
    )
