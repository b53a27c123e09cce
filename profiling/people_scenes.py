"""Scenes as people keep them, for profiling/people_folders.py.

Real light fields of the sample data and drawn ones, with every view in a known place, are written out under many names, in many
orders and shapes, disturbed as real captures are, with other files beside them; and what is no light field at all.
"""

from collections.abc import Callable, Iterator
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np

from lfpipe import config
from lfpipe.scene import layouts
from lfpipe.scene.source import Turn
from tests.scene import made

Grid = Any  # uint8 (rows, cols, h, w, 3), canonical order
Make = Callable[[Path], Path]
TURNS = [Turn(*flags) for flags in product((False, True), repeat=3)]
FACES = made.SAMPLES.parent / "faces"


@attrs.frozen(eq=False)
class Case:
    """make writes the scene below a folder and returns its path. true: None where it is no light field."""

    group: str
    kind: str
    make: Make
    true: Grid | None = None


@lru_cache(maxsize=2)
def real(name: str, wide_px: int = 300) -> Grid:
    """A sample scene in canonical order, small; the dark columns of a plenoptic camera are left out."""
    source = layouts.describe(made.SAMPLES / name, config.Scene())
    turn, first = source.turn or Turn(), 1 if name == "lytro_illum_field" else 0
    out = []
    for row, col in product(range(source.rows), range(first, source.cols)):
        view = source.read(0, *turn.file_index(row, col, source.rows, source.cols))
        shade = view.astype(np.float32) / source.max_value
        view = np.rint(255 * (np.sqrt(shade) if shade.mean() < 0.2 else shade)).astype(np.uint8)
        scale = min(1.0, wide_px / view.shape[1])
        out.append(cv2.resize(view, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
    return np.array(out).reshape(source.rows, source.cols - first, *out[0].shape)


# Names by row, column (from 0), running number and their counts; "/" makes folders.
NAMES: dict[str, Callable[..., str]] = {
    "row folders": lambda r, c, n: f"row_{r + 1:02d}/img_{c + 1:02d}.jpg",
    "bare folders": lambda r, c, n: f"{r}/{c}.png",
    "column folders": lambda r, c, n: f"col{c}/row{r}.png",
    "row folders of a camera": lambda r, c, n: f"Row {chr(65 + r)}/DSC{n + 4711:05d}.JPG",
    "bare numbers": lambda r, c, n: f"{n + 1}.png",
    "camera": lambda r, c, n: f"DSC_{n + 87:04d}.JPG",
    "phone, by the second": lambda r, c, n: f"IMG_20260704_{153000 + 100 * (3 * n // 60) + 3 * n % 60}.jpg",
    "phone, by the ms": lambda r, c, n: f"PXL_20260704_{153000 + 100 * (3 * n // 60) + 3 * n % 60}{(n * 371) % 1000:03d}.jpg",
    "WhatsApp": lambda r, c, n: f"WhatsApp Image 2026-07-04 at 15.{30 + n // 30:02d}.{2 * (n % 30):02d}.jpeg",
    "Windows copies": lambda r, c, n: f"photo ({n + 1}).jpg",
    "Windows copies, first bare": lambda r, c, n: f"photo ({n}).jpg" if n else "photo.jpg",
    "Mac copies": lambda r, c, n: f"shot {n + 1}.png" if n else "shot.png",
    "unicode": lambda r, c, n: f"光场_{r:02d}_{c:02d}.png",
    "accents": lambda r, c, n: f"été, n° {r + 1}-{c + 1}.png",
    "chess": lambda r, c, n: f"{chr(97 + c)}{r + 1}.png",
    "rows and columns": lambda r, c, n: f"Row {r + 1} Column {c + 1}.tif",
    "brackets": lambda r, c, n: f"img[{r}][{c}].webp",
    "commas": lambda r, c, n: f"cam({r},{c}).bmp",
    "three digits": lambda r, c, n: f"{100 * (r + 1) + c + 1}.png",
    "four digits": lambda r, c, n: f"L{r:02d}{c:02d}.png",
    "uv": lambda r, c, n: f"u{c}v{r}.png",
    "centred": lambda r, c, n: f"lf_y{r - 2:+03d}_x{c - 2:+03d}.png",
    "Blender": lambda r, c, n: f"Camera_{r:03d}_{c:03d}0001.png",
    "mixed suffixes": lambda r, c, n: f"view_{r}_{c}" + (".jpg", ".JPG", ".jpeg", ".Jpg")[n % 4],
    "hash behind": lambda r, c, n: f"{r:02d}_{c:02d}_{(n * 2654435761) % 2**32:08x}.png",
    "resolution in the name": lambda r, c, n: f"scan_1920x1080_{n:03d}.png",
    "date before": lambda r, c, n: f"2026-07-04 garden {r + 1} {c + 1}.jpg",
}
GRID_NAMES = [name for name, make in NAMES.items() if make(1, 2, 7) != make(2, 1, 7)]
RUN_NAMES = [name for name in NAMES if name not in GRID_NAMES]


def written(folder: Path, grid: Grid, name: Callable[..., str], order: str = "rows", leave_out: Any = lambda r, c: False) -> Path:
    """order: in which a running number goes through the grid."""
    rows, cols = grid.shape[:2]
    places = list(product(range(rows), range(cols)))
    if order == "columns":
        places = [(r, c) for c in range(cols) for r in range(rows)]
    elif order == "snake":
        places = [(r, cols - 1 - c if r % 2 else c) for r, c in places]
    elif order == "reversed":
        places = places[::-1]
    for n, (r, c) in enumerate(places):
        if not leave_out(r, c):
            made.write(folder / name(r, c, n), grid[r, c])
    return folder


def disturbed(grid: Grid, how: str, seed: int) -> Grid:
    rng = np.random.default_rng(seed)
    rows, cols, height, width = grid.shape[:4]
    out = grid.copy()
    shift = int(rng.choice([-5, -3, 3, 5]))
    for r, c in product(range(rows), range(cols)):
        view = out[r, c]
        if how == "noise":
            view = np.clip(view + rng.normal(0, 10, view.shape), 0, 255).astype(np.uint8)
        elif how == "jpeg":
            view = cv2.imdecode(cv2.imencode(".jpg", view, [cv2.IMWRITE_JPEG_QUALITY, 35])[1], cv2.IMREAD_COLOR)
        elif how == "flicker":
            view = np.clip(view * rng.uniform(0.9, 1.1), 0, 255).astype(np.uint8)
        elif how in ("converging", "hand-held"):
            down, across = rng.normal(0, 0.7, 2) if how == "hand-held" else (shift * (r - rows // 2), shift * (c - cols // 2))
            turn = cv2.getRotationMatrix2D((width / 2, height / 2), rng.normal(0, 0.3) if how == "hand-held" else 0, 1)
            turn[:, 2] += across, down
            view = cv2.warpAffine(view, turn, (width, height), borderMode=cv2.BORDER_REFLECT)
        elif how == "soft":
            view = cv2.GaussianBlur(view, (0, 0), 3)
        out[r, c] = view
    if how == "cropped":
        out = out[:, :, height // 4 : height // 4 * 3, width // 4 : width // 4 * 3]
    return np.ascontiguousarray(out)


DISTURBED = ["none", "noise", "jpeg", "flicker", "converging", "hand-held", "soft", "cropped"]
SHAPES = {"all": (9, 9, 1), "3x5": (3, 5, 1), "5x3": (5, 3, 1), "4x4": (4, 4, 2), "1xN": (1, 9, 1), "Nx1": (9, 1, 1)}


def part(grid: Grid, shape: str, seed: int) -> Grid:
    rows, cols, step = SHAPES[shape]
    rows, cols = min(rows, -(-len(grid) // step)), min(cols, -(-grid.shape[1] // step))
    rng = np.random.default_rng(seed)
    top, left = (int(rng.integers(0, have - (count - 1) * step)) for have, count in zip(grid.shape, (rows, cols), strict=False))
    return grid[top:, left:][: (rows - 1) * step + 1 : step, : (cols - 1) * step + 1 : step]


def turned(grid: Grid, turn: Turn) -> Grid:
    grid = grid[::-1] if turn.rows else grid
    grid = grid[:, ::-1] if turn.cols else grid
    return grid.swapaxes(0, 1) if turn.transpose else grid


def reordered(group: str, scene: str, grid: Grid, number: int, sizes: list[str]) -> Case:
    """The scene in one of the shapes, disturbances, orders and names, all of them in turn."""
    rng = np.random.default_rng(number)
    shape, how = sizes[number % len(sizes)], DISTURBED[int(rng.integers(len(DISTURBED)))]
    true = disturbed(part(grid, shape, number), how, number)
    runs = bool(rng.integers(2))
    name = (RUN_NAMES if runs else GRID_NAMES)[int(rng.integers(len(RUN_NAMES if runs else GRID_NAMES)))]
    order = ["rows", "rows", "columns", "snake", "reversed"][int(rng.integers(5))] if runs else "rows"
    turn = TURNS[int(rng.integers(4 if runs or "row" in name.lower() else 8))]
    if turn.transpose and "col" in name:
        turn = Turn()
    files = turned(true, turn)
    turns = "".join(str(int(on)) for on in (turn.rows, turn.cols, turn.transpose))
    kind = f"{scene}, {true.shape[0]}x{true.shape[1]}, {how}; {name}, {order}, turned {turns}"
    return Case(group, kind, lambda folder: written(folder, files, NAMES[name], order), true)


def shining(rows: int, cols: int) -> Grid:
    return (0.6 * made.views(rows, cols, 120, 160) + 0.4 * made.views(rows, cols, 120, 160, -3.0, -5.0)).astype(np.uint8)


def plain_shapes(rows: int, cols: int) -> Grid:
    """Three discs of one colour each before a wall of one colour."""
    out = np.full((rows, cols, 160, 220, 3), 200, np.uint8)
    for r, c in product(range(rows), range(cols)):
        for d, x, y, size, colour in (
            (-1, 60, 60, 40, (40, 90, 200)),
            (1, 140, 90, 45, (200, 60, 40)),
            (3, 90, 120, 25, (30, 160, 60)),
        ):
            cv2.circle(out[r, c], (x - d * (c - cols // 2), y - d * (r - rows // 2)), size, colour, -1, cv2.LINE_AA)
    return out


def drawn() -> Iterator[tuple[str, Grid]]:
    yield "tiny parallax", made.views(5, 5, 150, 200, 0.15, -0.1)
    yield "large parallax", made.views(5, 5, 240, 320, 18.0, 4.0)
    yield "all in front", made.views(5, 7, 150, 200, 6.0, 3.0)
    yield "all behind", made.views(4, 6, 150, 200, -2.0, -7.0)
    yield "shining through", shining(5, 5)
    yield "plain shapes", plain_shapes(5, 5)
    yield "flat wall", np.ascontiguousarray(made.views(5, 5, 120, 160, 1.0, 1.0))
    yield "17x17", made.views(17, 17, 60, 80, 1.0, -0.5)
    yield "2x9", made.views(2, 9, 120, 160)
    yield "1x40", made.views(1, 40, 90, 120, 0.8, -0.4)
    yield "12x1", made.views(12, 1, 90, 120)
