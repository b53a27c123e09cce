"""Settings as a program gives them: dotted keys and values over the defaults. No file is read."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lfpipe.config import Config, updated


def config_of(settings: Mapping[str, Any] | None) -> Config:
    """The configuration with settings put in. Raises lfpipe.UserError that names all that is wrong."""
    return updated(Config(), settings or {})
