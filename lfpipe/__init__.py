"""lfpipe: a light field you look into, on an ordinary screen.

For programs and notebooks (docs/python.md): `open_scene`, `render_view`, `render_anaglyph`,
`Tracker`, `LiveScene`, `replay`, `attach`. Each is imported when it is first used, so that
`import lfpipe` and the command line stay quick.
"""

import importlib
import logging
import os
from typing import TYPE_CHECKING, Any

from lfpipe._version import __version__ as __version__

if TYPE_CHECKING:
    from lfpipe.api.live_scene import LiveScene, Viewpoints
    from lfpipe.api.scenes import Eyes, Tracker, open_scene, render_anaglyph, render_view
    from lfpipe.api.session import Attachment, Frame, Session, attach, replay
    from lfpipe.errors import UserError
    from lfpipe.scene.lightfield import LightField
    from lfpipe.track.eye_tracker import Head

__all__ = [
    "Attachment",
    "Eyes",
    "Frame",
    "Head",
    "LightField",
    "LiveScene",
    "Session",
    "Tracker",
    "UserError",
    "Viewpoints",
    "attach",
    "open_scene",
    "render_anaglyph",
    "render_view",
    "replay",
]
_MODULES = {
    "api.live_scene": ("LiveScene", "Viewpoints"),
    "api.scenes": ("Eyes", "Tracker", "open_scene", "render_anaglyph", "render_view"),
    "api.session": ("Attachment", "Frame", "Session", "attach", "replay"),
    "errors": ("UserError",),
    "scene.lightfield": ("LightField",),
    "track.eye_tracker": ("Head",),
}

# A program that sets up no logging gets no messages, as from any library.
logging.getLogger(__name__).addHandler(logging.NullHandler())
# OpenCV reads these when it is imported. The first is a second limit behind lfpipe.files.pictures;
# the second keeps FFmpeg from printing a line for every frame of a damaged video.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(240_000_000))
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")


def __getattr__(name: str) -> Any:
    for module, names in _MODULES.items():
        if name in names:
            value = globals()[name] = getattr(importlib.import_module(f"{__name__}.{module}"), name)
            return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
