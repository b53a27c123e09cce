"""One frozen tree of typed values from TOML; every error names the key, the value and the remedy.

`tree` defines the keys, `keys` lists them, `check` validates values, `layers` merges sources, `text` writes them for people.
"""

from lfpipe.config.check import from_dict, updated
from lfpipe.config.keys import choices, options
from lfpipe.config.layers import load, parse_set, user_file
from lfpipe.config.session_options import QualityLevel, ReplayOutput, SceneSummary, SessionOptions
from lfpipe.config.tree import (
    Camera,
    Config,
    Governor,
    Opt,
    Render,
    Replay,
    Scene,
    Screen,
    Track,
    to_dict,
    trusted,
)

__all__ = [
    "Camera",
    "Config",
    "Governor",
    "Opt",
    "QualityLevel",
    "Render",
    "Replay",
    "ReplayOutput",
    "Scene",
    "SceneSummary",
    "Screen",
    "SessionOptions",
    "Track",
    "choices",
    "from_dict",
    "load",
    "options",
    "parse_set",
    "to_dict",
    "trusted",
    "updated",
    "user_file",
]
