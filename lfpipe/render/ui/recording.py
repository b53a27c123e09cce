"""Recording the camera by key r: its folder, and its status in the window."""

import os
import time
from pathlib import Path

import platformdirs

from lfpipe.host.files import is_dir
from lfpipe.render.ui.notices import Notices
from lfpipe.sequence.packets import PACKETS
from lfpipe.transport.clock import SECOND_NS
from lfpipe.transport.context import Context

SIZE_NS = SECOND_NS // 2  # between two readings of its size
ENDED_NS = 8 * SECOND_NS  # time to read a path


class RecordingIndicator:
    """Starts and stops recordings, and shows duration and size of any client's recording."""

    def __init__(self, context: Context, notices: Notices) -> None:
        self._context = context
        self._notices = notices
        self._folder = ""
        self._began_ns = self._due_ns = 0
        self.status = ""
        """Time and size of the current recording; "" for none."""

    def toggle(self) -> None:
        """Starts recording the camera and the eyes in the folder for pictures, or stops it."""
        path = ""
        if not self._context.options.record:
            path = str(picture_folder() / time.strftime("lfpipe-recording-%Y%m%d-%H%M%S"))
            self._notices.show("record", "the recording starts")
        self._context.request("record", path=path)

    def update(self, t_ns: int) -> bool:
        """Updates the status; returns whether it changed."""
        folder = self._context.options.record
        if folder != self._folder:
            if self._folder:
                path = Path(self._folder)
                text = f"the recording is {path.name}\nin {path.parent}"
                self._notices.show(
                    "record", text if _size_bytes(path) else "no frame was recorded", ENDED_NS
                )
            self._folder = folder
            self.status = ""
            self._began_ns = self._due_ns = t_ns
        if not folder or t_ns < self._due_ns:
            return False
        self._due_ns = t_ns + SIZE_NS
        minutes, seconds = divmod((t_ns - self._began_ns) // SECOND_NS, 60)
        self.status = f"{minutes}:{seconds:02}  {_size_bytes(Path(folder)) / 1e6:.0f} MB"
        return True


def _size_bytes(folder: Path) -> int:
    """Size of a recording's frames."""
    try:
        return (folder / PACKETS).stat().st_size
    except OSError:
        return 0


def picture_folder() -> Path:
    """The desktop's folder for pictures, or else the working directory."""
    folder = platformdirs.user_pictures_path()
    return (
        folder
        if folder != Path.home() and is_dir(folder) and os.access(folder, os.W_OK)
        else Path.cwd()
    )
