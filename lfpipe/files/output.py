"""Output files: validate first, write to a temporary file, then rename.

An output never replaces an input of its command, a file in use, a file that lfpipe did not write,
or one that another command reads (INPUTS). `written_by_lfpipe` recognises its own by content,
whatever their names are:

- traces: the first line is an object with the first fields of a trace and the time of display
- timelines: the first event names lfpipe
- reports and results: JSON that begins with "format": "lfpipe-..."; JUnit XML of a suite "lfpipe"
- tables: the header row of a sweep or an exported sequence
- text: a first line of "# ", "// " or "<!-- " and MARK
- pictures, videos, ZIP files: MARK in the metadata of a picture, and at the end of the others
"""

import contextlib
import errno
import os
import re
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path

from lfpipe.errors import UserError
from lfpipe.files.safe_files import check_regular, in_use, open_regular, reason, replaced
from lfpipe.host.files import is_dir

MARK = b"written by lfpipe"
PLACE = "name a file in an existing folder that you may write to, on a disk with free space"
_HEAD_BYTES = 1 << 16  # more than any metadata of ours, and than the longest line of a trace
_TEXTS = (
    re.compile(rb'\{"seq": \d+, "source_seq": [^\n]*"t_presented_ns": '),
    re.compile(
        rb'\{"displayTimeUnit": "ms", "traceEvents": \[\s*\{"name": "process_name"[^\n]*"lfpipe"'
    ),
    re.compile(rb"<\?xml[^>]*\?>\s*<testsuites?\b[^>]*\bname=\"lfpipe "),
    re.compile(rb"state,subject,sequence,scene,config,"),  # of a sweep, as the next
    re.compile(rb'\{"subject": "[a-z]+", "sequence": "'),
    re.compile(rb"(# |// |<!-- |<!doctype html>\s*<!-- )" + MARK, re.IGNORECASE),
)
TABLE, RESULTS = "a table of stamps", "results of a benchmark"
INPUTS = {  # files of ours that commands read: each is replaced only by the command that writes it
    TABLE: re.compile(rb"seq,source_seq,epoch,t_sensor_ns,t_read_ns\b"),
    RESULTS: re.compile(rb'\{\s*"format": "lfpipe-bench'),
    "the manifest of a recording": re.compile(rb'\{\s*"format": "lfpipe-sequence'),
    "the report of a replay": re.compile(rb'\{\s*"format": \d+,\s*"versions": \{\s*"lfpipe"'),
}
_FOLDERS = ("manifest.json", "report.json")  # of recordings and references: no other output in them
_PICTURES = (b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"GIF8")
_EMPTY_PARTS = {  # what players pass over, at the end of a video
    ".mkv": b"\xec" + bytes([0x80 | len(MARK)]) + MARK,  # Void
    ".avi": b"JUNK" + len(MARK).to_bytes(4, "little") + MARK,
    ".mp4": (8 + len(MARK)).to_bytes(4, "big") + b"free" + MARK,
}


def check_output(
    path: Path,
    inputs: Iterable[Path] = (),
    overwrite: bool | None = None,
    label: str = "",
    writes: str = "",
) -> None:
    """Raises UserError if a command must not write path: not a file in a writable folder, an input
    of the same command or a file in an input folder, in use, written by another program, read by
    another command, or in a recording or reference. Changes nothing.

    overwrite: the value of the command's --overwrite, which allows replacing a file of another
    program; None without such an option. label: the option's name, for the message. writes: the
    name in INPUTS of what is written.
    """
    what = f"{label} {path}".lstrip()
    other = "name another file"
    try:
        target = Path(os.path.realpath(path))
        _check_place(target)
    except (OSError, ValueError) as error:
        raise UserError(f"{what}: {reason(error)}", PLACE) from None
    for source in inputs:
        if _is_input(target, Path(os.path.realpath(source))):
            where = f"{source}, which this command reads"
            raise UserError(
                *(
                    (f"{what}: is in {where}", "name a file in another folder")
                    if is_dir(source)
                    else (f"{what}: belongs to {where}", other)
                )
            )
    if in_use(target):
        raise UserError(
            f"{what}: another lfpipe is writing it", f"{other}, or end that session first"
        )
    if (kind := _kind(target)) and kind != writes:
        raise UserError(f"{what}: is {kind}, which lfpipe reads", other)
    for folder in target.parents[:2]:
        if any(_kind(folder / name) not in ("", RESULTS) for name in _FOLDERS):
            raise UserError(
                f"{what}: {folder} is a recording or reference", "name a file in another folder"
            )
    if os.path.lexists(target) and not overwrite and not written_by_lfpipe(target):
        remedy = other + ("" if overwrite is None else ", or replace it with --overwrite")
        raise UserError(f"{what}: exists, and was not written by lfpipe", remedy)


def check_outside(folder: Path, inputs: Iterable[Path | None], label: str = "") -> None:
    """Raises UserError if a folder that a command fills is, or lies in, one that it reads."""
    for source in filter(None, inputs):
        if _is_input(Path(os.path.realpath(folder)), Path(os.path.realpath(source))):
            raise UserError(
                f"{label} {folder}: is in {source}, which this command reads".lstrip(),
                "name another folder",
            )


def check_outputs(
    outputs: Mapping[str, Path | None], inputs: Iterable[Path] = (), overwrite: bool | None = None
) -> None:
    """`check_output` of all outputs of one command, by label; they must also differ.

    Raises UserError.
    """
    places: dict[str, str] = {}
    sources = list(inputs)
    for label, path in outputs.items():
        if path is None:
            continue
        check_output(path, sources, overwrite, label)
        other = places.setdefault(os.path.realpath(path), label)
        if other != label:
            raise UserError(f"{label} {path}: {other} writes the same file", "use two files")


def _check_place(target: Path) -> None:
    """Raises OSError if target is not a file, or cannot become one, or has another name: writing
    would change that file, too.
    """
    check_regular(target)
    target.parent.stat()
    exists = os.path.lexists(target)
    if not (
        os.access(target.parent, os.W_OK | os.X_OK) and (not exists or os.access(target, os.W_OK))
    ):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(target))
    if exists and target.stat().st_nlink > 1:
        raise OSError(errno.EMLINK, "has more than one hard link", str(target))


def _is_input(target: Path, source: Path) -> bool:
    """Whether target is source or its table, or in the folder source."""
    if is_dir(source):
        return target.is_relative_to(source)
    with contextlib.suppress(OSError):
        if target.samefile(source):
            return True
    return target in (source, source.with_suffix(".csv"))


def _kind(path: Path) -> str:
    """The name in INPUTS of a file that lfpipe wrote and reads; "" for others, and for one that
    cannot be read.
    """
    head = b""
    with contextlib.suppress(OSError), open_regular(path) as file:
        head = file.read(_HEAD_BYTES)
    return next((name for name, pattern in INPUTS.items() if pattern.match(head)), "")


def written_by_lfpipe(path: Path) -> bool:
    """Whether an existing file was written by lfpipe, or is empty. False if it cannot be read."""
    try:
        with open_regular(path) as file:
            head = file.read(_HEAD_BYTES)
            if not head or any(pattern.match(head) for pattern in (*_TEXTS, *INPUTS.values())):
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
        # 8 bytes of signature, 25 of IHDR, which must come first
        return data[:33] + framed + data[33:]
    if data.startswith(_PICTURES[1]):
        # JFIF's own segment must come first
        end = 4 + int.from_bytes(data[4:6], "big") if data[3] == 0xE0 else 2
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
