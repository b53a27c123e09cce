"""How a session ended."""

from __future__ import annotations

import attrs


@attrs.define
class Outcome:
    """reason: in a few words. failure: None when it ended as it should, else what a person must know."""

    reason: str
    failure: str | None = None
    remedy: str = ""
    user_error: bool = False
