"""The one place that stores the state of a session, makes the rings it asks for, and broadcasts it to the stages."""

from __future__ import annotations

from collections.abc import Callable

from lfpipe.supervisor.on_demand_rings import OnDemandRings
from lfpipe.supervisor.session_state import SessionState
from lfpipe.transport import control
from lfpipe.transport.session import Session


class SessionStore:
    """state: what the session works by. broadcast: sends an encoded message to every stage."""

    def __init__(self, session: Session, state: SessionState, broadcast: Callable[[bytes], None]) -> None:
        self.state, self.broadcast = state, broadcast
        self._unsent: bytes | None = None
        self._rings = OnDemandRings(session)

    def begin(self) -> None:
        """Makes the rings of the first state. Raises UserError where memory is short."""
        self._rings.make(self.state.rings())

    def apply(self, state: SessionState) -> None:
        """Stores a state; a new revision is broadcast by `flush`.

        Raises UserError where memory is short, BadMessage where the stages could not read it; then nothing has changed.
        """
        message = control.encode(state.message()) if state.rev != self.state.rev else self._unsent
        rings = state.rings()
        self._rings.make(rings)
        self.state, self._unsent = state, message
        self._rings.keep(rings)

    def flush(self) -> None:
        """Broadcasts the newest state where it is new: of many changes at once, the stages hear the last."""
        message, self._unsent = self._unsent, None
        if message is not None:
            self.broadcast(message)

    def close(self) -> None:
        """Removes the rings."""
        self._rings.keep({})
