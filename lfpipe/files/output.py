"""Files that a command writes for a person: checked without being changed, written beside their place, moved there when readable.

Nothing a person owns is lost: an output never replaces an input of its command, a file in use, or a file that lfpipe did not
write. `written_by_lfpipe` recognises the others by their content, whatever their names are:

    trace                first line: an object with the keys of TRACE_KEYS
    timeline             the first event names lfpipe
    reports, results     JSON that begins with "format": "lfpipe-..."; JUnit XML of a suite "lfpipe ..."
    tables               the header row of an exported sequence
    text                 a first line of "# ", "// " or "<!-- " and MARK
    pictures, videos     MARK in their metadata: PNG text, JPEG and GIF comment, MP4 comment, space reserved by Matroska and AVI
"""

import contextlib
import errno
import json
import os
import re
import zlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import IO

from lfpipe.errors import UserError
from lfpipe.files.safe_files import PRIVATE, check_regular, create_private, open_regular, reason
from lfpipe.host.file_lock import is_held, lock_open
from lfpipe.host.files import longest_name, write_at

MARK = b"written by lfpipe"
TRACE_KEYS = {"source_seq", "epoch", "t_sensor_ns", "t_presented_ns", "eyes_used", "view", "composed"}
PLACE = "name a file in an existing folder that you may write to, on a disk with free space"
_NAMELESS = getattr(os, "O_TMPFILE", 0)  # tries to write in a folder without changing it; not every file system can
_HEAD_BYTES = 1 << 16  # more than any metadata of ours, and than the longest line of a trace
_MOOV_BYTES = 1 << 20  # of an MP4: its index may come before the comment
_TEXTS = (
    re.compile(rb'\{"displayTimeUnit": "ms", "traceEvents": \[\s*\{"name": "process_name"[^\n]*"lfpipe"'),
    re.compile(rb'\{\s*"format": ("lfpipe-|\d+,\s*"versions": \{\s*"lfpipe")'),
    re.compile(rb"<\?xml[^>]*\?>\s*<testsuites?\b[^>]*\bname=\"lfpipe "),
    re.compile(rb"state,subject,sequence,scene,config,"),  # of a sweep, as the next
    re.compile(rb'\{"subject": "[a-z]+", "sequence": "'),
    re.compile(rb"seq,source_seq,epoch,t_sensor_ns,t_read_ns\b"),
    re.compile(rb"(# |// |<!-- |<!doctype html>\s*<!-- )" + MARK, re.IGNORECASE),
)
_PICTURES = (b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"GIF8", b"\x1a\x45\xdf\xa3", b"RIFF")
_MATROSKA_INFO = bytes.fromhex("1549a966")


def check_output(path: Path, inputs: Iterable[Path] = (), force: bool | None = None, label: str = "") -> None:
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
    ours = not os.path.lexists(target) or written_by_lfpipe(target)
    for source in inputs:
        if _is_input(target, Path(os.path.realpath(source)), ours):
            raise UserError(f"{what}: this command reads it (from {source})", "name another file")
    if _in_use(target) or _in_use(_beside(target)):
        raise UserError(f"{what}: another lfpipe is writing it", "name another file, or end that session first")
    if not ours and not force:
        remedy = "name another file" + ("" if force is None else ", or replace it with --force")
        raise UserError(f"{what}: exists, and was not written by lfpipe", remedy)


def check_outputs(outputs: Mapping[str, Path | None], inputs: Iterable[Path] = (), force: bool | None = None) -> None:
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
    folder = target.parent
    folder.stat()
    name = os.fsencode(target.name)
    if not name or len(name) > longest_name(folder):
        code = errno.ENAMETOOLONG if name else errno.EISDIR
        raise OSError(code, os.strerror(code), str(target))
    if os.path.lexists(target) and not os.access(target, os.W_OK):
        raise OSError(errno.EACCES, os.strerror(errno.EACCES), str(target))
    try:
        if _NAMELESS:
            os.close(os.open(folder, _NAMELESS | os.O_WRONLY, PRIVATE))
            return
    except OSError as error:
        if error.errno not in (errno.EOPNOTSUPP, errno.EISDIR, errno.EINVAL):
            raise
    probe = folder / f".lfpipe.{os.getpid()}.probe"
    create_private(probe).close()
    probe.unlink()


def _is_input(target: Path, source: Path, ours: bool) -> bool:
    """Whether target is source, or an existing file in the folder source. A text of ours in a folder is not what a command reads
    there; a picture of ours may be."""
    if target == source:
        return True
    with contextlib.suppress(OSError):
        if target.samefile(source):
            return True
        return source.is_dir() and target.is_relative_to(source) and target.exists() and not (ours and _is_text(target))
    return False


def _is_text(path: Path) -> bool:
    """Whether a file of ours is no picture and not empty (it may be being written)."""
    with open_regular(path) as file:
        head = file.read(12)
    return bool(head) and not head.startswith(_PICTURES) and head[4:8] != b"ftyp"


def _in_use(path: Path) -> bool:
    try:
        return is_held(path)
    except OSError:
        return False


def written_by_lfpipe(path: Path) -> bool:
    """Whether an existing file was written by lfpipe, or is empty. False if it cannot be read."""
    try:
        with open_regular(path) as file:
            head = file.read(_HEAD_BYTES)
            if not head or any(pattern.match(head) for pattern in _TEXTS):
                return True
            if head.startswith(_PICTURES):
                return MARK in head
            if head[4:8] == b"ftyp":
                head += file.read(_MOOV_BYTES)
                file.seek(max(0, os.fstat(file.fileno()).st_size - _HEAD_BYTES))
                return MARK in head or MARK in file.read()
            return _is_trace_line(head.partition(b"\n")[0])
    except OSError:
        return False


def _is_trace_line(line: bytes) -> bool:
    try:
        values = json.loads(line)
    except (ValueError, RecursionError):
        return False
    return isinstance(values, dict) and values.keys() >= TRACE_KEYS


def marked_picture(data: bytes) -> bytes:
    """An encoded PNG or JPEG with MARK in its metadata. The pixels stay as they are."""
    if data.startswith(_PICTURES[0]):
        chunk = b"tEXtSoftware\0" + MARK
        framed = (len(chunk) - 4).to_bytes(4, "big") + chunk + zlib.crc32(chunk).to_bytes(4, "big")
        return data[:33] + framed + data[33:]  # 8 bytes of signature, 25 of IHDR, which must come first
    if data.startswith(_PICTURES[1]):
        end = 4 + int.from_bytes(data[4:6], "big") if data[3] == 0xE0 else 2  # JFIF's own segment must come first
        return data[:end] + b"\xff\xfe" + (len(MARK) + 2).to_bytes(2, "big") + MARK + data[end:]
    raise ValueError("not a PNG or JPEG")


def mark_video(path: Path) -> bool:
    """Writes MARK into the space that FFmpeg reserves at the head of a Matroska or AVI file, also of one still being written.

    Returns whether the mark is in the file: not before its head is on the disk. Completing the file erases the mark of a
    Matroska file, so mark it again then. Raises OSError.
    """
    with path.open("r+b") as file:
        head = file.read(_HEAD_BYTES)
        if MARK in head:
            return True
        blank = bytes(len(MARK))
        if head.startswith(b"RIFF"):
            junk = head.find(b"JUNK")
            at = junk + 8 + int.from_bytes(head[junk + 4 : junk + 8], "little") - len(MARK)
        else:
            at = head.find(blank + _MATROSKA_INFO)  # the end of the space for an index
        if at < 0 or head[at : at + len(MARK)] != blank:
            return False
        write_at(file.fileno(), MARK, at)
    return True


def _beside(target: Path) -> Path:
    """Where target is written until it is readable: same folder, same suffix, because FFmpeg chooses the format by it."""
    return target.with_name(f".{target.stem[:180]}.new{target.suffix[:40]}")


class OutputFile:
    """A file that is written at `beside` and replaces `path` with `place`; until then, path is unchanged.

    It is locked while it is open, so that no other command replaces it. A writer that is killed leaves it in place if `place` was
    called, and otherwise a hidden file that the next writer removes. Raises OSError.
    """

    def __init__(self, path: Path, mode: int = PRIVATE) -> None:
        """mode: of the file, less the umask."""
        self.path = Path(os.path.realpath(path))
        check_regular(self.path)
        self.beside = _beside(self.path)
        if _in_use(self.beside):
            raise OSError(errno.EBUSY, "another lfpipe is writing it", str(path))
        self.beside.unlink(missing_ok=True)
        self.file = create_private(self.beside, mode)
        lock_open(self.file.fileno())
        self.placed = False

    @property
    def current(self) -> Path:
        """Where the file is now."""
        return self.path if self.placed else self.beside

    def place(self) -> None:
        """Moves the file to its path. It stays open, and may grow."""
        if not self.placed:
            self.beside.replace(self.path)
            self.placed = True

    def close(self) -> None:
        """Ends writing. A file that was not placed is removed."""
        if not self.placed:
            self.beside.unlink(missing_ok=True)
        with contextlib.suppress(OSError):  # of a full disk; the writer has reported it
            self.file.close()


@contextlib.contextmanager
def finished_output(path: Path, mode: int = PRIVATE) -> Iterator[OutputFile]:
    """An output that replaces path when the body ends without an exception; until then path is unchanged. Raises OSError."""
    output = OutputFile(path, mode)
    try:
        yield output
        output.file.flush()
        output.place()
    finally:
        output.close()


@contextlib.contextmanager
def output_file(path: Path, mode: int = PRIVATE) -> Iterator[IO[bytes]]:
    """The open file of a `finished_output`."""
    with finished_output(path, mode) as output:
        yield output.file


def write_output(path: Path, data: bytes, mode: int = 0o644, label: str = "") -> None:
    """Replaces path, which `check_output` allows, with data. Raises UserError."""
    try:
        with output_file(path, mode) as file:
            file.write(data)
    except OSError as error:
        raise UserError(f"{label} {path}: {reason(error)}".lstrip(), PLACE) from None
