"""Pictures are placed by their camera poses in a `transforms.json`."""

import copy
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfpipe import config
from lfpipe.scene import layouts
from tests.scene import made


def posed(
    folder: Path, grid: np.ndarray, order: Sequence[int], path: str = "images/{}", turn: float = 0.0
) -> Path:
    """A grid of cameras in a world that is turned, whose pictures are numbered in another order."""
    cos, sin = np.cos(turn), np.sin(turn)
    axes = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])[[2, 0, 1]]
    frames = []
    for number, at in enumerate(order):
        r, c = divmod(int(at), grid.shape[1])
        made.write(folder / "images" / f"{number:04d}.png", grid[r, c])
        pose = np.column_stack([axes, axes @ [0.1 * c + 0.01 * r * c, -0.1 * r, 0.003 * c]])
        name = path.format(f"{number:04d}.png")
        frames.append({"file_path": name, "transform_matrix": [*pose.tolist(), [0, 0, 0, 1]]})
    (folder / "transforms.json").write_text(json.dumps({"frames": frames}))
    return folder


@pytest.mark.parametrize("shape", [(1, 7), (5, 1), (3, 4)])
@pytest.mark.parametrize("path", ["images/{}", "./images/{}", "images\\{}"])
def test_poses_beside_the_pictures_place_them(
    tmp_path: Path, shape: tuple[int, int], path: str
) -> None:
    grid = made.views(*shape)
    order = np.random.default_rng(1).permutation(shape[0] * shape[1]).tolist()
    source = layouts.describe(posed(tmp_path, grid, order, path, turn=1.1), config.Scene())
    assert source.layout == "poses" and source.coordinates is not None
    assert np.array_equal(made.canonical(source), grid)
    assert tmp_path / "transforms.json" in source.files


def test_poses_that_form_no_grid_are_left_to_the_names(tmp_path: Path) -> None:
    grid = made.views(1, 7)
    whole = json.loads((posed(tmp_path, grid, range(7)) / "transforms.json").read_text())
    changes: tuple[Callable[[list[Any]], object], ...] = (
        lambda frames: frames[2].pop("transform_matrix"),
        lambda frames: frames[2].update(file_path="../images/0002.png"),
        lambda frames: frames[2].update(file_path=3),
        lambda frames: frames[2].update(transform_matrix=[[1, 2], [3]]),
        lambda frames: frames[2].update(transform_matrix=[[1e308] * 4] * 4),
        lambda frames: frames[2]["transform_matrix"].reverse(),  # looks another way
        lambda frames: frames[2].update(transform_matrix=frames[3]["transform_matrix"]),
        lambda frames: frames.append("x"),
    )
    for change in changes:
        changed = copy.deepcopy(whole)
        change(changed["frames"])
        (tmp_path / "transforms.json").write_text(json.dumps(changed))
        assert layouts.describe(tmp_path, config.Scene()).layout == "numbered"
