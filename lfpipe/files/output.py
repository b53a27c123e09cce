"""Output files: a command checks first, writes to a temporary file, then renames.

An output never replaces an input of its command, nor a file that exists unless the person says
`--overwrite`.
"""

import contextlib
import errno
import os
from collections.abc import Iterable
from pathlib import Path

from lfpipe.errors import UserError
from lfpipe.files.safe_files import check_regular, reason, replaced
from lfpipe.host.files import is_dir

PLACE = "name a file in an existing folder that you may write to, on a disk with free space"


def check_output(
    path: Path,
    inputs: Iterable[Path] = (),
    overwrite: bool | None = None,
    label: str = "",
) -> None:
    """Raises UserError if a command must not write path: not a file in a writable folder, an input
    of the same command or a file in an input folder, or there already. Changes nothing.

    overwrite: the value of the command's --overwrite; None without such an option. label: the
    option's name, for the message.
    """
    what = f"{label} {path}".lstrip()
    try:
        target = Path(os.path.realpath(path))
        check_regular(target)
        target.parent.stat()
        exists = os.path.lexists(target)
        if not os.access(target.parent, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except (OSError, ValueError) as error:
        raise UserError(f"{what}: {reason(error)}", PLACE) from None
    for source in inputs:
        if _is_input(target, source):
            raise UserError(
                f"{what}: belongs to {source}, which this command reads",
                "name a file in another folder" if is_dir(source) else "name another file",
            )
    if exists and not overwrite:
        remedy = "name another file" + ("" if overwrite is None else ", or add --overwrite")
        raise UserError(f"{what}: already exists", remedy)


def check_outside(folder: Path, inputs: Iterable[Path | None], label: str = "") -> None:
    """Raises UserError if a folder that a command fills is, or lies in, one that it reads."""
    for source in filter(None, inputs):
        if _is_input(Path(os.path.realpath(folder)), source):
            raise UserError(
                f"{label} {folder}: is in {source}, which this command reads".lstrip(),
                "name another folder",
            )


def _is_input(target: Path, source: Path) -> bool:
    """Whether target is source, or in the folder source."""
    with contextlib.suppress(OSError):
        if target.samefile(source):
            return True
    return target.is_relative_to(os.path.realpath(source))


def write_output(path: Path, data: bytes, mode: int = 0o644, label: str = "") -> None:
    """Replaces path, which `check_output` allows, with data. Raises UserError."""
    try:
        with replaced(path, mode) as file:
            file.write(data)
    except OSError as error:
        raise UserError(f"{label} {path}: {reason(error)}".lstrip(), PLACE) from None
