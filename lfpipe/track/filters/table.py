"""Makes the filter that the configuration names."""

import importlib

from lfpipe.config import FILTER_MODULES, Track
from lfpipe.plugins import FILTERS, make
from lfpipe.track.filters.base import EyeFilter


def make_filter(track: Track, device_latency_s: float = 0.0) -> EyeFilter:
    """A new filter of the name in track: a built-in one, or a plug-in.

    device_latency_s: delay of camera and display that predictions must cover.
    """
    if (module := FILTER_MODULES.get(track.filter)) is not None:
        maker = importlib.import_module(f"{__package__}.{module}").make
        built_in: EyeFilter = maker(track, device_latency_s)
        return built_in
    plugin: EyeFilter = make(FILTERS, track.filter, track, device_latency_s)
    return plugin
