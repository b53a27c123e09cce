"""The lease of the ring of pictures."""

from collections.abc import Iterator

from lfpipe.supervisor.effects import Change, Effect, Service
from lfpipe.supervisor.session_state import SessionState


class PictureLease(Service):
    """Removes the ring when its lease expires."""

    def update(self, state: SessionState, t_ns: int) -> Iterator[Effect]:
        if state.options.pictures and t_ns > state.pictures_until_ns:
            yield Change(SessionState.without_pictures)
