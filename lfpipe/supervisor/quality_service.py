"""Adapts the quality of a session to the load of its stages."""

import logging
from collections.abc import Iterator, Mapping

from lfpipe.supervisor.effects import Change, Effect, Notify, Publish, Service
from lfpipe.supervisor.governor import QualityControl
from lfpipe.supervisor.session_state import SessionState
from lfpipe.transport.status import Table

logger = logging.getLogger(__name__)
REDUCED = "CPU overloaded: picture quality reduced (`lfpipe monitor` shows how and why)"


class Quality(Service):
    """Changes the level of quality. cores: see `QualityControl`."""

    def __init__(self, table: Table, cores: Mapping[str, tuple[int, ...]]) -> None:
        self._table = table
        self._control = QualityControl(cores)
        self._notified = False

    def update(self, state: SessionState, t_ns: int) -> Iterator[Effect]:
        if state.idle:
            return  # with little to do, the stages say nothing about the load
        lowest = len(state.levels) - 1
        level = state.level
        step = self._control.sample(state, self._table.rows, t_ns)
        if step is not None:
            number = step.level
            yield Change(lambda now: now.with_level(number))
            level = state.levels[number]
            logger.info(
                "quality level %d of %d, %s: %s", level.number, lowest, level.words, step.reason
            )
            yield Publish(
                "level",
                {
                    "level": level.number,
                    "lowest": lowest,
                    "words": level.words,
                    "stage": step.stage,
                    "why": step.reason,
                },
            )
        row = self._table.session  # for monitors
        row["level"] = level.number
        row["lowest"] = lowest
        row["words"] = level.words.encode()
        if step is not None and level.number and not self._notified:
            self._notified = True
            yield Notify(REDUCED)
