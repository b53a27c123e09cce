"""Recently shown scenes, newest first, in the user's state folder."""

import contextlib
import json
from pathlib import Path

import platformdirs

from lfpipe.files.safe_files import read_bytes, write_file
from lfpipe.host.files import exists

# several screens of thumbnails
COUNT = 40


def _file() -> Path:
    return Path(platformdirs.user_state_dir("lfpipe")) / "recent_scenes.json"


def _read() -> list[Path]:
    """The scenes of the list, without checking that they exist."""
    try:
        paths = json.loads(read_bytes(_file()))
    except (OSError, ValueError):
        return []
    if not isinstance(paths, list):
        return []
    return [Path(text) for text in paths if isinstance(text, str) and "\0" not in text]


def recent_scenes() -> list[Path]:
    """The recent scenes that still exist."""
    return [path for path in _read() if exists(path)]


def remember_scene(path: Path) -> None:
    """Puts a scene first.

    Does nothing if the folder is not writable: the session goes on.
    """
    _write(list(dict.fromkeys([path.resolve(), *recent_scenes()]))[:COUNT])


def _write(paths: list[Path]) -> None:
    with contextlib.suppress(OSError):
        write_file(_file(), json.dumps([str(path) for path in paths]).encode())
