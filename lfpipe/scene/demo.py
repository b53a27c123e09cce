"""Demo light fields: folders with one small file. The packer renders their views, with exact
disparity.
"""

import json
from pathlib import Path

from lfpipe.errors import UserError
from lfpipe.files.safe_files import write_file
from lfpipe.host.files import exists

NAME = "still-life"  # the default demo
NAMES = (NAME, "marbles", "meadow")
VERSION = 3  # increase it when the pictures change: older packs then stay untouched
PREFIX = "demo:"  # demo:marbles is accepted in place of a path
MARKER = "lfpipe-demo.json"
SIZE_PX = 512  # of a view, both sides, that the scenes are described for, and benchmarks use
SHOWN_PX = 768  # of those on a screen: drawn at full quality at 60 Hz on two cores


def demo_scene(cache_dir: Path, name: str = NAME, size_px: int = SHOWN_PX) -> Path:
    """The folder of one of NAMES below cache_dir.

    Raises UserError if the cache cannot be written.
    """
    folder = cache_dir / f"demo-{VERSION}" / (name if size_px == SHOWN_PX else f"{name}-{size_px}")
    marker = folder / MARKER
    try:
        if not marker.is_file():
            write_file(
                marker,
                json.dumps({"scene": name, "version": VERSION, "size_px": size_px}).encode(),
                0o644,
            )
    except OSError as error:
        raise UserError(
            f"demo scene: {folder} cannot be written: {error.strerror or error}",
            "check free disk space and permissions, or use another folder with --set"
            " scene.cache_dir=DIR",
        ) from None
    return folder


def named_scene(path: Path, cache_dir: Path) -> Path:
    """The folder of demo:NAME, or path itself. Raises UserError."""
    word = str(path)
    if not word.startswith(PREFIX) or exists(path):
        return path
    if (name := word.removeprefix(PREFIX)) not in NAMES:
        raise UserError(
            f"{word}: no such scene", f"use {', '.join(PREFIX + name for name in NAMES)}"
        )
    return demo_scene(cache_dir, name=name)
