"""Whether a configuration and a scene go together, asked before a session takes either."""

from __future__ import annotations

from pathlib import Path

from lfpipe.config import Config
from lfpipe.render.geometry import parallax
from lfpipe.scene.store import open_pack


def check_together(config: Config, pack: Path) -> None:
    """Raises UserError where the packed scene cannot be shown by config, or the pack is gone."""
    field = open_pack(pack)
    if field.rows * field.cols > 1:  # one view needs no parallax
        parallax(config, field, config.camera.width_px, None)
