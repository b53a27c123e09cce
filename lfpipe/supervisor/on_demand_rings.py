"""Rings that exist only while a client needs them. The state of the session determines which ones."""

import contextlib
from collections.abc import Mapping

from lfpipe.transport import ring
from lfpipe.transport.ring import RingSpec
from lfpipe.transport.segment import Segment
from lfpipe.transport.session import Session


class OnDemandRings:
    """The segments of these rings. Only the supervisor creates and removes them."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._segments: dict[str, Segment] = {}

    def make(self, wanted: Mapping[str, RingSpec]) -> None:
        """Creates wanted rings that do not exist yet: all, or none and a UserError if memory is short."""
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
        """Removes the rings that are not wanted; existing mappings stay valid."""
        for name in self._segments.keys() - wanted.keys():
            self._remove(name)

    def _remove(self, name: str) -> None:
        memory = self._segments.pop(name)
        with contextlib.suppress(FileNotFoundError):
            memory.unlink()
        memory.close()
