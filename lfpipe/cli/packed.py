"""The scene of a command, packed where that is still to be done, while a bar shows how far it is."""

from __future__ import annotations

from pathlib import Path

from lfpipe import config
from lfpipe.cli.progress import progress
from lfpipe.render.scoring import choose_method
from lfpipe.scene.cache import cache_dir
from lfpipe.scene.demo import demo_scene
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.pack import open_scene


def packed(scene: Path | None, settings: config.Scene) -> LightField:
    """The light field; the demo's without a scene. Raises UserError."""
    with progress() as bar:
        found = scene or demo_scene(cache_dir(settings), bar)
        return open_scene(found, settings, bar, choose_method)
