"""Light fields of our own making: folders with one small file. Views are rendered when packed, with exact disparity."""

import json
from pathlib import Path

from lfpipe.errors import UserError
from lfpipe.files.safe_files import replaced
from lfpipe.host.files import exists

NAME = "still-life-1"  # the demo's; increase a number when the pictures change: an old cache then stays untouched
NAMES = (NAME, "marbles-1", "meadow-1")
PREFIX = "demo:"  # demo:marbles names a scene as a path does
MARKER = "lfpipe-demo.json"
GRID, SIZE_PX = 9, 512


def demo_scene(cache_dir: Path, grid: int = GRID, size_px: int = SIZE_PX, name: str = NAME) -> Path:
    """The folder of one of NAMES below cache_dir. Raises UserError if the cache cannot be written."""
    folder = cache_dir / "demo" / (name if (grid, size_px) == (GRID, SIZE_PX) else f"{name}-{grid}x{grid}-{size_px}")
    marker = folder / MARKER
    try:
        if not marker.is_file():
            folder.mkdir(parents=True, exist_ok=True)
            with replaced(marker, 0o644) as file:
                file.write(json.dumps({"scene": name, "grid": grid, "size_px": size_px}).encode())
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
