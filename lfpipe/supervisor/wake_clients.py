"""The FIFOs that wake other programs: each ends with the connection of its client."""

from collections.abc import Callable, Collection, Iterator
from functools import partial

from lfpipe.supervisor.control_sockets import Request
from lfpipe.supervisor.effects import Change, Effect, Service
from lfpipe.supervisor.session_state import SessionState


class WakeClients(Service):
    """Removes the FIFOs of clients that are gone. connections: returns the open ones."""

    def __init__(self, connections: Callable[[], Collection[int]]) -> None:
        self._connections = connections
        self._clients: dict[str, int] = {}  # name of a FIFO, as RING.NAME -> connection

    def add(self, name: str, request: Request) -> None:
        """A FIFO of the client of a request."""
        self._clients[name] = request.connection

    def update(self, state: SessionState, t_ns: int) -> Iterator[Effect]:
        gone = [name for name, one in self._clients.items() if one not in self._connections()]
        for name in gone:
            del self._clients[name]
            yield Change(partial(SessionState.without_wake, name=name))

    def close(self) -> None:
        """The files end with the run directory."""
        self._clients.clear()
