"""A stage in a test's own process: its context is real, with rings, table and wakes, but its waits
are steps of the test, and what it says is kept.
"""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import attrs
import pytest

from lfpipe.config import Config, SessionOptions
from lfpipe.supervisor.process_table import SOURCE, consumers
from lfpipe.supervisor.session_state import SessionState, SessionStore
from lfpipe.transport import control
from lfpipe.transport.context import Context, StageSpec
from lfpipe.transport.control import Session

Step = Callable[[], object]


class Recorded(Context):
    """Ends after the last step, or by a clock, which gets the time until which to wait.

    emitted: what the tap would hear; asked: requests and answers.
    """

    def __init__(self, spec: StageSpec) -> None:
        super().__init__(spec)
        self.steps: list[Step] = []
        self.clock: Callable[[int], bool] | None = None
        self.emitted: list[control.Message] = []
        self.asked: list[control.Message] = []

    def wait(
        self, until_ns: int | None = None, inputs: bool = True, fds: Sequence[int] = ()
    ) -> bool:
        self.row.heartbeat()
        self.done()
        if self.clock is not None:
            return self.clock(until_ns or 0)
        if not self.steps:
            return False
        self.steps.pop(0)()
        return not self.stopping

    def emit(self, topic: str, **values: Any) -> None:
        self.emitted.append({"topic": topic, **values})

    def request(self, word: str, **values: Any) -> None:
        self.asked.append({"cmd": word, **values})

    def hear(self, *commands: str, paused: bool = False, **options: Any) -> None:
        """Another state arrives, and these commands."""
        self.options = attrs.evolve(self.options, **options)
        self.paused = paused
        self.news = True
        self._rev += 1
        self._commands += [(word, {"cmd": word, "number": 7}) for word in commands]

    def notices(self) -> list[str]:
        return [one["text"] for one in self.emitted if one["topic"] == "notice"]


@contextlib.contextmanager
def recorded(
    folder: Path, patch: pytest.MonkeyPatch, stage: str, options: SessionOptions
) -> Iterator[Recorded]:
    """The context of that stage in a session with these options."""
    patch.setenv("LFPIPE_RUN_DIR", str(folder))
    session = Session("recorded")
    session.run_dir.mkdir(mode=0o700)
    store = SessionStore(session, SessionState.first(Config(), options))
    context = Recorded(
        StageSpec(
            name=stage,
            module="",
            session=session,
            config=Config(),
            rev=1,
            options=options,
            consumers=consumers(),
            others=(),
            source=SOURCE,
        )
    )
    try:
        yield context
    finally:
        context.close()
        context.table.rows.clear()
        store.close()
