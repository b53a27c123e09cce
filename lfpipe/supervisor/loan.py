"""Rings that exist only while somebody asks for them: "pictures", lent to whoever wants to see the output and taken back when
nobody renews, and "packets", the camera's own JPEGs for a recorder.
"""

from __future__ import annotations

import contextlib
from typing import Any

from lfpipe.config import Config
from lfpipe.supervisor.table import packet_ring
from lfpipe.transport import ring
from lfpipe.transport.clock import now_ns
from lfpipe.transport.ring import RingSpec
from lfpipe.transport.segment import Segment
from lfpipe.transport.session import Session


class RingLoan:
    """At most one ring at a time."""

    def __init__(self, session: Session, name: str) -> None:
        self._session, self._name = session, name
        self._memory: Segment | None = None
        self._spec: RingSpec | None = None
        self._count = 0
        self.part = ""  # name of the ring, "" where none is lent; never used twice, so that no reader maps an old one

    def lend(self, spec: RingSpec) -> bool:
        """Lends a ring of that spec; True where it is a new one. Raises UserError where memory is short."""
        if spec == self._spec:
            return False
        self.end()
        part = f"{self._name}.{self._count + 1}"
        self._memory = ring.create(self._session.segment(part), spec, self._session.run_dir)
        self._spec, self.part = spec, part
        self._count += 1
        return True

    @property
    def lent(self) -> bool:
        """Whether a ring is out."""
        return self._memory is not None

    def end(self) -> None:
        """Takes the ring away; who still maps it keeps what it maps."""
        memory, self._memory, self._spec, self.part = self._memory, None, None, ""
        if memory is not None:
            with contextlib.suppress(FileNotFoundError):
                memory.unlink()
            memory.close()


class PictureLoan(RingLoan):
    """For a time. A viewer that is killed simply stops to renew, so nothing is left behind."""

    def __init__(self, session: Session) -> None:
        super().__init__(session, "pictures")
        self._until_ns = 0

    def renew(self, spec: RingSpec, lease_s: float) -> bool:
        """Lends a ring of that spec for lease_s from now; True where it is a new one. Raises UserError where memory is short."""
        self._until_ns = max(self._until_ns, now_ns() + int(lease_s * 1e9))
        return self.lend(spec)

    def overdue(self) -> bool:
        """Whether a ring is lent that nobody has asked for lately."""
        return self.lent and now_ns() > self._until_ns


class PacketLoan(RingLoan):
    """For as long as the session records a source that delivers JPEGs."""

    def __init__(self, session: Session) -> None:
        super().__init__(session, "packets")

    def follow(self, config: Config, options: dict[str, Any]) -> dict[str, Any]:
        """Lends or ends as options ask; returns them with the ring's name as "packets".

        Raises UserError where memory is short.
        """
        if options.get("record") and options.get("jpeg_px"):
            self.lend(packet_ring(config, options["jpeg_px"]))
        else:
            self.end()
        return {**options, "packets": self.part}
