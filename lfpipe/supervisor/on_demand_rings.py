"""Rings that exist only while somebody asks for them; which ones follows from the state of the session."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping

from lfpipe.transport import ring
from lfpipe.transport.ring import RingSpec
from lfpipe.transport.segment import Segment
from lfpipe.transport.session import Session


class OnDemandRings:
    """The segments of these rings, made and removed by the supervisor alone."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._segments: dict[str, Segment] = {}

    def make(self, wanted: Mapping[str, RingSpec]) -> None:
        """Makes the rings that are wanted and missing. Raises UserError, and leaves none of them, where memory is short."""
        made: list[str] = []
        try:
            for name in wanted.keys() - self._segments.keys():
                self._segments[name] = ring.create(self._session.segment(name), wanted[name], self._session.run_dir)
                made.append(name)
        except Exception:
            for name in made:
                self._remove(name)
            raise

    def keep(self, wanted: Mapping[str, RingSpec]) -> None:
        """Removes the rings that are not wanted; a process that maps one keeps what it maps."""
        for name in self._segments.keys() - wanted.keys():
            self._remove(name)

    def _remove(self, name: str) -> None:
        memory = self._segments.pop(name)
        with contextlib.suppress(FileNotFoundError):
            memory.unlink()
        memory.close()
