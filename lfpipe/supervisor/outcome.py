"""How a session ended."""

from typing import Any

import attrs

SOURCE_ENDED = "the source has ended"


@attrs.define
class Outcome:
    """reason: in a few words. failure: None for a normal end, else the message for the user. user_error: a restart cannot help
    until the user has changed something. final: the state at the end, from `snapshot`."""

    reason: str
    failure: str | None = None
    remedy: str = ""
    user_error: bool = False
    final: dict[str, Any] = attrs.field(factory=dict)
