"""Light fields of our own making: folders with one small file. Views are rendered when packed, with exact disparity."""

import json
from pathlib import Path

from lfpipe.errors import UserError
from lfpipe.files.safe_files import replaced
from lfpipe.host.files import exists

NAME = "still-life-2"  # the demo's; increase a number when the pictures change: an old cache then stays untouched
NAMES = (NAME, "marbles-2", "meadow-2")
PREFIX = "demo:"  # demo:marbles names a scene as a path does
MARKER = "lfpipe-demo.json"
SIZE_PX = 512  # of a view, both sides


def demo_scene(cache_dir: Path, name: str = NAME, size_px: int = SIZE_PX) -> Path:
    """The folder of one of NAMES below cache_dir. Raises UserError if the cache cannot be written."""
    folder = cache_dir / "demo" / (name if size_px == SIZE_PX else f"{name}-{size_px}")
    marker = folder / MARKER
    try:
        if not marker.is_file():
            folder.mkdir(parents=True, exist_ok=True)
            with replaced(marker, 0o644) as file:
                file.write(json.dumps({"scene": name, "size_px": size_px}).encode())
    except OSError as error:
        raise UserError(
            f"demo scene: {folder} cannot be written: {error.strerror or error}",
            "make room or permission there, or name another place with --set scene.cache_dir=DIR",
        ) from None
    return folder


def named_scene(path: Path, cache_dir: Path) -> Path:
    """The folder of demo:NAME, or path itself. Raises UserError."""
    word = str(path)
    if not word.startswith(PREFIX) or exists(path):
        return path
    names = {name.rpartition("-")[0]: name for name in NAMES}
    if (name := names.get(word.removeprefix(PREFIX))) is None:
        raise UserError(f"{word}: no such scene", f"use {', '.join(PREFIX + name for name in names)}")
    return demo_scene(cache_dir, name=name)
