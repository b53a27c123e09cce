"""One picture as a file, written atomically."""

import os
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.host.paths import is_dir


def picture_folder(home: Path, environment: Mapping[str, str]) -> Path:
    """The folder for pictures: the desktop's, or else the working directory.

    The desktop's folder is XDG_PICTURES_DIR in user-dirs.dirs (xdg-user-dirs); without that file, ~/Pictures.
    """
    found = home / "Pictures"
    try:
        known = Path(environment.get("XDG_CONFIG_HOME") or home / ".config") / "user-dirs.dirs"
        for line in known.read_text(errors="replace").splitlines():
            name, _, value = line.partition("=")
            if name.strip() == "XDG_PICTURES_DIR":
                found = Path(value.strip().strip('"').replace("$HOME", str(home)))
    except OSError:
        pass
    usable = found.is_absolute() and found != home and is_dir(found) and os.access(found, os.W_OK)
    return found if usable else Path.cwd()


def save(path: Path, picture: NDArray[np.uint8]) -> str:
    """Writes picture, uint8 (height, width, 3) BGR, as the PNG path; returns why it failed, "" if it did not. An existing file
    stays until the new one is complete.
    """
    done, data = cv2.imencode(".png", picture)
    assert done, "a uint8 picture is always a PNG"
    new = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        new.write_bytes(data.tobytes())
        new.replace(path)
    except OSError as error:
        new.unlink(missing_ok=True)
        return f"{path}: the picture is not saved: {error.strerror}"
    return ""
