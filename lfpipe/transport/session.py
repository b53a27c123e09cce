"""Names of a session: its directory, and the lock, memory, FIFOs and sockets in it, made by the
supervisor.
"""

import json
import os
import re
import time
from pathlib import Path
from typing import Any

import attrs

from lfpipe.errors import UserError
from lfpipe.files.safe_files import write_file
from lfpipe.host.files import is_dir
from lfpipe.host.segment import SHM_DIR
from lfpipe.transport.clock import now_ns

PREFIX = f"lfpipe-{os.getuid()}-"  # of the directories, to separate users
LIVE = f"{PREFIX}live-"  # of those of live scenes, which no session has: names contain no "-"
MANIFEST = "session.json"  # in the directory of a session


def base_dir() -> Path:
    """Parent of the directories: LFPIPE_RUN_DIR; by default /dev/shm, whose files are memory, or
    where there is none, XDG_RUNTIME_DIR or /tmp. Raises UserError if it is not an absolute path.
    """
    # short: the path of a socket has at most 107 bytes, on macOS 103
    usual = SHM_DIR if is_dir(SHM_DIR) else os.environ.get("XDG_RUNTIME_DIR") or "/tmp"
    text = os.environ.get("LFPIPE_RUN_DIR") or str(usual)
    if not Path(text).is_absolute():
        raise UserError(
            f"LFPIPE_RUN_DIR={text!r} is not an absolute path",
            "set it to a directory of your own, or unset it",
        )
    return Path(text)


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

    @name.validator
    def _check(self, _: object, value: str) -> None:
        _check_name(value, f"--session {value!r}")

    @property
    def run(self) -> str:
        """Unique id of this run of the session, for other programs. Raises FileNotFoundError."""
        manifest = SessionManifest.read(self.run_dir)
        return f"{self.name}.{manifest.pid}.{manifest.started_ns}"

    @property
    def run_dir(self) -> Path:
        return base_dir() / f"{PREFIX}{self.name}"

    def segment(self, ring: str) -> Path:
        """The file of a segment. ring: its name, or "status"."""
        return self.run_dir / (ring if ring == "status" else f"{ring}.ring")

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
