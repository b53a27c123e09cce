"""Files that a command writes for a person: checked without being changed, written beside their place, moved there when readable.

An output never replaces an input of its command, a file in use, or a file that lfpipe did not write. `written_by_lfpipe`
recognises its own by content, whatever their names are:

    trace                first line: an object with the first fields of a trace and the time of display
    timeline             the first event names lfpipe
    reports, results     JSON that begins with "format": "lfpipe-..."; JUnit XML of a suite "lfpipe ..."
    tables               the header row of an exported sequence
    text                 a first line of "# ", "// " or "<!-- " and MARK
    pictures, videos     MARK in the metadata of a picture, and at the end of a video
"""

import contextlib
import errno
import os
import re
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path

from lfpipe.errors import UserError
from lfpipe.files.safe_files import beside, check_regular, in_use, open_regular, reason, replaced

MARK = b"written by lfpipe"
PLACE = "name a file in an existing folder that you may write to, on a disk with free space"
_HEAD_BYTES = 1 << 16  # more than any metadata of ours, and than the longest line of a trace
_TEXTS = (
    re.compile(rb'\{"seq": \d+, "source_seq": [^\n]*"t_presented_ns": '),
    re.compile(
        rb'\{"displayTimeUnit": "ms", "traceEvents": \[\s*\{"name": "process_name"[^\n]*"lfpipe"'
    ),
    re.compile(rb'\{\s*"format": ("lfpipe-|\d+,\s*"versions": \{\s*"lfpipe")'),
    re.compile(rb"<\?xml[^>]*\?>\s*<testsuites?\b[^>]*\bname=\"lfpipe "),
    re.compile(rb"state,subject,sequence,scene,config,"),  # of a sweep, as the next
    re.compile(rb'\{"subject": "[a-z]+", "sequence": "'),
    re.compile(rb"seq,source_seq,epoch,t_sensor_ns,t_read_ns\b"),
    re.compile(rb"(# |// |<!-- |<!doctype html>\s*<!-- )" + MARK, re.IGNORECASE),
)
_PICTURES = (b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"GIF8")
_EMPTY_PARTS = {  # what players pass over, at the end of a video
    ".mkv": b"\xec" + bytes([0x80 | len(MARK)]) + MARK,  # Void
    ".avi": b"JUNK" + len(MARK).to_bytes(4, "little") + MARK,
    ".mp4": (8 + len(MARK)).to_bytes(4, "big") + b"free" + MARK,
}


def check_output(
    path: Path, inputs: Iterable[Path] = (), force: bool | None = None, label: str = ""
) -> None:
    """Raises UserError if a command must not write path: not a file in a writable folder, an input (or a file in an input folder)
    of the same command, in use, or written by another program. Changes nothing.

    force: the value of the command's --force, which allows to replace a file of another program; None without such an option.
    label: the option's name, for the message.
    """
    what = f"{label} {path}".lstrip()
    try:
        target = Path(os.path.realpath(path))
        _check_place(target)
    except (OSError, ValueError) as error:
        raise UserError(f"{what}: {reason(error)}", PLACE) from None
    exists = os.path.lexists(target)
    for source in inputs:
        if _is_input(target, Path(os.path.realpath(source))):
            raise UserError(f"{what}: this command reads it (from {source})", "name another file")
    if in_use(target) or in_use(beside(target)):
        raise UserError(
            f"{what}: another lfpipe is writing it", "name another file, or end that session first"
        )
    if exists and not force and not written_by_lfpipe(target):
        remedy = "name another file" + ("" if force is None else ", or replace it with --force")
        raise UserError(f"{what}: exists, and was not written by lfpipe", remedy)


def check_outputs(
    outputs: Mapping[str, Path | None], inputs: Iterable[Path] = (), force: bool | None = None
) -> None:
    """`check_output` of all outputs of one command, by label; they must also differ. Raises UserError."""
    places: dict[str, str] = {}
    sources = list(inputs)
    for label, path in outputs.items():
        if path is None:
            continue
        check_output(path, sources, force, label)
        other = places.setdefault(os.path.realpath(path), label)
        if other != label:
            raise UserError(f"{label} {path}: {other} writes the same file", "use two files")


def _check_place(target: Path) -> None:
    """Raises OSError if target is not a file, or cannot become one."""
    check_regular(target)
    target.parent.stat()
    if not (
        os.access(target.parent, os.W_OK | os.X_OK)
        and (not os.path.lexists(target) or os.access(target, os.W_OK))
    ):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(target))


def _is_input(target: Path, source: Path) -> bool:
    """Whether target is source, or an existing file in the folder source."""
    with contextlib.suppress(OSError):
        return target.samefile(source) or (source.is_dir() and target.is_relative_to(source))
    return target == source


def written_by_lfpipe(path: Path) -> bool:
    """Whether an existing file was written by lfpipe, or is empty. False if it cannot be read."""
    try:
        with open_regular(path) as file:
            head = file.read(_HEAD_BYTES)
            if not head or any(pattern.match(head) for pattern in _TEXTS):
                return True
            if head.startswith(_PICTURES):
                return MARK in head
            file.seek(-len(MARK), os.SEEK_END)
            return b"\0" in head and file.read() == MARK
    except OSError:
        return False


def marked_picture(data: bytes) -> bytes:
    """An encoded PNG or JPEG with MARK in its metadata. The pixels stay as they are."""
    if data.startswith(_PICTURES[0]):
        chunk = b"tEXtSoftware\0" + MARK
        framed = (len(chunk) - 4).to_bytes(4, "big") + chunk + zlib.crc32(chunk).to_bytes(4, "big")
        return (
            data[:33] + framed + data[33:]
        )  # 8 bytes of signature, 25 of IHDR, which must come first
    if data.startswith(_PICTURES[1]):
        end = (
            4 + int.from_bytes(data[4:6], "big") if data[3] == 0xE0 else 2
        )  # JFIF's own segment must come first
        return data[:end] + b"\xff\xfe" + (len(MARK) + 2).to_bytes(2, "big") + MARK + data[end:]
    raise ValueError("not a PNG or JPEG")


def mark_video(path: Path) -> None:
    """Marks a complete .mkv, .avi or .mp4 file as written by lfpipe. Raises OSError."""
    with path.open("ab") as file:
        if file.tell():  # a full disk leaves an empty file
            file.write(_EMPTY_PARTS[path.suffix.lower()])


def write_output(path: Path, data: bytes, mode: int = 0o644, label: str = "") -> None:
    """Replaces path, which `check_output` allows, with data. Raises UserError."""
    try:
        with replaced(path, mode) as file:
            file.write(data)
    except OSError as error:
        raise UserError(f"{label} {path}: {reason(error)}".lstrip(), PLACE) from None
