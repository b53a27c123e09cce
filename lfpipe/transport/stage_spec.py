"""The data that a stage's process receives at its start."""

import attrs

from lfpipe.config import Config, SessionOptions
from lfpipe.transport.session import Session


@attrs.frozen
class StageSpec:
    """Everything that a stage's process receives at its start, pickled.

    consumers: ring -> stages that read it. others: the other stages of the session. source: the stage that
    makes frames. cpus: cores to run on, none for all.
    nice: niceness, None for the supervisor's.
    """

    name: str
    module: str
    session: Session
    config: Config
    rev: int
    options: SessionOptions
    consumers: dict[str, list[str]]
    others: tuple[str, ...]
    source: str
    cpus: tuple[int, ...] = ()
    nice: int | None = None

    def ring_index(self, name: str) -> int:
        """The index of a ring's credit in a status row."""
        return list(self.consumers).index(name)
