"""Recording the camera by key r: its folder, and its status in the window."""

import contextlib
import os
import time
from pathlib import Path

import platformdirs

from lfpipe.host.files import exists
from lfpipe.render.ui.notices import Notices, short
from lfpipe.sequence.folder import MANIFEST
from lfpipe.transport.clock import SECOND_NS
from lfpipe.transport.context import Context

FLUSH_NS = 10 * SECOND_NS  # a slow disk may take as long to take the rest
ENDED_NS = 8 * SECOND_NS  # time to read a path


class RecordingIndicator:
    """Starts and stops recordings, and shows the duration of any client's recording."""

    def __init__(self, context: Context, notices: Notices) -> None:
        self._context = context
        self._notices = notices
        self._folder = ""
        self._began_ns = 0
        self._length_s = 0
        self._is_asked = False
        self._ending: tuple[Path, int] | None = None  # until when it may still be written
        self.status = ""
        """Time of the current recording; "" for none."""

    def toggle(self) -> None:
        """Starts recording the camera and the eyes in the folder for pictures, or stops it."""
        if self._is_asked:
            return
        path = ""
        if not self._context.options.record:
            path = str(
                user_folder(platformdirs.user_videos_path())
                / time.strftime("lfpipe-recording-%Y%m%d-%H%M%S")
            )
            if self._context.paused:
                self._context.request("resume")
            self._notices.show("record", "Starting the recording ...", FLUSH_NS)
        self._is_asked = True
        self._context.request("record", path=path)

    def answered(self) -> None:
        """Takes the answer to a request."""
        self._is_asked = False

    def update(self, t_ns: int) -> bool:
        """Updates the status; returns whether it changed."""
        folder = self._context.options.record
        if folder != self._folder:
            if self._folder:
                self._ending = Path(self._folder), t_ns + FLUSH_NS
                self._length_s = (t_ns - self._began_ns) // SECOND_NS
            elif folder:
                self._notices.show("record", "Recording")
            self._folder, self._began_ns = folder, t_ns
        if self._ending is not None:
            self._show_ended(*self._ending, t_ns)
        minutes, seconds = divmod((t_ns - self._began_ns) // SECOND_NS, 60)
        before, self.status = self.status, f"{minutes}:{seconds:02}" if folder else ""
        return self.status != before

    def _show_ended(self, path: Path, until_ns: int, t_ns: int) -> None:
        """Shows the path of a recording once the recorder has ended it."""
        if not exists(path / MANIFEST) and t_ns < until_ns:
            return
        self._ending = None
        text = "Nothing recorded: stopped before the first frame"
        if exists(path / MANIFEST):
            text = f"Camera recorded, {self._length_s} s: {short(path)}"
        self._notices.show("record", text, ENDED_NS)


def user_folder(folder: Path) -> Path:
    """A folder of the desktop's, as ~/Pictures, which is made if it is missing; the working
    directory if the desktop has none.
    """
    with contextlib.suppress(OSError):
        if folder != Path.home():
            folder.mkdir(parents=True, exist_ok=True)
        if folder != Path.home() and os.access(folder, os.W_OK):
            return folder
    return Path.cwd()
