"""Parses names of frame sources: `camera:N`, `camera:/dev/videoN`, `camera:NAME`, `file:PATH[?...]`, `demo`."""

import difflib
from pathlib import Path
from typing import Literal

import attrs

from lfpipe.errors import UserError

FORMS = "camera:N, camera:/dev/videoN, camera:NAME, file:PATH, file:PATH?loop=0|1&pace=recorded|max|HZ, or demo"
MIN_RATE_HZ, MAX_RATE_HZ = 0.1, 10_000.0


@attrs.frozen
class CameraSpec:
    """A camera by its device file, or by its name as `lfpipe cameras` prints it; path is then empty."""

    path: Path
    name: str = ""


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


def _hint(word: str, *known: str) -> str:
    """The known word that was probably meant."""
    begins = {each.partition(":")[0]: each for each in known}
    close = difflib.get_close_matches(word, begins, 1, 0.4)
    return f" (did you mean {begins[close[0]]!r}?)" if close else ""


def _device(text: str, whole: str) -> CameraSpec:
    if text.isascii() and text.isdigit():
        return CameraSpec(Path(f"/dev/video{int(text)}"))
    if text.startswith("/"):
        return CameraSpec(Path(text))
    if not text.strip():
        raise UserError(f"{whole!r}: no camera given", "use for example camera:0, camera:/dev/video0 or camera:NAME")
    return CameraSpec(Path(), text.strip())


def _pace(value: str) -> float | Literal["recorded", "max"]:
    if value == "recorded":
        return "recorded"
    if value == "max":
        return "max"
    example = "for example pace=30, or pace=max to play without waiting"
    try:
        rate_hz = float(value)
    except ValueError:
        raise UserError(f"pace={value}: not recorded, max or a rate in Hz{_hint(value, 'recorded', 'max')}", example) from None
    if not MIN_RATE_HZ <= rate_hz <= MAX_RATE_HZ:  # false for nan too
        raise UserError(f"pace={value}: out of range: {MIN_RATE_HZ:g} to {MAX_RATE_HZ:g} Hz", example)
    return rate_hz


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
        if name == "loop":
            if value not in ("0", "1"):
                raise UserError(f"loop={value}: not 0 or 1", "loop=0 plays once, loop=1 repeats")
            spec = attrs.evolve(spec, loop=value == "1")
        elif name == "pace":
            spec = attrs.evolve(spec, pace=_pace(value))
        else:
            remedy = "a file accepts loop=0|1 and pace=recorded|max|HZ"
            raise UserError(f"{name!r} in {'file:' + text!r}: unknown parameter{_hint(name, 'loop', 'pace')}", remedy)
    return spec


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
    """Parses text, without touching any file.

    Raises UserError that names the wrong part.
    """
    scheme, colon, rest = text.partition(":")
    if text == "demo":
        return DemoSpec()
    if scheme == "camera" and colon:
        return _device(rest, text)
    if scheme == "file" and colon:
        return _file(rest)
    raise UserError(f"{text!r}: not a frame source{_hint(scheme, 'camera:0', 'file:PATH', 'demo')}", f"use one of {FORMS}")
