"""Settings from a program: dotted keys and values that override the defaults. Reads no file."""

from collections.abc import Mapping
from typing import Any

from lfpipe.config import Config, updated


def config_of(settings: Mapping[str, Any] | None) -> Config:
    """The default configuration with settings applied. Raises lfpipe.UserError that names all errors."""
    return updated(Config(), settings or {})
