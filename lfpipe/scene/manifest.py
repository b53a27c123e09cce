"""manifest.json of a pack: its metadata, checksums of its files, and a seal over itself.

    "contents": {"views.npy": {"bytes", "mtime_ns", "blake2b", "sampled"}, ...}
    "seal": blake2b of the rest, as canonical JSON

Opening a pack compares sizes, times and a few blocks of each file, which takes almost no time; only a file whose time has changed
is read completely. `lfpipe scene check` always reads everything.
"""

import contextlib
import hashlib
import json
import os
import zlib
from pathlib import Path
from typing import Any, BinaryIO

from lfpipe.errors import UserError
from lfpipe.files.safe_files import open_regular, read_bytes, reason
from lfpipe.files.untrusted import Fields, json_fields
from lfpipe.host.descriptors import read_at

NAME = "manifest.json"
VERSION = 8  # of the pack; another version is another key
_MAX_BYTES = 16 << 20
_SAMPLES, _SAMPLE_BYTES = 16, 4096
_REMEDY = "`lfpipe scene pack` makes it again"


class DamagedPackError(UserError):
    """A folder that is not a complete pack of this version."""


def damaged(where: Path, why: str) -> DamagedPackError:
    """The error that names a pack or a file of it."""
    return DamagedPackError(f"{where}: {why}", _REMEDY)


def _sealed(manifest: dict[str, Any]) -> str:
    body = {key: value for key, value in manifest.items() if key != "seal"}
    return hashlib.blake2b(json.dumps(body, sort_keys=True, allow_nan=False).encode(), digest_size=16).hexdigest()


def write_manifest(folder: Path, manifest: dict[str, Any]) -> None:
    """Writes the manifest with its seal atomically. Raises OSError."""
    new = folder / f".{NAME}.{os.getpid()}"
    try:
        new.write_text(json.dumps({**manifest, "seal": _sealed(manifest)}, indent=1, allow_nan=False))
        new.replace(folder / NAME)
    except OSError:
        new.unlink(missing_ok=True)
        raise


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a pack, its seal checked. Raises DamagedPackError if it is missing, changed or of another version."""
    try:
        fields = json_fields(read_bytes(folder / NAME, _MAX_BYTES), str(folder / NAME), _REMEDY)
    except OSError as error:
        raise damaged(folder, f"not a whole pack: {NAME} cannot be read: {reason(error)}") from None
    except UserError as error:
        raise DamagedPackError(error.message, _REMEDY) from None
    manifest = dict(fields.values)
    if manifest.get("version") != VERSION:
        raise damaged(folder, f"a pack of another version; this lfpipe reads version {VERSION}")
    if manifest.get("seal") != _sealed(manifest):
        raise damaged(folder / NAME, "changed after the pack was made")
    return manifest


def contents(folder: Path, names: list[str]) -> dict[str, dict[str, Any]]:
    """The entry "contents" for files of a new pack. Raises OSError."""
    found: dict[str, dict[str, Any]] = {}
    for name in names:
        with open_regular(folder / name) as file:
            state = os.fstat(file.fileno())
            sums = {"blake2b": _checksum(file), "sampled": _sampled(file, state.st_size)}
            found[name] = {"bytes": state.st_size, "mtime_ns": state.st_mtime_ns, **sums}
    return found


def _checksum(file: BinaryIO) -> str:
    digest = hashlib.blake2b(digest_size=16)
    file.seek(0)
    while block := file.read(1 << 20):
        digest.update(block)
    return digest.hexdigest()


def _sampled(file: BinaryIO, size: int) -> int:
    """CRC of blocks from the first to the last, spread evenly."""
    crc, last = 0, max(0, size - _SAMPLE_BYTES)
    for number in range(_SAMPLES):
        crc = zlib.crc32(read_at(file.fileno(), _SAMPLE_BYTES, last * number // (_SAMPLES - 1)), crc)
    return crc


def open_content(folder: Path, manifest: dict[str, Any], name: str, whole: bool = False) -> BinaryIO:
    """Opens a file of a pack and compares it with the manifest. whole: read all of it even if its time is unchanged.

    If only the time has changed, as in a copy, the manifest is updated. Raises DamagedPackError.
    """
    path = folder / name
    try:
        about = Fields(manifest, str(folder / NAME), _REMEDY).table("contents").table(name)
        size, mtime_ns = about.integer("bytes", 1, 1 << 50), about.integer("mtime_ns", 0, 1 << 62)
        checksum, sampled = about.text("blake2b", 64), about.integer("sampled", 0, 1 << 32)
    except UserError as error:
        raise DamagedPackError(error.message, _REMEDY) from None
    file: BinaryIO | None = None
    try:
        file = open_regular(path)
        state = os.fstat(file.fileno())
        if state.st_size != size:
            raise damaged(path, f"{state.st_size} bytes, but {size} were written")
        touched = state.st_mtime_ns != mtime_ns
        if _sampled(file, size) != sampled or ((whole or touched) and _checksum(file) != checksum):
            raise damaged(path, "wrong checksum: changed after the pack was made")
        if touched:
            manifest["contents"][name]["mtime_ns"] = state.st_mtime_ns
            with contextlib.suppress(OSError):  # a read-only cache
                write_manifest(folder, manifest)
    except (OSError, DamagedPackError) as error:
        if file is not None:
            file.close()
        if isinstance(error, OSError):
            raise damaged(path, f"cannot be read: {reason(error)}") from None
        raise
    return file
