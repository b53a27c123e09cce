"""Recently shown scenes, newest first, in the user's state folder."""

import contextlib
import json
from pathlib import Path

import platformdirs

from lfpipe.files.safe_files import read_bytes, write_file
from lfpipe.host.files import exists

COUNT, MAX_BYTES = 40, 1 << 18  # several screens of thumbnails


def _file() -> Path:
    return Path(platformdirs.user_state_dir("lfpipe")) / "recent_scenes.json"


def recent_scenes() -> list[Path]:
    """The recent scenes that still exist."""
    try:
        paths = json.loads(read_bytes(_file(), MAX_BYTES))
    except (OSError, ValueError):
        return []
    texts = (
        [text for text in paths if isinstance(text, str) and "\0" not in text]
        if isinstance(paths, list)
        else []
    )
    return [path for path in map(Path, texts) if exists(path)]


def remember_scene(path: Path) -> None:
    """Puts a scene first. Does nothing if the folder cannot be written: the session matters more."""
    _write(list(dict.fromkeys([path.resolve(), *recent_scenes()]))[:COUNT])


def forget_scene(path: Path) -> None:
    """Takes a scene off the list; its files stay."""
    _write([scene for scene in recent_scenes() if scene != path])


def _write(paths: list[Path]) -> None:
    with contextlib.suppress(OSError):
        write_file(_file(), json.dumps([str(path) for path in paths]).encode())
