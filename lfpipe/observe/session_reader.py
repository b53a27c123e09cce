"""Reads a running session: attaches to its status table untracked and read-only, without side effects."""

import json
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.observe.meter import Meter, Reading
from lfpipe.supervisor.rundir import find
from lfpipe.supervisor.snapshot import snapshot
from lfpipe.transport.segment import WrongSegment
from lfpipe.transport.session import Session
from lfpipe.transport.status import Table


class Watch:
    """One attachment. Raises UserError if the session ends meanwhile, or if its table has another version."""

    def __init__(self, session: Session) -> None:
        self.session = session
        try:
            self._about = session.run_dir / "session.json"
            self._mark = self._marked()
            about = json.loads(self._about.read_text())
            self._table = Table(session.segment("status"))
            self._started_ns = int(about["started_ns"])
        except WrongSegment:
            raise
        except (FileNotFoundError, ValueError):
            raise UserError(f"session {session.name!r} is starting or ending", "try again in a second") from None
        self.meter = Meter(self._table, self._started_ns, int(about["pid"]))

    @property
    def rows(self) -> dict[str, NDArray[np.void]]:
        """The status table itself: name of a stage -> record of dtype ROW."""
        return self._table.rows

    def read(self) -> dict[str, Any]:
        """The current state, see `snapshot`."""
        return snapshot(self.session.name, self._table, self._started_ns)

    def living(self) -> bool:
        """Whether the session is still the one that was attached to."""
        try:
            return self._marked() == self._mark
        except FileNotFoundError:
            return False

    def _marked(self) -> tuple[int, int]:
        found = self._about.stat()
        return found.st_ino, found.st_mtime_ns

    def close(self) -> None:
        """Releases the table."""
        self._table.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


class FollowingReader:
    """A watch that outlives its session: it detaches when the session ends and attaches to the next one of the same name."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.watch: Watch | None = None

    def read(self) -> Reading | None:
        """The current session, or None."""
        if self.watch is not None and not self.watch.living():
            self.close()
        if self.watch is None:
            try:
                self.watch = Watch(find(self.name))
            except UserError:
                return None
        return self.watch.meter.read()

    def close(self) -> None:
        """Detaches."""
        if self.watch is not None:
            self.watch.close()
            self.watch = None
