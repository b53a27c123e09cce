"""The only place that stores the state of a session and creates its rings."""

import contextlib
from collections.abc import Mapping

from lfpipe.supervisor.session_state import SessionState
from lfpipe.transport import control, ring
from lfpipe.transport.ring import RingSpec
from lfpipe.transport.segment import Segment
from lfpipe.transport.session import Session


class OnDemandRings:
    """The rings that exist only while a client needs them, as the state of the session says."""

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


class SessionStore:
    """state: the current state."""

    def __init__(self, session: Session, state: SessionState) -> None:
        self.state = state
        self._unsent: bytes | None = None
        self._rings = OnDemandRings(session)

    def begin(self) -> None:
        """Creates the rings of the first state. Raises UserError if memory is short."""
        self._rings.make(self.state.rings())

    def apply(self, state: SessionState) -> None:
        """Stores a state; `take_message` returns a new revision for the stages.

        Raises UserError if memory is short, BadMessage if the stages could not read it; then nothing has changed.
        """
        message = control.encode(state.message()) if state.rev != self.state.rev else self._unsent
        rings = state.rings()
        self._rings.make(rings)
        self.state, self._unsent = state, message
        self._rings.keep(rings)

    def take_message(self) -> bytes | None:
        """The newest state as a message for every stage, once; None if already sent. Of several changes, only the last is
        sent."""
        message, self._unsent = self._unsent, None
        return message

    def close(self) -> None:
        """Removes the rings."""
        self._rings.keep({})
