"""Notices that nobody has looked, or moved the mouse, for a while, so that stages work less."""

from collections.abc import Iterator
from functools import partial

from lfpipe.config.modes import Lossless
from lfpipe.supervisor.effects import Change, Effect, Service
from lfpipe.supervisor.process_table import SHOWN_BY, TRACKED_BY
from lfpipe.supervisor.session_state import SessionState
from lfpipe.transport.clock import SECOND_NS
from lfpipe.transport.status import Row, Table

IDLE_NS = 10 * SECOND_NS  # longer than a viewer turns away or leans out


class IdleWatch(Service):
    """Sets and clears `SessionOptions.idle`."""

    def __init__(self, table: Table) -> None:
        self._track, self._render = (
            Row(table.rows[stage], table.metrics[stage]) for stage in (TRACKED_BY, SHOWN_BY)
        )
        self._active_ns = 0

    def update(self, state: SessionState, t_ns: int) -> Iterator[Effect]:
        options = state.options
        looks = self._track["face"] if options.viewer.tracked else not self._render["resting"]
        must_not_rest = options.record or isinstance(options.clock, Lossless)
        if looks or must_not_rest or state.paused or not self._active_ns:
            self._active_ns = t_ns
        idle = t_ns - self._active_ns > IDLE_NS
        if idle != options.idle:
            yield Change(partial(SessionState.changed, idle=idle))
