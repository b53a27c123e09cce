"""Parts from other packages, by entry points: layouts, face engines, filters and displays. docs/extending.md describes each.

lfpipe.layouts    a module or object with NAME, detect and describe (`lfpipe.scene.layouts.Layout`)
lfpipe.engines    a function of `config.Track` that returns a `lfpipe.track.engine.Engine`; a value of track.engine
lfpipe.filters    a function of `config.Track` and loop_s that returns a `lfpipe.track.smoothing.EyeFilter`; of track.filter
lfpipe.displays   a function of (argument, size_px, title, rate_hz) that returns a `lfpipe.render.display.Display`; `--display
                  NAME[:ARGUMENT]`
"""

import functools
import importlib.metadata
import logging
from typing import Any

from lfpipe.errors import UserError

LAYOUTS, ENGINES, FILTERS, DISPLAYS = GROUPS = (
    "lfpipe.layouts",
    "lfpipe.engines",
    "lfpipe.filters",
    "lfpipe.displays",
)
log = logging.getLogger(__name__)


@functools.cache
def plugins(group: str) -> dict[str, str]:
    """The package of each plugin of a group, with its version, by the plugin's name. Imports none of them."""
    entries = importlib.metadata.entry_points(group=group)
    return {
        entry.name: f"{entry.dist.name} {entry.dist.version}"
        if entry.dist
        else "an unknown package"
        for entry in entries
    }


def load(group: str, name: str) -> Any:
    """The plugin of that name. Raises UserError if there is none, or if its package is broken."""
    if name not in plugins(group):
        raise UserError(
            f"{group}: {name!r} is not installed",
            "install the package that offers it; `lfpipe doctor` lists them",
        )
    try:
        return importlib.metadata.entry_points(group=group)[name].load()
    except Exception as error:  # another package's code may raise anything
        package = plugins(group)[name]
        why = f"{name} of {package} ({group}) cannot be loaded: {type(error).__name__}: {error}"
        raise UserError(why, f"repair or uninstall {package.partition(' ')[0]}") from None


def loaded(group: str) -> dict[str, Any]:
    """All plugins of a group that work, by name. Others are logged and skipped; `lfpipe doctor` reports them."""
    working = {}
    for name in plugins(group):
        try:
            working[name] = load(group, name)
        except UserError as error:
            log.warning("%s; it is skipped", error.message)
    return working
