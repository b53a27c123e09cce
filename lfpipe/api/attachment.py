"""A running session, as seen from another program: its frames and eyes, read from shared memory without affecting the session."""

import time
from collections.abc import Iterator
from types import TracebackType
from typing import Any, Self

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.api.tracker import Eyes
from lfpipe.config import from_dict
from lfpipe.errors import UserError
from lfpipe.observe.session_reader import Watch
from lfpipe.share.head import HeadEstimator
from lfpipe.supervisor.rundir import find
from lfpipe.transport import control
from lfpipe.transport.ring import Reader, Stamp

LOOK_S = 0.001  # between two polls of a ring


@attrs.frozen(eq=False)
class Frame:
    """A camera frame. picture: uint8 (height, width, 3) BGR, a copy. stamp: source_seq, t_sensor_ns, t_read_ns, skipped, ..."""

    picture: NDArray[np.uint8]
    stamp: Stamp


class Attachment:
    """One session. Reads the newest data; a slow reader skips frames."""

    def __init__(self, session: str) -> None:
        self._session = find(session)
        self._watch = Watch(self._session)
        self._frames, self._eyes = (Reader(self._session.segment(name)) for name in ("frames", "eyes"))
        self._record = np.zeros((), self._eyes.dtype)
        self._estimator = HeadEstimator(from_dict(self.ask({"cmd": "hello"})["config"]))

    def frame(self, timeout_s: float = 2.0) -> Frame:
        """The next camera frame. Raises lfpipe.UserError if none arrives in time."""
        picture: NDArray[np.uint8] = np.empty(self._frames.shape, np.uint8)
        return Frame(picture, self._next(self._frames, picture, timeout_s))

    def eyes(self, timeout_s: float = 2.0) -> Eyes | None:
        """The eyes of the next frame; None if it shows no face. Raises lfpipe.UserError if no frame arrives in time."""
        stamp = self._next(self._eyes, self._record, timeout_s)
        self._estimator.update(self._record, stamp.t_sensor_ns)
        return Eyes.of(self._record, stamp.t_sensor_ns, self._estimator.head(self._record))

    def stream(self) -> Iterator[Eyes | None]:
        """Yields `eyes` until the session ends."""
        while self._watch.living():
            try:
                yield self.eyes()
            except UserError:
                continue

    def _next(self, reader: Reader, out: NDArray[Any], timeout_s: float) -> Stamp:
        end = time.monotonic() + timeout_s
        while (stamp := reader.read(out)) is None:
            if time.monotonic() > end:
                raise UserError(f"session {self._session.name!r}: nothing new for {timeout_s:g} s", "`lfpipe monitor` says why")
            time.sleep(LOOK_S)
        return stamp

    def status(self) -> dict[str, Any]:
        """State and latency of every stage, as `lfpipe monitor --once --json` prints it."""
        return self._watch.read()

    def ask(self, message: dict[str, Any]) -> dict[str, Any]:
        """Sends a command (docs/contracts.md) and returns the answer. Raises lfpipe.UserError if it is refused."""
        return control.request(self._session.run_dir, message)

    def close(self) -> None:
        """Detaches from the session."""
        for each in (self._frames, self._eyes, self._watch):
            each.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def attach(session: str = "default") -> Attachment:
    """Attaches to the running session of that name. Raises lfpipe.UserError if there is none."""
    return Attachment(session)
