"""The shared memory and the state of a session. Only the supervisor creates and removes them."""

import contextlib
import gc
import os
from collections.abc import Collection, Mapping
from pathlib import Path

from lfpipe.host import wake
from lfpipe.host.segment import SHM_DIR, Segment
from lfpipe.scene.pack import hold_pack
from lfpipe.supervisor.process_table import LASTING, METRICS, consumers, rings
from lfpipe.supervisor.session_state import SessionState
from lfpipe.transport import control, ring, status
from lfpipe.transport.ring import RingSpec
from lfpipe.transport.session import Session


def _remove(memory: Segment) -> None:
    with contextlib.suppress(FileNotFoundError):
        memory.unlink()
    memory.close()


class SessionStore:
    """Stores the state of a session. The pack of the state is held, so that `lfpipe scene clean`
    does not remove it while the stage that shows it restarts.

    state: the current state; its rings exist, with the FIFOs that wake their readers. table: the
    status table; drop all references to its rows before `close`. Raises UserError if memory is
    short, OSError if no FIFO can be created, and then leaves nothing behind.
    """

    def __init__(self, session: Session, state: SessionState) -> None:
        self.state = state
        self._session = session
        self._unsent: bytes | None = None
        self._rings: dict[str, Segment] = {}
        self._pack = contextlib.ExitStack()
        with contextlib.ExitStack() as undo:
            self._status = status.create(session.segment("status"), METRICS, session.run_dir)
            undo.callback(_remove, self._status)
            undo.callback(self._keep, ())
            undo.callback(self._pack.close)
            self._hold(state.options.pack)
            self._make(self._needed(state))
            for name, readers in consumers().items():
                for reader in readers:
                    wake.make(session.wake(name, reader))
                    wake.make(session.credit(name, reader))
            self.table = status.Table(session.segment("status"), writable=True)
            self._memory = undo.pop_all()

    def removed(self) -> str:
        """The file of a segment that another program has removed; "" if all are in place."""
        memory = (self._status, *self._rings.values())
        return next((str(SHM_DIR / one.name) for one in memory if not one.in_place()), "")

    def apply(self, state: SessionState) -> None:
        """Stores a state; `take_message` returns a new revision for the stages.

        Raises UserError if memory is short, BadMessage if the stages could not read it; then
        nothing has changed.
        """
        message = control.encode(state.message()) if state.rev != self.state.rev else self._unsent
        needed = self._needed(state)
        self._make(needed)
        if state.options.pack != self.state.options.pack:
            self._hold(state.options.pack)
        self.state = state
        self._unsent = message
        self._keep({*needed, *LASTING})

    @staticmethod
    def _needed(state: SessionState) -> dict[str, RingSpec]:
        return rings(state.config, state.options) | state.rings()

    def _hold(self, pack: str) -> None:
        """Holds another pack, or none (""); a pack that cannot be held fails when it is shown."""
        self._pack.close()
        with contextlib.suppress(OSError, ValueError):
            if pack:
                self._pack.callback(os.close, hold_pack(Path(pack)))

    def _make(self, specs: Mapping[str, RingSpec]) -> None:
        """Creates rings that do not exist yet: all, or none and a UserError if memory is short."""
        before = set(self._rings)
        try:
            for name in specs.keys() - before:
                self._rings[name] = ring.create(
                    self._session.segment(name), specs[name], self._session.run_dir
                )
        except BaseException:
            self._keep(before)
            raise

    def _keep(self, names: Collection[str]) -> None:
        """Removes the other rings; existing mappings stay valid."""
        for name in self._rings.keys() - names:
            _remove(self._rings.pop(name))

    def take_message(self) -> bytes | None:
        """The newest state as a message for every stage, once; None if already sent. Of several
        changes, only the last is sent.
        """
        message = self._unsent
        self._unsent = None
        return message

    def close(self) -> None:
        """Unlinks every segment; the FIFOs are removed with the run directory."""
        gc.collect()
        # An exception that ends the session still references rows; its mapping ends with it.
        with contextlib.suppress(BufferError):
            self.table.close()
        self._memory.close()
