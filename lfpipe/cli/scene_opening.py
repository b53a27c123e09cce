"""Opens the scene of a command. Packs it first if necessary, with a progress bar."""

from pathlib import Path
from typing import Any

from lfpipe import config
from lfpipe.cli.progress import progress
from lfpipe.scene.cache import cache_dir
from lfpipe.scene.demo import demo_scene
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.pack import open_scene


def open_with_progress(scene: Path | None, settings: config.Scene) -> LightField:
    """The light field at scene, or the demo. Raises UserError."""
    with progress() as bar:
        found = scene or demo_scene(cache_dir(settings), bar)
        return open_scene(found, settings, bar, _choose)


def _choose(field: LightField) -> tuple[str, dict[str, Any]]:
    from lfpipe.render.scoring import choose_method  # slow import, needed only if the scene is packed now

    return choose_method(field)
