"""The demo's light field: rendered once with exact disparity, cached in the HCI layout."""

import shutil
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2

from lfpipe.errors import UserError
from lfpipe.host.processes import usable_cores
from lfpipe.scene.demo_layers import Solid, render_view
from lfpipe.scene.demo_still_life import OFFSET_PX, WALL_D, still_life

NAME = "still-life-1"  # increase when the pictures change: an old cache then stays untouched
GRID, SIZE_PX = 9, 512
FOCAL_MM, SENSOR_MM, FOCUS_M = 100.0, 35.0, 1.5
NEAREST_D = 2.0
PNG_EFFORT = 2

Progress = Callable[[str, int, int], None]  # (task, steps done, steps in total)


def parameters(grid: int, size_px: int) -> str:
    """parameters.cfg in the HCI layout; the baseline follows from the scene's disparity of infinity.

    offset = baseline * focal length * width / (focus distance * sensor width), as in the benchmark's own tools.
    """
    baseline_mm = OFFSET_PX / 512 * FOCUS_M * 1000 * SENSOR_MM / FOCAL_MM
    low, high = WALL_D * size_px / 512, NEAREST_D * size_px / 512
    return f"""[intrinsics]
focal_length_mm = {FOCAL_MM:g}
image_resolution_x_px = {size_px}
image_resolution_y_px = {size_px}
sensor_size_mm = {SENSOR_MM:g}

[extrinsics]
num_cams_x = {grid}
num_cams_y = {grid}
baseline_mm = {baseline_mm:.6g}
focus_distance_m = {FOCUS_M:g}

[meta]
scene = {NAME}
category = demo
disp_min = {low:g}
disp_max = {high:g}
"""


def render_demo(folder: Path, grid: int, size_px: int, progress: Progress) -> None:
    """Writes grid x grid views of size_px x size_px with the disparity of each into folder, which must exist."""
    solids = still_life(size_px)
    middle = grid // 2

    def one(index: int) -> None:
        row, col = divmod(index, grid)
        _write_view(folder, index, row == col == middle, solids, size_px, col - middle, row - middle)

    # threads suffice: nearly all work is inside OpenCV, without the interpreter's lock
    with ThreadPoolExecutor(len(usable_cores())) as pool:
        for done, _ in enumerate(pool.map(one, range(grid * grid)), 1):
            progress("rendering the demo scene", done, grid * grid)
    (folder / "parameters.cfg").write_text(parameters(grid, size_px))


def _write_view(folder: Path, index: int, centre: bool, solids: list[Solid], size_px: int, u: int, v: int) -> None:
    picture, disparity = render_view(solids, size_px, size_px, u, v)
    # encoded in memory: OpenCV crashes on a path that is not UTF-8
    view = cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, PNG_EFFORT])[1].tobytes()
    true_map = cv2.imencode(".pfm", disparity)[1].tobytes()
    (folder / f"input_Cam{index:03d}.png").write_bytes(view)
    (folder / f"gt_disp_lowres_Cam{index:03d}.pfm").write_bytes(true_map)
    if centre:
        (folder / "gt_disp_lowres.pfm").write_bytes(true_map)


def demo_scene(cache_dir: Path, progress: Progress, grid: int = GRID, size_px: int = SIZE_PX) -> Path:
    """The folder of the demo's light field below cache_dir, rendered on first use.

    It appears atomically. Raises UserError if the cache cannot be written.
    """
    target = cache_dir / "demo" / (NAME if (grid, size_px) == (GRID, SIZE_PX) else f"{NAME}-{grid}x{grid}-{size_px}")
    if target.is_dir():
        return target
    working = None
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        working = Path(tempfile.mkdtemp(prefix=".rendering-", dir=target.parent))
        working.chmod(0o755)
        render_demo(working, grid, size_px, progress)
        working.rename(target)
    except OSError as error:
        if not target.is_dir():  # another session may have been faster: its folder is equal
            raise UserError(
                f"demo scene: {target.parent} cannot be written: {error.strerror or error}",
                "make room or permission there, or name another place with --set scene.cache_dir=DIR",
            ) from None
    finally:
        if working is not None and working.exists():
            shutil.rmtree(working, ignore_errors=True)
    return target
