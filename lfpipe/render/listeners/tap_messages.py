"""Messages about the viewer to monitors."""

from collections.abc import Callable

from lfpipe.config import SessionOptions
from lfpipe.config.modes import Lossless, MouseViewer
from lfpipe.render.presenter import Listener, Presentation
from lfpipe.render.viewer.geometry import Parallax
from lfpipe.render.viewer.presence import ViewerState
from lfpipe.render.viewer.viewer import Viewer
from lfpipe.transport.clock import MS_NS

LOOK_NS = 100 * MS_NS  # between two messages "look"


class TapMessages(Listener):
    """Sends "viewer" when the viewer's state changes, "parallax" when alpha changes, a "notice" of
    its summary when somebody is seated for the first time and, while pictures are leased,
    "look" with the eyes and the grid of views over them.
    """

    def __init__(self, emit: Callable[..., None], viewer: Viewer, state: ViewerState) -> None:
        """emit: as `Context.emit`. state: the viewer's, as reported last."""
        self._emit = emit
        self._viewer = viewer
        self._state = state
        self._options = SessionOptions()
        self._look_due_ns = 0
        self._parallax: Parallax | None = None  # reported last
        self._was_seated = False

    def set_options(self, options: SessionOptions) -> None:
        self._options = options

    def handed_over(self, presentation: Presentation) -> None:
        viewer = self._viewer
        if presentation.eyes is not None:
            if viewer.presence.state is not self._state:
                self._state = viewer.presence.state
                self._emit("viewer", state=self._state.word)
            if self._options.pictures and presentation.t_handed_ns >= self._look_due_ns:
                self._look_due_ns = presentation.t_handed_ns + LOOK_NS
                self._emit_look(presentation)
        parallax = viewer.parallax
        if parallax is None or isinstance(self._options.clock, Lossless):  # nobody watches a replay
            return
        if self._parallax is None or parallax.differs_from(self._parallax):
            self._parallax = parallax
            self._emit("parallax", text=str(parallax))
        if self._state is ViewerState.SEATED and not self._was_seated:
            self._was_seated = True
            if not isinstance(self._options.viewer, MouseViewer):  # its distance is assumed
                self._emit("notice", text=parallax.summary)

    def _emit_look(self, presentation: Presentation) -> None:
        field = self._viewer.field
        solver = self._viewer.solver
        eyes_px = presentation.viewpoints.eyes_px
        self._emit(
            "look",
            face=presentation.face,
            eyes_px=[list(eyes_px[:2]), list(eyes_px[2:])],
            grid=[field.rows, field.cols],
            alpha_px=solver.alpha_px if solver else 0.0,
            centre_px=list(solver.centre_px) if solver else [0.0, 0.0],
        )
