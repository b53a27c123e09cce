"""The demo's light field: a folder with one small file in it. Its views are rendered when it is packed, with exact disparity."""

import json
from pathlib import Path

from lfpipe.errors import UserError
from lfpipe.files.safe_files import replaced

NAME = "still-life-1"  # increase when the pictures change: an old cache then stays untouched
MARKER = "lfpipe-demo.json"
GRID, SIZE_PX = 9, 512


def demo_scene(cache_dir: Path, grid: int = GRID, size_px: int = SIZE_PX) -> Path:
    """The folder of the demo's light field below cache_dir. Raises UserError if the cache cannot be written."""
    folder = cache_dir / "demo" / (NAME if (grid, size_px) == (GRID, SIZE_PX) else f"{NAME}-{grid}x{grid}-{size_px}")
    marker = folder / MARKER
    try:
        if not marker.is_file():
            folder.mkdir(parents=True, exist_ok=True)
            with replaced(marker, 0o644) as file:
                file.write(json.dumps({"scene": NAME, "grid": grid, "size_px": size_px}).encode())
    except OSError as error:
        raise UserError(
            f"demo scene: {folder} cannot be written: {error.strerror or error}",
            "make room or permission there, or name another place with --set scene.cache_dir=DIR",
        ) from None
    return folder
