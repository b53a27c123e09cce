"""A runtime directory and the name of a session for one test."""

import secrets
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from lfpipe.transport.control import base_dir


@pytest.fixture
def name() -> str:
    return f"t{secrets.token_hex(4)}"


@pytest.fixture
def base(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Where this process looks for sessions; its path is short enough for sockets whatever TMPDIR
    says.
    """
    with tempfile.TemporaryDirectory(
        prefix="lf", dir=base_dir(), ignore_cleanup_errors=True
    ) as folder:
        base = Path(folder) / "run"
        base.mkdir(mode=0o700)
        monkeypatch.setenv("LFPIPE_RUN_DIR", str(base))
        yield base
