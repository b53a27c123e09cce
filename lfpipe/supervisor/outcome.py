"""How a session ended."""

from __future__ import annotations

from typing import Any

import attrs


@attrs.define
class Outcome:
    """reason: in a few words. failure: None when it ended as it should, else what a person must know."""

    reason: str
    failure: str | None = None
    remedy: str = ""
    user_error: bool = False
    final: dict[str, Any] = attrs.field(factory=dict)  # the state at the end, as `snapshot` gives it
