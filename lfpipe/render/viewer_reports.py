"""Render's reports about its viewer: presence, the chosen depth, and visits."""

from pathlib import Path

from lfpipe.files.safe_files import reason
from lfpipe.render.geometry import Parallax
from lfpipe.render.presence import ViewerState
from lfpipe.render.viewer import Viewer
from lfpipe.render.visit_log import VisitLog
from lfpipe.transport.context import Context


class ViewerReports:
    """Emits each change once. Raises UserError if option visits names a file of another program."""

    def __init__(self, context: Context, viewer: Viewer) -> None:
        self._context, self._viewer = context, viewer
        self._parallax: Parallax | None = None
        self._visits = VisitLog(Path(context.options.visits)) if context.options.visits else None

    def follow_state(self) -> None:
        """Emits viewer (nobody, arriving, seated, lost, exchanged)."""
        state = self._viewer.presence.state
        before = ViewerState(int(self._context.row["viewer"]))
        if state == before:
            return
        self._context.row["viewer"] = int(state)
        self._context.emit("viewer", state=state.word)
        if self._visits is not None:
            try:
                self._visits.follow(before, state)
            except OSError as error:
                self._context.emit("notice", text=f"{self._context.options.visits}: cannot write visits: {reason(error)}")

    def follow_parallax(self) -> None:
        """Emits parallax when scene, settings or screen change it, but not at every step of a viewer."""
        chosen = self._viewer.parallax
        if chosen is not None and (self._parallax is None or chosen.differs_from(self._parallax)):
            self._parallax = chosen
            self._context.emit("parallax", text=str(chosen))
