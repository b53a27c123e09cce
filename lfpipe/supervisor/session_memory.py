"""The memory of a session: status table, rings, wake-ups. Only the supervisor creates and removes it."""

import contextlib
import gc

from lfpipe.config import Config
from lfpipe.host import wake
from lfpipe.supervisor.process_table import STAGES, consumers, rings
from lfpipe.transport import ring, status
from lfpipe.transport.segment import Segment
from lfpipe.transport.session import Session


class SessionMemory:
    """The segments and FIFOs of a session with this configuration.

    Raises UserError if memory is short, OSError if no FIFO can be created; then nothing is left behind.
    """

    def __init__(self, session: Session, config: Config) -> None:
        self._segments: list[Segment] = []
        self._table: status.Table | None = None
        try:
            self._segments.append(status.create(session.segment("status"), [s.name for s in STAGES], session.run_dir))
            for name, spec in rings(config).items():
                self._segments.append(ring.create(session.segment(name), spec, session.run_dir))
            for name, readers in consumers().items():
                for reader in readers:
                    wake.make(session.wake(name, reader))
                    wake.make(session.credit(name, reader))
            self._table = status.Table(session.segment("status"), writable=True)
        except BaseException:
            self.remove()
            raise

    @property
    def table(self) -> status.Table:
        """The status table. Drop all references to its rows before the memory is removed."""
        assert self._table is not None
        return self._table

    def remove(self) -> None:
        """Unlinks every segment; the FIFOs are removed with the run directory."""
        for memory in self._segments:
            with contextlib.suppress(FileNotFoundError):
                memory.unlink()
        if self._table is not None:
            gc.collect()  # frames of an exception may still reference rows of the table
            self._table.close()
        for memory in self._segments:
            memory.close()
        self._segments.clear()
