"""Names of a session: its run directory, segments, FIFOs and sockets. Pure paths; who makes them is the supervisor."""

from __future__ import annotations

import os
import re
from pathlib import Path

import attrs

from lfpipe.errors import UserError

PREFIX = f"lfpipe-{os.getuid()}-"  # of run directories and of segments, so that users do not meet


def base_dir() -> Path:
    """Where run directories lie: the user's runtime directory, or /tmp."""
    return Path(os.environ.get("XDG_RUNTIME_DIR") or "/tmp")


@attrs.frozen
class Session:
    """One session's names."""

    name: str = attrs.field()

    @name.validator
    def _check(self, _: object, value: str) -> None:
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.]{0,31}", value):
            raise UserError(f"--session {value!r}", "1 to 32 letters, digits, _ and ., the first a letter or digit")

    @property
    def run_dir(self) -> Path:
        return base_dir() / f"{PREFIX}{self.name}"

    @property
    def lock(self) -> Path:
        return self.run_dir / "lock"

    def segment(self, part: str) -> str:
        """Name of a shared-memory segment: a ring, or "status"."""
        return f"{PREFIX}{self.name}-{part}"

    def wake(self, ring: str, reader: str) -> Path:
        """FIFO by which the writer of ring wakes reader."""
        return self.run_dir / f"wake.{ring}.{reader}"

    def credit(self, ring: str, reader: str) -> Path:
        """FIFO by which reader tells the writer of ring that it has taken a slot, where nothing may be lost."""
        return self.run_dir / f"credit.{ring}.{reader}"


def default_name() -> str:
    """The session that commands mean when none is named."""
    return os.environ.get("LFPIPE_SESSION", "default")
