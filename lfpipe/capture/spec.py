"""Parses names of frame sources: `camera:N`, `camera:/dev/videoN`, `camera:NAME`, `file:PATH[?...]`, `demo`."""

import difflib
from pathlib import Path
from typing import Literal, cast

import attrs

from lfpipe.errors import UserError

FORMS = "camera:N, camera:/dev/videoN, camera:NAME, file:PATH, file:PATH?loop=0|1&pace=recorded|max|HZ, or demo"
PARAMETERS = "loop=0|1 and pace=recorded|max|HZ"
MIN_RATE_HZ, MAX_RATE_HZ = 0.1, 10_000.0


@attrs.frozen
class CameraSpec:
    """A camera by its device file, or by its name as `lfpipe cameras` prints it; path is then empty."""

    path: Path
    name: str = ""

    def __str__(self) -> str:
        return f"camera:{self.name or self.path}"


@attrs.frozen
class FileSpec:
    """A video, a picture or a folder of pictures. pace: recorded times, as fast as it decodes, or a rate in Hz."""

    path: Path
    loop: bool = True
    pace: float | Literal["recorded", "max"] = "recorded"


@attrs.frozen
class DemoSpec:
    """The moving portrait."""


Spec = CameraSpec | FileSpec | DemoSpec


def _file(text: str) -> FileSpec:
    path, mark, query = text.rpartition("?")
    if not mark:
        path, query = text, ""
    if not path:
        raise UserError("file: no path given", "use for example file:walk.mp4")
    spec = FileSpec(Path(path).expanduser())
    for item in query.split("&") if query else ():
        name, sign, value = item.partition("=")
        if not sign:
            remedy = "if the path contains a '?', append another '?'"
            raise UserError(f"{item!r} in {'file:' + text!r} is not NAME=VALUE", remedy)
        if name == "loop" and value in ("0", "1"):
            spec = attrs.evolve(spec, loop=value == "1")
        elif name == "pace" and (pace := _pace(value)):
            spec = attrs.evolve(spec, pace=pace)
        else:
            limits = f"HZ from {MIN_RATE_HZ:g} to {MAX_RATE_HZ:g}"
            raise UserError(f"{item!r} in {'file:' + text!r}: not understood", f"a file accepts {PARAMETERS}, {limits}")
    return spec


def _pace(value: str) -> float | Literal["recorded", "max", ""]:
    """Empty if value is no pace."""
    if value in ("recorded", "max"):
        return cast(Literal["recorded", "max"], value)
    try:
        rate_hz = float(value)
    except ValueError:
        return ""
    return rate_hz if MIN_RATE_HZ <= rate_hz <= MAX_RATE_HZ else ""  # NaN is out of range, too


def playing_once(text: str) -> str:
    """text with loop=0 if it names a file and its parameters do not name loop. Raises UserError as `parse_source` does."""
    if not isinstance(parse_source(text), FileSpec):
        return text
    path, mark, query = text.rpartition("?")
    if not mark:
        return f"{text}?loop=0"
    items = query.split("&") if query else []
    return text if any(item.startswith("loop=") for item in items) else f"{path}?{'&'.join([*items, 'loop=0'])}"


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
        close = difflib.get_close_matches(scheme, ("camera", "file", "demo"), 1, 0.4)
        hint = f" (did you mean {close[0]!r}?)" if close and close[0] != scheme else ""
        raise UserError(f"{text!r}: not a frame source{hint}", f"use one of {FORMS}")
    if rest.isascii() and rest.isdigit():
        return CameraSpec(Path(f"/dev/video{int(rest)}"))
    return CameraSpec(Path(rest)) if rest.startswith("/") else CameraSpec(Path(), rest.strip())
