"""The only place that stores the state of a session and creates its rings."""

from lfpipe.supervisor.on_demand_rings import OnDemandRings
from lfpipe.supervisor.session_state import SessionState
from lfpipe.transport import control
from lfpipe.transport.session import Session


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
