"""Replay of a recorded sequence from a program, in a process of its own."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lfpipe.config import Config, updated
from lfpipe.errors import UserError


def replay(
    sequence: str | os.PathLike[str],
    scene: str | os.PathLike[str] | None = None,
    *,
    pace: str = "step",
    out: str | os.PathLike[str] | None = None,
    settings: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Runs `lfpipe replay` on a recorded sequence and returns its report, the contents of report.json (docs/replay.md).

    scene: None for the demo's. pace: step, max, recorded or a rate in Hz. out: folder for report, trace and pictures.
    settings: as `--set`; they override the user's file. Raises lfpipe.UserError if the command refuses or fails.
    """
    updated(Config(), settings or {})
    with tempfile.TemporaryDirectory(prefix="lfpipe-replay-") as folder:
        kept = Path(out) if out is not None else Path(folder) / "out"
        words = [sys.executable, "-m", "lfpipe", "replay", str(sequence), "--pace", pace, "--out", str(kept)]
        words += ["--scene", str(scene)] if scene is not None else []
        for key, value in (settings or {}).items():
            words += ["--set", f"{key}={json.dumps(value)}"]
        done = subprocess.run(words, capture_output=True, text=True, errors="replace", check=False)
        if done.returncode != 0:
            message, _, remedy = (done.stderr.strip() or "it was killed").removeprefix("error: ").partition("\n  remedy: ")
            raise UserError(message, remedy)
        report: dict[str, Any] = json.loads((kept / "report.json").read_text())
        return report
