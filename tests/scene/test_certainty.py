"""An order reported as sure is right, however the cameras converge, the views blur and noise is added."""

from itertools import product
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfpipe import config
from lfpipe.scene import layouts
from lfpipe.scene.orientation import orient
from lfpipe.scene.source import SceneSource, Turn
from tests.scene import made

AUTO = config.Scene()
TURNS = [Turn(*flags) for flags in product((False, True), repeat=3)]


def disturbed(grid: np.ndarray, kind: int) -> np.ndarray:
    """Cameras that converge elsewhere, noise, blur, or a part of the picture; grid: uint8 (rows, cols, h, w)."""
    rng = np.random.default_rng(kind)
    rows, cols, height, width = grid.shape
    shift, sigma, blur = int(rng.integers(-5, 6)), float(rng.choice([0, 0, 4, 12])), float(rng.choice([0, 0, 3]))
    out = np.empty_like(grid)
    for r, c in product(range(rows), range(cols)):
        move = np.array([[1, 0, shift * (c - cols // 2)], [0, 1, shift * (r - rows // 2)]], np.float32)
        view = cv2.warpAffine(grid[r, c], move, (width, height), borderMode=cv2.BORDER_REPLICATE)
        view = cv2.GaussianBlur(view, (0, 0), blur) if blur else view
        out[r, c] = np.clip(view + rng.normal(0, sigma, view.shape), 0, 255)
    return out


def turned(grid: np.ndarray, turn: Turn) -> np.ndarray:
    grid = grid[::-1] if turn.rows else grid
    grid = grid[:, ::-1] if turn.cols else grid
    return grid.swapaxes(0, 1) if turn.transpose else grid


def sample(path: Path) -> np.ndarray:
    """Up to 5x5 views of a sample scene in canonical order, grey, at most 400 px wide."""
    source = layouts.describe(path, AUTO)
    turn = source.turn or Turn()
    picked = [np.linspace(0, count - 1, min(5, count)).round().astype(int) for count in (source.rows, source.cols)]
    out = []
    for row, col in product(*picked):
        view = source.read(0, *turn.file_index(int(row), int(col), source.rows, source.cols))
        grey = np.asarray(view if view.ndim == 2 else view[..., 1], np.float32) / source.max_value
        grey = np.rint(255 * np.sqrt(grey) if grey.mean() < 0.2 else 255 * grey).astype(np.uint8)
        scale = min(1.0, 400 / grey.shape[1])
        out.append(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
    return np.array(out).reshape(len(picked[0]), len(picked[1]), *out[0].shape)


def judged(scenes: list[np.ndarray], tries: int) -> list[tuple[bool, bool]]:
    """(sure, right) for disturbed and turned copies of the scenes."""
    found = []
    for number, scene in enumerate(scenes):
        for kind in range(tries):
            turn = TURNS[(3 * number + 5 * kind) % 8]
            grid = turned(disturbed(scene, 100 * number + kind), turn)
            rows, cols, height, width = grid.shape
            read = lambda f, r, c, at=grid: np.ascontiguousarray(at[r, c])  # noqa: E731
            source = SceneSource("t", Path(), (), rows, cols, read, height, width)
            told = orient(source, AUTO)
            rows, cols = told.turn.grid(rows, cols)
            order = [[told.turn.file_index(r, c, rows, cols) for c in range(cols)] for r in range(rows)]
            true = [[turn.file_index(r, c, *scene.shape[:2]) for c in range(scene.shape[1])] for r in range(scene.shape[0])]
            found.append((told.sure, order == true))
    return found


def test_certainty_on_made_scenes() -> None:
    depths = [(2.0, -1.0), (3.0, 0.5), (-0.5, -2.5), (1.0, -3.0)]
    scenes = [made.views(5, 5, 144, 192, 1.5 * near, 1.5 * far)[..., 1] for near, far in depths] + [
        made.views(1, 7, 144, 192, 4.5, 0.75)[..., 1]
    ]
    found = judged(scenes, 5)
    assert all(right for sure, right in found if sure)
    assert sum(sure for sure, _ in found) >= 0.4 * len(found)


def test_certainty_on_sample_scenes() -> None:
    paths = sorted(made.SAMPLES.glob("*"))
    if not paths:
        pytest.skip("the sample scenes are not here")
    found = judged([sample(path) for path in paths], 2)
    assert all(right for sure, right in found if sure)
