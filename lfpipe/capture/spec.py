"""Parses names of frame sources: `camera:N`, `camera:/dev/videoN`, `camera:NAME`,
`file:PATH[?...]`, `demo`.
"""

from pathlib import Path
from typing import Literal, cast

import attrs

from lfpipe.errors import UserError
from lfpipe.files.untrusted import finite

FORMS = (
    "camera:N, camera:/dev/videoN, camera:NAME, file:PATH, file:PATH?loop=0|1&pace=recorded|max|HZ,"
    " or demo"
)
# below, it looks like a still picture; above, no camera or disk delivers it
MIN_RATE_HZ, MAX_RATE_HZ = 0.1, 10_000.0
PARAMETERS = f"loop=0|1 and pace=recorded|max|HZ, HZ from {MIN_RATE_HZ:g} to {MAX_RATE_HZ:g}"


@attrs.frozen
class CameraSpec:
    """A camera by its device file, or by its name as `lfpipe cameras` prints it; path is then
    empty.
    """

    path: Path
    name: str = ""

    def __str__(self) -> str:
        return f"camera:{self.name or self.path}"


@attrs.frozen
class FileSpec:
    """A video, a picture or a folder of pictures. pace: recorded times, as fast as it decodes, or a
    rate in Hz. names_loop: loop was given.
    """

    path: Path
    loop: bool = True
    pace: float | Literal["recorded", "max"] = "recorded"
    names_loop: bool = attrs.field(default=False, eq=False)


@attrs.frozen
class DemoSpec:
    """The moving portrait."""


Spec = CameraSpec | FileSpec | DemoSpec


def _file(text: str) -> FileSpec:
    path, _, query = text.rpartition("?") if "?" in text else (text, "", "")
    if not path:
        raise UserError("file: has no path", "use for example file:walk.mp4")
    parameters = dict(item.partition("=")[::2] for item in query.split("&") if item)
    loop = parameters.pop("loop", "")
    pace = parameters.pop("pace", "recorded")
    hz = finite(pace, MIN_RATE_HZ, MAX_RATE_HZ)
    if parameters or loop not in ("", "0", "1") or (pace not in ("recorded", "max") and hz is None):
        remedy = f"use {PARAMETERS}; if the path of the file contains a '?', append another '?'"
        raise UserError(f"{query!r} in {'file:' + text!r} is not understood", remedy)
    return FileSpec(
        Path(path).expanduser(),
        loop != "0",
        hz or cast(Literal["recorded", "max"], pace),
        bool(loop),
    )


def playing_once(text: str) -> str:
    """text with loop=0 if it names a file and its parameters do not name loop.

    Raises UserError as `parse_source` does.
    """
    spec = parse_source(text)
    once = isinstance(spec, FileSpec) and not spec.names_loop
    return f"{text}{'&' if '?' in text else '?'}loop=0" if once else text


def source_file(text: str) -> Path | None:
    """The file or folder that a source reads; None if it reads none, or is not a source."""
    try:
        spec = parse_source(text)
    except UserError:
        return None
    return spec.path if isinstance(spec, FileSpec) else None


def parse_source(text: str) -> Spec:
    """Parses text, without touching any file. Raises UserError that names the wrong part."""
    scheme, colon, rest = text.partition(":")
    if text == "demo":
        return DemoSpec()
    if scheme == "file" and colon:
        return _file(rest)
    if scheme != "camera" or not rest.strip():
        remedy = f"use camera:{text}" if text.isdecimal() else f"use one of {FORMS}"
        raise UserError(f"{text!r}: not a frame source", remedy)
    if rest.isascii() and rest.isdigit():
        return CameraSpec(Path(f"/dev/video{int(rest)}"))
    return CameraSpec(Path(rest)) if rest.startswith("/") else CameraSpec(Path(), rest.strip())
