"""The order of a line of pictures is that of the motion between them, whatever the names say."""

import copy
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfpipe import config
from lfpipe.scene import layouts
from lfpipe.scene.analysis import analyse_scene
from lfpipe.scene.layouts._order import motion_order
from lfpipe.scene.layouts._running import MAX_PICTURES
from tests.scene import made
from tests.scene.people_sets import circle, floor
from tests.scene.test_plausibility import held_by_hand
from tests.scene.writers import walk

COUNT = 9
LINES = {
    **{
        f"{px} px": made.views(1, COUNT, 144, 192, px, -px / 2)[0, ..., 1] for px in (0.3, 2.0, 8.0)
    },
    "a column": made.views(COUNT, 1, 144, 192)[:, 0, ..., 1],
    "a wall": made.wall(1, COUNT, 144, 192)[0, ..., 1],
    "a floor": np.array(floor(COUNT))[..., 1],
    "held by hand": held_by_hand(np.array(made.views(1, COUNT, 144, 192)))[0, ..., 1],
}
ORDERS = {
    "as they are": range(COUNT),
    "the counter rolls over": [*range(5, COUNT), *range(5)],
    "from the middle to both sides": [4, *range(5, COUNT), *range(3, -1, -1)],
    "at random": np.random.default_rng(3).permutation(COUNT),
    "two swapped": [0, 1, 2, 4, 3, *range(5, COUNT)],
}


@pytest.mark.parametrize("kind", LINES)
@pytest.mark.parametrize("by", ORDERS)
def test_the_order_is_proven_or_nothing_is_said(kind: str, by: str) -> None:
    names = [int(place) for place in ORDERS[by]]
    order, astray = motion_order(lambda at: LINES[kind][names[at]], list(range(COUNT)))
    found = [names[at] for at in order]
    assert found in ([], list(range(COUNT)), list(range(COUNT))[::-1])
    assert found or kind == "held by hand" or (kind, by) == ("0.3 px", "at random")
    if by == "as they are":
        assert order == list(range(COUNT)) and astray is None


def test_a_step_to_no_neighbour_is_noticed_although_the_flow_fits() -> None:
    wall = made.wall(1, 40, 192, 256)[0, ..., 1]
    names = [*range(20, 40), *range(20)]
    assert motion_order(lambda at: wall[names[at]], list(range(40)))[0] == [
        *range(20, 40),
        *range(20),
    ]


def test_a_long_line_that_turns_back_is_noticed() -> None:
    count = 2 * MAX_PICTURES + 10
    there_and_back = [*range(count // 2), *range(count // 2, 0, -1)]
    line = made.views(1, count // 2 + 1, 60, 80)[0, ..., 1]
    order, astray = motion_order(lambda at: line[there_and_back[at]], list(range(count)))
    assert order == [] and astray == pytest.approx(count // 2, abs=3)


@pytest.mark.parametrize(
    "views",
    [
        walk(made.views(3, 3)),
        walk(made.views(4, 5), "snake"),
        walk(made.views(7, 2)),
        circle(12),
        [made.texture(96, 128, seed) for seed in range(6)],
    ],
)
def test_what_is_no_line_keeps_the_order_of_its_names(views: Sequence[np.ndarray]) -> None:
    positions = list(range(len(views)))
    assert motion_order(lambda at: views[at][..., 1], positions)[0] in ([], positions)


def test_names_that_roll_over_are_put_in_order(tmp_path: Path) -> None:
    numbers = [9997, 9998, 9999, 1, 2]
    for number, view in zip(numbers, made.views(1, 5, 144, 192)[0], strict=True):
        made.write(tmp_path / f"DSC_{number:04d}.JPG", view)
    found = analyse_scene(tmp_path, config.Scene())
    assert [int(path.stem[4:]) for path in found.source.files] == numbers
    assert "DSC_9997.JPG, DSC_9998.JPG" in found.source.notes[0]
    stated = layouts.describe(tmp_path, config.Scene(grid="1x5"))
    assert [int(path.stem[4:]) for path in stated.files] == sorted(numbers)


def test_an_order_that_is_not_proven_is_doubted(tmp_path: Path) -> None:
    line = made.views(1, 9, 144, 192)[0]
    for number, at in enumerate([0, 1, 2, 4, 2, 1, 0]):
        view = np.clip(line[at] * (1 + 0.02 * number), 0, 255).astype(np.uint8)
        made.write(tmp_path / f"{number}.png", view)
    assert "takes the names' order" in analyse_scene(tmp_path, config.Scene()).source.doubt


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
