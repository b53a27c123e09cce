"""Pictures are placed by their camera poses in a `transforms.json`."""

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


Frames = list[Any]


@pytest.mark.parametrize(
    ("change", "views", "said"),
    [
        (lambda frames: frames[2].pop("transform_matrix"), 6, "without a pose"),
        (lambda frames: frames[2].update(file_path=3), 6, "without a pose"),
        (lambda frames: frames[2].update(transform_matrix=[[1, 2], [3]]), 6, "without a pose"),
        (lambda frames: frames[2].update(transform_matrix=[[1e308] * 4] * 4), 6, "without a pose"),
        (lambda frames: frames[2].update(file_path="/home/me/images/0002.png"), 7, "placed by"),
        (lambda frames: frames[2].update(file_path="C:\\me\\scan\\images\\0002.png"), 7, ""),
        (lambda frames: frames[2].update(file_path="../images/0002"), 7, ""),
        (lambda frames: frames[2].update(file_path="images/0099.png"), 6, "without a pose"),
        (lambda frames: frames.append("x"), 7, ""),
        (lambda frames: frames.append({**frames[3], "file_path": "test/7.png"}), 7, ""),
        (lambda frames: frames[2]["transform_matrix"].reverse(), 0, "different directions"),
        (lambda frames: [frame.pop("file_path") for frame in frames], 0, "have a picture here"),
    ],
)
def test_poses_that_are_there_are_used_and_others_are_named_with_the_reason(
    tmp_path: Path, change: Callable[[Frames], object], views: int, said: str
) -> None:
    file = posed(tmp_path, made.views(1, 7), [3, 1, 0, 5, 6, 2, 4]) / "transforms.json"
    poses = json.loads(file.read_text())
    change(poses["frames"])
    file.write_text(json.dumps(poses))
    source = layouts.describe(tmp_path, config.Scene())
    assert (source.layout, source.cols) == (("poses", views) if views else ("numbered", 7))
    assert any(said in note and "transforms.json" in note for note in source.notes) or any(
        said in note and "0002.png" in note for note in source.notes
    )
