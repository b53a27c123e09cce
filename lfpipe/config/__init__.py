"""One frozen tree of typed values from TOML; every error names the key, the value and the remedy.

`tree` defines the keys; `check` validates values, merges their sources, and writes the user's own.
"""

from lfpipe.config.check import load, parse_set, updated, user_file
from lfpipe.config.session_options import (
    DrawingCosts,
    LiveSource,
    Placement,
    QualityLevel,
    SceneSummary,
    SessionOptions,
    Snapshot,
    converter,
)
from lfpipe.config.tree import (
    FILTER_MODULES,
    Camera,
    Config,
    Governor,
    Render,
    Replay,
    Scene,
    Screen,
    Track,
    choices,
    options,
)

__all__ = [
    "FILTER_MODULES",
    "Camera",
    "Config",
    "DrawingCosts",
    "Governor",
    "LiveSource",
    "Placement",
    "QualityLevel",
    "Render",
    "Replay",
    "Scene",
    "SceneSummary",
    "Screen",
    "SessionOptions",
    "Snapshot",
    "Track",
    "choices",
    "converter",
    "load",
    "options",
    "parse_set",
    "updated",
    "user_file",
]
