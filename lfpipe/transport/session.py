"""Names of a session: its run directory, segments, FIFOs and sockets. The supervisor creates what they name."""

import hashlib
import os
import re
from pathlib import Path

import attrs

from lfpipe.errors import UserError
from lfpipe.host import segment

PREFIX = f"lfpipe-{os.getuid()}-"  # of run directories, to separate users
LONGEST_RING = 13  # characters of a ring's name in the name of its segment


def base_dir() -> Path:
    """Parent of run directories: XDG_RUNTIME_DIR, or /tmp. Raises UserError if it is no absolute UTF-8 path."""
    text = (
        os.environ.get("XDG_RUNTIME_DIR") or "/tmp"
    )  # short: the path of a socket has at most 107 bytes, on macOS 103
    remedy = "set it to a directory of yours, or unset it"
    if not Path(text).is_absolute():
        raise UserError(f"XDG_RUNTIME_DIR={text!r} is not an absolute path", remedy)
    try:
        text.encode()
    except UnicodeEncodeError:
        raise UserError(f"XDG_RUNTIME_DIR={text!r} is not UTF-8", remedy) from None
    return Path(text)


def segment_prefix(run_dir: Path) -> str:
    """First part of the names of a session's segments: `lfp-`, 12 hexadecimal digits of a hash, `-`.

    The hash is the SHA-256 of `DEVICE:INODE/NAME`: device and inode of the run directory's parent, and its own name. It is
    the same for any path to that directory, and differs in another container that shares /dev/shm.
    """
    try:
        parent = run_dir.parent.stat()
        base = f"{parent.st_dev}:{parent.st_ino}"
    except OSError:  # no session can exist there
        base = str(run_dir.parent)
    return f"{segment.PREFIX}{_digest(f'{base}/{run_dir.name}')}-"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def _check_name(name: str, setting: str) -> None:
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.]{0,31}", name):
        raise UserError(
            f"{setting} is not a valid name",
            "use 1 to 32 letters, digits, _ and ., beginning with a letter or digit",
        )


@attrs.frozen
class Session:
    """One session's names."""

    name: str = attrs.field()

    @name.validator
    def _check(self, _: object, value: str) -> None:
        _check_name(value, f"--session {value!r}")

    @property
    def run_dir(self) -> Path:
        return base_dir() / f"{PREFIX}{self.name}"

    @property
    def lock(self) -> Path:
        return self.run_dir / "lock"

    def segment(self, ring: str) -> str:
        """Name of a shared-memory segment, at most 30 characters. ring: its name, "status", or "" for the prefix of all names.

        If this process's runtime directory has no such session, the name is that of the user's only session of this name
        elsewhere, so readers need not use the session's runtime directory.
        """
        return self._segments() + (ring if len(ring) <= LONGEST_RING else f"_{_digest(ring)}")

    def _segments(self) -> str:
        run_dir = self.run_dir
        here = segment_prefix(run_dir)
        if os.access(run_dir, os.F_OK):
            return here
        elsewhere = {
            name[: len(here)]
            for name, owner in segment.owned().items()
            if owner.name == run_dir.name
        }
        return elsewhere.pop() if len(elsewhere) == 1 else here

    def wake(self, ring: str, reader: str) -> Path:
        """FIFO with which the writer of ring wakes reader."""
        return self.run_dir / f"wake.{ring}.{reader}"

    def credit(self, ring: str, reader: str) -> Path:
        """FIFO with which reader reports to the writer of ring that it has read a slot, in lossless sessions."""
        return self.run_dir / f"credit.{ring}.{reader}"


def default_name() -> str:
    """The session that commands use by default. Raises UserError if LFPIPE_SESSION is not a valid name."""
    name = os.environ.get("LFPIPE_SESSION") or "default"
    _check_name(name, f"LFPIPE_SESSION={name!r}")
    return name
