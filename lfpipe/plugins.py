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

import attrs

from lfpipe.errors import UserError

LAYOUTS, ENGINES, FILTERS, DISPLAYS = GROUPS = ("lfpipe.layouts", "lfpipe.engines", "lfpipe.filters", "lfpipe.displays")
log = logging.getLogger(__name__)


@attrs.frozen
class Plugin:
    """One entry point. package: the distribution that offers it, with its version."""

    group: str
    name: str
    package: str
    entry: importlib.metadata.EntryPoint

    def load(self) -> Any:
        """The object itself. Raises UserError if its package is broken."""
        try:
            return self.entry.load()
        except Exception as error:  # another package's code may raise anything
            why = f"{self.name} of {self.package} ({self.group}) cannot be loaded: {type(error).__name__}: {error}"
            raise UserError(why, f"repair or uninstall {self.package.partition(' ')[0]}") from None


@functools.cache
def plugins(group: str) -> dict[str, Plugin]:
    """The plugins of a group by name. Imports none of them."""
    entries = importlib.metadata.entry_points(group=group)
    packages = (f"{entry.dist.name} {entry.dist.version}" if entry.dist else "an unknown package" for entry in entries)
    return {entry.name: Plugin(group, entry.name, package, entry) for entry, package in zip(entries, packages, strict=True)}


def load(group: str, name: str) -> Any:
    """The plugin of that name. Raises UserError if there is none, or if it is broken."""
    if name not in plugins(group):
        raise UserError(f"{group}: {name!r} is not installed", "install the package that offers it; `lfpipe doctor` lists them")
    return plugins(group)[name].load()


def loaded(group: str) -> dict[str, Any]:
    """All plugins of a group that work, by name. Others are logged and skipped; `lfpipe doctor` reports them."""
    working = {}
    for name, plugin in plugins(group).items():
        try:
            working[name] = plugin.load()
        except UserError as error:
            log.warning("%s; it is skipped", error.message)
    return working
