"""lfpipe: a light field you look into, on an ordinary screen.

For programs and notebooks (docs/python.md): `open_scene`, `render_view`, `render_anaglyph`, `Tracker`, `replay`, `attach`. Each
is imported when it is first used, so that `import lfpipe` and the command line stay quick.
"""

import importlib
import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lfpipe.api.scenes import open_scene as open_scene
    from lfpipe.api.scenes import render_anaglyph as render_anaglyph
    from lfpipe.api.scenes import render_view as render_view
    from lfpipe.api.session import Attachment as Attachment
    from lfpipe.api.session import Frame as Frame
    from lfpipe.api.session import Session as Session
    from lfpipe.api.session import attach as attach
    from lfpipe.api.session import replay as replay
    from lfpipe.api.tracker import Eyes as Eyes
    from lfpipe.api.tracker import Tracker as Tracker
    from lfpipe.errors import UserError as UserError
    from lfpipe.scene.lightfield import LightField as LightField
    from lfpipe.share.head import Head as Head

__version__ = "0.1.0"

_MODULES = {
    "Attachment": "api.session",
    "Eyes": "api.tracker",
    "Frame": "api.session",
    "Head": "share.head",
    "Session": "api.session",
    "LightField": "scene.lightfield",
    "Tracker": "api.tracker",
    "UserError": "errors",
    "attach": "api.session",
    "open_scene": "api.scenes",
    "render_anaglyph": "api.scenes",
    "render_view": "api.scenes",
    "replay": "api.session",
}

__all__ = [*_MODULES]

# OpenCV reads these when it is imported. The first is a second limit behind lfpipe.files.pictures; the second keeps FFmpeg
# from printing a line for every frame of a damaged video.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(240_000_000))
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
