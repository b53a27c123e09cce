"""The ring "pictures": lent to whoever wants to see the output, taken back when nobody renews; nobody asking means no ring."""

from __future__ import annotations

import contextlib
from multiprocessing.shared_memory import SharedMemory

from lfpipe.transport import ring
from lfpipe.transport.clock import now_ns
from lfpipe.transport.ring import RingSpec
from lfpipe.transport.session import Session


class PictureLoan:
    """At most one ring at a time. A viewer that is killed simply stops to renew, so nothing is left behind."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._memory: SharedMemory | None = None
        self._spec: RingSpec | None = None
        self._until_ns = 0
        self._count = 0
        self.part = ""  # name of the ring, "" where none is lent; never used twice, so that no reader maps an old one

    def renew(self, spec: RingSpec, lease_s: float) -> bool:
        """Lends a ring of that spec for lease_s from now; True where it is a new one. Raises UserError where memory is short."""
        self._until_ns = max(self._until_ns, now_ns() + int(lease_s * 1e9))
        if spec == self._spec:
            return False
        self.end()
        part = f"pictures.{self._count + 1}"
        self._memory, self._spec, self.part = ring.create(self._session.segment(part), spec), spec, part
        self._count += 1
        return True

    def overdue(self) -> bool:
        """Whether a ring is lent that nobody has asked for lately."""
        return self._memory is not None and now_ns() > self._until_ns

    def end(self) -> None:
        """Takes the ring away; who still maps it keeps what it maps."""
        memory, self._memory, self._spec, self.part = self._memory, None, None, ""
        if memory is not None:
            with contextlib.suppress(FileNotFoundError):
                memory.unlink()
            memory.close()
