"""The desktop's file dialog, a child process of the supervisor: at most one at a time."""

import os
import shutil
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

from lfpipe.errors import UserError
from lfpipe.host.child import NULL, PIPE, Child
from lfpipe.supervisor.control_sockets import Request
from lfpipe.supervisor.effects import Effect, Respond, Service
from lfpipe.supervisor.requests import on_chosen
from lfpipe.supervisor.session_state import SessionState

MAX_PATH_BYTES = 1 << 16  # of a dialog's output; the longest path has 4096
ALREADY_OPEN = UserError("a file dialog is already open", "choose there, or cancel it")
# A portal answers with a signal to the connection that asked; `gdbus call` and `busctl call` have
# closed theirs by then.
NO_DIALOG = UserError(
    "no file dialog is installed",
    "drop a folder or a file onto the window, or install zenity or kdialog",
)


def dialog_command(folder: bool) -> list[str]:
    """The command that shows the desktop's dialog for a folder or a file and prints the chosen
    path. Raises UserError if none is installed.
    """
    title = "Open a folder of views" if folder else "Open a light field"
    if program := shutil.which("zenity"):
        only_folders = ["--directory"] if folder else []
        return [program, "--file-selection", f"--title={title}", *only_folders]
    if program := shutil.which("kdialog"):
        kind = "--getexistingdirectory" if folder else "--getopenfilename"
        return [program, "--title", title, kind, str(Path.home())]
    raise NO_DIALOG


class FileDialog(Service):
    """The open dialog, if any. connections: returns the open ones."""

    guarded = True

    def __init__(self, connections: Callable[[], Collection[int]]) -> None:
        self._connections = connections
        self._request: Request | None = None
        self._process: Child | None = None
        self._output = b""

    def open(self, request: Request, folder: bool) -> None:
        """Opens a dialog for a request. Raises UserError if one is open or none is installed."""
        if self._process is not None:
            raise ALREADY_OPEN
        command = dialog_command(folder)
        try:
            self._process = Child(command, stdout=PIPE, stderr=NULL)
        except OSError as error:
            raise UserError(f"{command[0]}: {error.strerror}", NO_DIALOG.remedy) from None
        self._request = request
        self._output = b""

    @property
    def fds(self) -> list[int]:
        """Descriptors that wake the supervisor."""
        return [pipe.fileno() for pipe in self._process.pipes()] if self._process else []

    def update(self, state: SessionState, t_ns: int) -> Iterator[Effect]:
        if chosen := self.chosen():
            request, path = chosen
            request.message, reply = on_chosen(request.message, path)
            yield Respond(request, reply)

    def chosen(self) -> tuple[Request, str] | None:
        """The request and the chosen path once the dialog has ended, "" if it was cancelled. Closes
        the dialog of a client that has disconnected.
        """
        process, request = self._process, self._request
        if process is None or request is None:
            return None
        if request.connection not in self._connections():
            self.close()
            return None
        (stdout,) = process.pipes()
        data = stdout.read(MAX_PATH_BYTES)  # None while there is nothing to read
        self._output = (self._output + (data or b""))[:MAX_PATH_BYTES]
        if data != b"":
            return None
        self.close()
        path = os.fsdecode(self._output).rstrip("\n")
        return request, str(Path(path).absolute()) if path.strip() else ""

    def close(self) -> None:
        """Closes the dialog."""
        if self._process is not None:
            self._process.close()
        self._process = self._request = None
