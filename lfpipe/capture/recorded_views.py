"""The frames of a recorded live light field, published between the viewer's frames."""

from pathlib import Path

from lfpipe.config import LiveSource
from lfpipe.config.modes import Lossless
from lfpipe.sequence.folder import open_sequence
from lfpipe.sequence.views import open_views
from lfpipe.transport.clock import now_ns
from lfpipe.transport.context import Context


class RecordedViews:
    """Plays them in the order of the recording: one process feeds both streams, so that they
    cannot overtake each other.
    """

    def __init__(self, context: Context, live: LiveSource) -> None:
        """Raises UserError if the recording cannot be read."""
        self._context = context
        self._lossless = isinstance(context.options.clock, Lossless)
        recording = Path(live.source).parent
        self._viewer = open_sequence(recording, verify=False).packets
        opened = open_views(recording, verify=False)
        assert opened is not None
        self._sequence = opened[0]
        self._output = context.output("views")
        self._next = 0  # frame
        self._last: tuple[int, int] | None = None  # stamp and due time of the viewer's last frame

    def publish_before(self, index: int, due_ns: int) -> None:
        """Publishes the frames that were recorded before a frame of the viewer, when they are due:
        at the same place between its due time and that of the frame before.
        """
        stamp_ns = self._viewer[index].t_sensor_ns
        last_stamp_ns, last_due_ns = self._last or (stamp_ns - 1, due_ns - 1)
        views = self._sequence.packets
        while self._next < len(views) and views[self._next].t_sensor_ns <= stamp_ns:
            before_ns = stamp_ns - views[self._next].t_sensor_ns
            at_ns = due_ns - before_ns * (due_ns - last_due_ns) // (stamp_ns - last_stamp_ns)
            if not self._publish(at_ns):
                return
        self._last = stamp_ns, due_ns

    def _publish(self, due_ns: int) -> bool:
        """Whether the session goes on."""
        t_read_ns = now_ns()
        self._output.begin()[...] = self._sequence.frame(self._next)
        while not self._lossless and now_ns() < due_ns:
            if not self._context.wait(due_ns):
                return False
        self._output.publish(self._next, due_ns, t_read_ns)
        self._next += 1
        return True
