"""One frozen tree of typed values from TOML; every error names the key, the value and the remedy.

`tree` defines the keys, `check` validates values and merges their sources, `user_files` reads and writes the user's own.
"""

from lfpipe.config.check import from_dict, load, parse_set, updated
from lfpipe.config.session_options import QualityLevel, ReplayOutput, SceneSummary, SessionOptions
from lfpipe.config.tree import (
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
    to_dict,
    trusted,
)
from lfpipe.config.user_files import user_file

# fmt: off
__all__ = [
    "Camera", "Config", "Governor", "QualityLevel", "Render", "Replay", "ReplayOutput", "Scene", "SceneSummary", "Screen",
    "SessionOptions", "Track", "choices", "from_dict", "load", "options", "parse_set", "to_dict", "trusted", "updated",
    "user_file",
]
