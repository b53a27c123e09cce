"""A reader's view of a running session: attaches to its status table, untracked and read-only, and leaves no trace."""

from __future__ import annotations

import json
from types import TracebackType
from typing import Any, Self

from lfpipe.errors import UserError
from lfpipe.observe.snapshot import snapshot
from lfpipe.transport.session import Session
from lfpipe.transport.status import Table


class Watch:
    """One attachment. Raises UserError when the session ends while it is being opened."""

    def __init__(self, session: Session) -> None:
        self._session = session
        try:
            self._started_ns = int(json.loads((session.run_dir / "session.json").read_text())["started_ns"])
            self._table = Table(session.segment("status"))
        except (FileNotFoundError, ValueError):
            raise UserError(f"session {session.name!r} is starting or ending", "try again in a second") from None

    def read(self) -> dict[str, Any]:
        """The state now, see `snapshot`."""
        return snapshot(self._session.name, self._table, self._started_ns)

    def living(self) -> bool:
        """Whether the session is still the one that was attached to."""
        return (self._session.run_dir / "session.json").exists()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._table.close()
