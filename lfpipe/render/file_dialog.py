"""The desktop's own dialog for opening a folder or a file: a child process, so that pictures go on."""

import shutil
import subprocess
from pathlib import Path

ABSENT = "drop a folder or a file onto the window (zenity or kdialog would give a dialog)"
TITLES = {True: "Open a folder of views", False: "Open a light field"}


def command(folder: bool) -> list[str] | None:
    """The command line of a dialog that prints the chosen path; None without one."""
    if program := shutil.which("zenity"):
        return [program, "--file-selection", f"--title={TITLES[folder]}", *(["--directory"] if folder else [])]
    if program := shutil.which("kdialog"):
        return [program, "--title", TITLES[folder], "--getexistingdirectory" if folder else "--getopenfilename", str(Path.home())]
    return None


class FileDialog:
    """At most one dialog at a time."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None

    def open(self, folder: bool) -> bool:
        """Opens the dialog unless one is open; returns whether this desktop has one."""
        if self._process is None and (line := command(folder)):
            self._process = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        return self._process is not None

    def chosen(self) -> Path | None:
        """What was chosen since the last call."""
        if self._process is None or self._process.poll() is None:
            return None
        path, _ = self._process.communicate()
        code, self._process = self._process.returncode, None
        return Path(path.rstrip("\n")) if code == 0 and path.strip() else None

    def close(self) -> None:
        """Ends a dialog that is still open."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
