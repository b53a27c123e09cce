"""Names of a session: its run directory, segments, FIFOs and sockets, made by the supervisor."""

import errno
import hashlib
import json
import os
import re
import secrets
import time
from pathlib import Path
from typing import Any

import attrs

from lfpipe.errors import UserError
from lfpipe.files.safe_files import write_file
from lfpipe.host import segment
from lfpipe.transport.clock import now_ns

PREFIX = f"lfpipe-{os.getuid()}-"  # of run directories, to separate users
MANIFEST = "session.json"  # in the run directory


def base_dir() -> Path:
    """Parent of run directories: XDG_RUNTIME_DIR, or /tmp. Raises UserError if it is not an
    absolute UTF-8 path.
    """
    # short: the path of a socket has at most 107 bytes, on macOS 103
    text = os.environ.get("XDG_RUNTIME_DIR") or "/tmp"
    remedy = "set it to a directory of your own, or unset it"
    if not Path(text).is_absolute():
        raise UserError(f"XDG_RUNTIME_DIR={text!r} is not an absolute path", remedy)
    try:
        text.encode()
    except UnicodeEncodeError:
        raise UserError(f"XDG_RUNTIME_DIR={text!r} is not UTF-8", remedy) from None
    return Path(text)


def place_prefix(run_dir: Path) -> str:
    """Prefix of the names of all segments of a run directory's sessions: `lfp-`, 12 hexadecimal
    digits of a hash, `-`.

    The hash is the SHA-256 of `DEVICE:INODE/NAME`: device and inode of the run directory's parent,
    and its own name. It is the same for any path to that directory, and differs in another
    container that shares /dev/shm.
    """
    try:
        parent = run_dir.parent.stat()
        base = f"{parent.st_dev}:{parent.st_ino}"
    except OSError:  # no session can exist there
        base = str(run_dir.parent)
    digest = hashlib.sha256(f"{base}/{run_dir.name}".encode()).hexdigest()
    return f"{segment.PREFIX}{digest[:12]}-"


def _check_name(name: str, setting: str) -> None:
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.]{0,31}", name):
        raise UserError(
            f"{setting} is not a valid name",
            "use 1 to 32 letters, digits, _ and ., beginning with a letter or digit",
        )


@attrs.frozen
class Session:
    """The names of one session."""

    name: str = attrs.field()
    token: str = ""
    """Random part of the names of its memory, so that no other user can take them first. Only the
    supervisor and its stages have it; it is empty for others, who read it from the session's
    manifest.
    """

    @name.validator
    def _check(self, _: object, value: str) -> None:
        _check_name(value, f"--session {value!r}")

    def with_token(self) -> "Session":
        """The names of a new session: its memory has names of its own."""
        return attrs.evolve(self, token=secrets.token_hex(8))

    @property
    def run(self) -> str:
        """Unique id of this run of the session, for other programs; does not reveal the token."""
        return f"{self.name}.{hashlib.sha256(self.token.encode()).hexdigest()[:12]}"

    @property
    def run_dir(self) -> Path:
        return base_dir() / f"{PREFIX}{self.name}"

    @property
    def lock(self) -> Path:
        return self.run_dir / "lock"

    def segment(self, ring: str) -> str:
        """Name of a shared-memory segment. ring: its name, "status", or "" for the prefix of all
        names.

        If this process's runtime directory has no such session, the name is that of the user's only
        session of this name elsewhere, so readers need not use the session's runtime directory.
        Raises FileNotFoundError if no such session runs.
        """
        if self.token:
            return f"{place_prefix(self.run_dir)}{self.token}-{ring}"
        if os.access(self.run_dir, os.F_OK):
            return SessionManifest.read(self.run_dir).segments + ring
        elsewhere = {
            f"{name.rpartition('-')[0]}-"
            for name, owner in segment.owned().items()
            if owner.name == self.run_dir.name
        }
        if len(elsewhere) != 1:
            raise FileNotFoundError(
                errno.ENOENT, "no session, or several, with that name", self.name
            )
        return elsewhere.pop() + ring

    def wake(self, ring: str, reader: str) -> Path:
        """FIFO with which the writer of ring wakes reader."""
        return self.run_dir / f"wake.{ring}.{reader}"

    def credit(self, ring: str, reader: str) -> Path:
        """FIFO with which reader reports to the writer of ring that it has read a slot, in lossless
        sessions.
        """
        return self.run_dir / f"credit.{ring}.{reader}"


@attrs.frozen(kw_only=True)
class SessionManifest:
    """The file `session.json` in the run directory of a running session."""

    session: str
    """Its name."""
    segments: str
    """Prefix of the names of its shared memory."""
    pid: int
    """Of the supervisor."""
    started_ns: int
    """By CLOCK_MONOTONIC."""
    started: str
    """The same time by the wall clock."""
    options: dict[str, Any]
    """`SessionOptions` at its start, as plain values."""

    @classmethod
    def begin(cls, session: Session, options: dict[str, Any]) -> "SessionManifest":
        """Writes the manifest of a session that starts now in this process."""
        manifest = cls(
            session=session.name,
            segments=session.segment(""),
            pid=os.getpid(),
            started_ns=now_ns(),
            started=time.strftime("%Y-%m-%dT%H:%M:%S%z"),
            options=options,
        )
        write_file(session.run_dir / MANIFEST, json.dumps(attrs.asdict(manifest)).encode())
        return manifest

    @classmethod
    def read(cls, run_dir: Path) -> "SessionManifest":
        """The manifest of the session that runs there. Raises FileNotFoundError."""
        return cls(**json.loads((run_dir / MANIFEST).read_text()))


def default_name() -> str:
    """The session that commands use by default.

    Raises UserError if LFPIPE_SESSION is not a valid name.
    """
    name = os.environ.get("LFPIPE_SESSION") or "default"
    _check_name(name, f"LFPIPE_SESSION={name!r}")
    return name
