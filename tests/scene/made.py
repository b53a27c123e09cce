"""Light fields drawn by the tests, textured layers at known disparities, and the files that layouts
keep them in.
"""

from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Scene
from lfpipe.scene.orientation import orient
from lfpipe.scene.source import GridTransform, SceneSource

SAMPLES = Path(__file__).parents[3] / "shared" / "data" / "lightfields"  # beside the checkout


def texture(height: int, width: int, seed: int) -> NDArray[np.uint8]:
    """Random texture with detail at several scales, RGB."""
    rng = np.random.default_rng(seed)
    out = np.zeros((height, width, 3), np.float32)
    for cells, share in ((6, 0.35), (16, 0.35), (40, 0.3)):
        small = rng.random(
            (max(2, height // (256 // cells) + 1), max(2, width // (256 // cells) + 1), 3)
        ).astype(np.float32)
        out += share * cv2.resize(small, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.asarray(np.clip(out * 220 + 20, 0, 255), np.uint8)


_painted = lru_cache(maxsize=16)(texture)


@lru_cache(maxsize=16)
def _places(height: int, width: int) -> NDArray[np.float32]:
    return np.mgrid[:height, :width].astype(np.float32)


def view(
    x: float,
    y: float,
    height: int = 96,
    width: int = 128,
    near_px: float = 2.0,
    far_px: float = -1.0,
) -> NDArray[np.uint8]:
    """What a camera (x, y) steps from the middle sees, uint8 (height, width, 3): a far wall, a
    middle and a near shape.
    """
    yy, xx = _places(height, width)
    out = np.empty((height, width, 3), np.uint8)
    for seed, d, disc in (
        (1, far_px, None),
        (2, (near_px + far_px) / 2, (0.3, 0.35, 0.2)),
        (3, near_px, (0.62, 0.6, 0.22)),
    ):
        # What stands at x in the middle view stands at x - d * step here, so x here shows x + d *
        # step of the layer.
        at_x, at_y = xx + np.float32(d * x), yy + np.float32(d * y)
        painted = _painted(height * 2, width * 2, seed)
        if disc is None:
            cv2.remap(painted, at_x + width / 2, at_y + height / 2, cv2.INTER_LINEAR, dst=out)
            continue
        seen = cv2.remap(painted, at_x + width / 2, at_y + height / 2, cv2.INTER_LINEAR)
        away = cv2.magnitude(at_x - disc[0] * width, at_y - disc[1] * height)
        inside = away < disc[2] * min(height, width) * 1.3
        cv2.copyTo(seen, inside.view(np.uint8), out)
    return out


@lru_cache(maxsize=8)
def views(
    rows: int,
    cols: int,
    height: int = 96,
    width: int = 128,
    near_px: float = 2.0,
    far_px: float = -1.0,
) -> NDArray[np.uint8]:
    """Canonical views of a grid, uint8 (rows, cols, height, width, 3). Not to be written to."""
    out = np.empty((rows, cols, height, width, 3), np.uint8)
    for r, c in np.ndindex(rows, cols):
        x, y = c - (cols - 1) / 2, r - (rows - 1) / 2
        out[r, c] = view(x, y, height, width, near_px, far_px)
    out.setflags(write=False)
    return out


def wall(rows: int, cols: int, height: int, width: int, step_px: int = 2) -> NDArray[np.uint8]:
    """Views of one textured wall, uint8 (rows, cols, height, width, 3), which moves by step_px from
    view to view.
    """
    painted = texture(height + step_px * rows, width + step_px * cols, 4)
    tops, lefts = step_px * np.arange(rows), step_px * np.arange(cols)
    return np.array(
        [[painted[top : top + height, left : left + width] for left in lefts] for top in tops]
    )


def middle_disparity(
    height: int = 96, width: int = 128, near_px: float = 2.0, far_px: float = -1.0
) -> NDArray[np.float32]:
    """True disparity of the middle view of `views` with odd rows and cols."""
    yy, xx = np.mgrid[:height, :width].astype(np.float32)
    out = np.full((height, width), far_px, np.float32)
    for d, x, y, r in (((near_px + far_px) / 2, 0.3, 0.35, 0.2), (near_px, 0.62, 0.6, 0.22)):
        out[np.hypot(xx - x * width, yy - y * height) < r * min(height, width) * 1.3] = d
    return out


def write(path: Path, rgb: NDArray[Any]) -> Path:
    """A picture file of RGB or grey values; returns its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), rgb if rgb.ndim == 2 else cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
    return path


def read(path: Path, flags: int = cv2.IMREAD_COLOR_RGB) -> NDArray[np.uint8]:
    """The picture of a file, RGB unless flags say otherwise."""
    picture = cv2.imread(str(path), flags)
    assert picture is not None, path
    return np.asarray(picture, np.uint8)


def without(folder: Path, *names: str) -> Path:
    """Removes files of a folder; returns it."""
    for name in names:
        (folder / name).unlink()
    return folder


def write_grid(
    folder: Path, grid: NDArray[Any], name: str = "view_{r:02d}_{c:02d}.png", **more: Any
) -> Path:
    """One file per view; name may use r, c (from 0), n (r * cols + c)."""
    for r in range(grid.shape[0]):
        for c in range(grid.shape[1]):
            write(folder / name.format(r=r, c=c, n=r * grid.shape[1] + c, **more), grid[r, c])
    return folder


def write_ppm(path: Path, values: NDArray[np.uint16], full: int) -> None:
    """A binary PPM of 16-bit samples with that maximal value."""
    path.write_bytes(
        f"P6\n{values.shape[1]} {values.shape[0]}\n{full}\n".encode()
        + np.ascontiguousarray(values, ">u2").tobytes()
    )


def mosaic(grid: NDArray[Any]) -> NDArray[Any]:
    """Views (rows, cols, h, w, 3) as one picture of tiles."""
    rows, cols, height, width, planes = grid.shape
    return np.ascontiguousarray(
        grid.transpose(0, 2, 1, 3, 4).reshape(rows * height, cols * width, planes)
    )


TURNS = [GridTransform(*flags) for flags in product((False, True), repeat=3)]


def as_source(grid: np.ndarray, **more: Any) -> SceneSource:
    """A source of unknown order that reads from memory.

    grid: (rows, cols, h, w), or with colours.
    """
    rows, cols, height, width = grid.shape[:4]
    return attrs.evolve(
        SceneSource(
            layout="test",
            path=Path(),
            files=(),
            rows=rows,
            cols=cols,
            read=lambda f, r, c: grid[r, c],
            height_px=height,
            width_px=width,
        ),
        **more,
    )


def turned(grid: np.ndarray, turn: GridTransform) -> np.ndarray:
    """File order that `turn` brings back to canonical order."""
    if turn.rows:
        grid = grid[::-1]
    if turn.cols:
        grid = grid[:, ::-1]
    return grid.swapaxes(0, 1) if turn.transpose else grid


def canonical(source: SceneSource, scene: Scene | None = None) -> np.ndarray:
    """All views of a source in canonical order as the packer places them, uint8 or uint16."""
    turn = orient(source, scene or Scene()).turn
    rows, cols = turn.grid(source.rows, source.cols)
    places = [[turn.file_index(r, c, rows, cols) for c in range(cols)] for r in range(rows)]
    return np.array([[source.read(0, *place) for place in row] for row in places])
