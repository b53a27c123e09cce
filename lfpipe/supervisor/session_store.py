"""The one place that stores the state of a session and makes the rings it asks for."""

from __future__ import annotations

from lfpipe.supervisor.on_demand_rings import OnDemandRings
from lfpipe.supervisor.session_state import SessionState
from lfpipe.transport import control
from lfpipe.transport.session import Session


class SessionStore:
    """state: what the session works by."""

    def __init__(self, session: Session, state: SessionState) -> None:
        self.state = state
        self._unsent: bytes | None = None
        self._rings = OnDemandRings(session)

    def begin(self) -> None:
        """Makes the rings of the first state. Raises UserError where memory is short."""
        self._rings.make(self.state.rings())

    def apply(self, state: SessionState) -> None:
        """Stores a state; a new revision is for the stages, see `take_message`.

        Raises UserError where memory is short, BadMessage where the stages could not read it; then nothing has changed.
        """
        message = control.encode(state.message()) if state.rev != self.state.rev else self._unsent
        rings = state.rings()
        self._rings.make(rings)
        self.state, self._unsent = state, message
        self._rings.keep(rings)

    def take_message(self) -> bytes | None:
        """The newest state as a message for every stage, once; None where they have it. Of many changes they hear the last."""
        message, self._unsent = self._unsent, None
        return message

    def close(self) -> None:
        """Removes the rings."""
        self._rings.keep({})
