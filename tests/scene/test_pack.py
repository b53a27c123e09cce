"""The pack: what is in it, that it is made whole or not at all, and that two may make it at
once.
"""

import os
import shutil
from collections.abc import Callable
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import pytest

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.render.plan import scores
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.pack import (
    DamagedPackError,
    key_of,
    open_pack,
    packed,
    packs,
    read_manifest,
    remove,
    write_manifest,
)
from lfpipe.scene.packing import pack_scene
from tests.scene import made
from tests.scene.people_sets import far_pair
from tests.scene.writers import Make, files, grid, h5, numbered, one
from tests.support.hostile_files import NO_FILES, at


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return with_truth(tmp_path / "scene", 3)


def with_truth(folder: Path, count: int) -> Path:
    made.write_grid(folder, made.views(count, count), "input_Cam{n:03d}.png")
    made.write(folder / "gt_disp_lowres.pfm", made.middle_disparity())
    return folder


def pictures(field: LightField) -> np.ndarray:
    """(rows, cols, height, width, channels)."""
    return np.asarray(field.views[0].transpose(0, 1, 3, 4, 2))


def left_over(scene: config.Scene) -> list[str]:
    return [
        path.name
        for path in (Path(scene.cache_dir) / "scenes").iterdir()
        if path.name.startswith(".")
    ]


def test_a_pack_holds_the_views_planar_and_the_disparity_and_is_made_once(
    folder: Path, scene_config: config.Scene
) -> None:
    seen: list[tuple[str, int, int]] = []

    def pack() -> LightField:
        seen.clear()
        return pack_scene(folder, scene_config, scores, lambda *report: seen.append(report))

    assert packed(folder, scene_config) is None
    field = pack()
    assert np.array_equal(pictures(field), made.views(3, 3)) and not field.views.flags.writeable
    assert field.disparity is not None and field.disparity.shape == (1, 3, 3, 48, 64)
    assert (field.disparity_min_px, field.disparity_max_px, field.disparity_source) == (
        -1.0,
        2.0,
        "truth",
    )
    wrong = np.abs(
        field.disparity[0, 1, 1] * np.float32(field.disparity_scale_px)
        - made.middle_disparity()[::2, ::2]
    )
    assert np.median(wrong) < 0.15 and np.mean(wrong > 0.7) < 0.15  # the rims of the shapes
    assert (
        field.method in ("warp", "warp2")
        and field.manifest.scores["warp"] > field.manifest.scores["nearest"]
    )
    assert [report for report in seen if report[0] == "views"][-1] == ("views", 9, 9) and left_over(
        scene_config
    ) == []
    assert pack().name == "scene" and seen == []
    made.write(folder / "input_Cam004.png", made.views(3, 3)[0, 0])
    assert pack().folder != field.folder


VIEWS = made.views(3, 3)
GREY = np.repeat(made.views(4, 4, 48, 64)[..., :1], 3, axis=-1)
DEEP = GREY.astype(np.uint16) * 4


def write_deep(folder: Path) -> Path:
    """Views of 10 bits."""
    for r, c in np.ndindex(DEEP.shape[:2]):
        made.write_ppm(folder / f"{r:03d}_{c:03d}.ppm", DEEP[r, c], 1023)
    return folder


ONE_COLOURED = GREY.copy()
ONE_COLOURED[1, 1, 5, 5] = (1, 2, 3)  # not among the views looked at first
FILM = [made.mosaic(made.views(2, 3, 64, 80, near)) for near in (2.0, 1.5)]
# a scene, settings, what its pack has, and its views
PACKS: dict[str, tuple[Make, dict[str, Any], dict[str, Any], np.ndarray | None]] = {
    # depth inverted: truth follows with its sign
    "both flipped": (
        partial(with_truth, count=3),
        {"flip": "both"},
        {"disparity_source": "truth", "disparity_min_px": -2.0, "disparity_max_px": 1.0},
        VIEWS[::-1, ::-1],
    ),
    "rows flipped": (
        partial(with_truth, count=3),
        {"flip": "rows"},
        {"disparity_source": "estimated"},
        VIEWS[::-1],
    ),
    # packed as it lies, and shown as its pictures say
    "a reversed grid": (
        grid(made.views(5, 5)[::-1, ::-1]),
        {},
        {"depth_inverted": True, "manifest.orientation.depth_order_sure": True},
        made.views(5, 5),
    ),
    "an lf.h5 with depth": (
        h5(VIEWS[:, ::-1], depth=(10 / (made.middle_disparity() + 3)).astype(np.float32)),
        {},
        {"disparity_source": "truth"}
        | {"disparity_min_px": pytest.approx(-1), "disparity_max_px": pytest.approx(2)},
        VIEWS,
    ),
    "10 bits of grey, with gamma": (
        write_deep,
        {"gamma": 2.0, "flip": "none", "transpose": "no"},
        {"channels": 1, "manifest.bit_depth": 10, "manifest.gamma": 2.0},
        np.rint(255 * np.sqrt(DEEP[..., :1] / 1023)),
    ),
    "one coloured view": (grid(ONE_COLOURED), {}, {"channels": 3}, None),
    "a film": (
        numbered(FILM),
        {},
        {"frames": 2, "frame_rate_hz": 25.0, "disparity.shape": (2, 2, 3, 32, 40)},
        None,
    ),
    "one picture": (
        one("photo.png", made.texture(60, 80, 3)),
        {},
        {"rows": 1, "cols": 1, "disparity": None, "method": "nearest"},
        None,
    ),
    "a pair that is too far apart": (
        lambda f: files(x_left_png=far_pair(240)[0], x_right_png=far_pair(240)[1])(f),
        {},
        {"method": "nearest", "disparity": None, "complete": True}
        | {"disparity_max_px": pytest.approx(290, abs=90)},
        None,
    ),
}


@pytest.mark.parametrize("kind", PACKS)
def test_a_pack_has_what_its_scene_and_settings_say(
    tmp_path: Path, scene_config: config.Scene, kind: str
) -> None:
    make, settings, expected, views = PACKS[kind]
    field = pack_scene(make(tmp_path), attrs.evolve(scene_config, **settings))
    for name, value in expected.items():
        assert attrgetter(name)(field) == value, name
    assert views is None or np.array_equal(pictures(field), views)


@pytest.mark.parametrize("row", [0, 2], ids=["corner", "middle"])
def test_a_missing_view_is_a_copy_of_the_nearest_and_told(
    tmp_path: Path, scene_config: config.Scene, row: int
) -> None:
    views = made.views(5, 5)
    folder = made.without(made.write_grid(tmp_path, views), f"view_{row:02d}_{row:02d}.png")
    field = pack_scene(folder, attrs.evolve(scene_config, flip="none"))
    told = f"1 of 5x5 views missing, copied from others: row {row} column {row}"
    assert any(told in note for note in field.manifest.notes)
    assert np.argwhere(~field.present).tolist() == [[row, row]]
    near = (row - 1, row) if row else (row, row + 1)
    assert field.disparity is not None
    for stored in (field.views, field.disparity):
        assert np.array_equal(stored[0, row, row], stored[0, *near])


def _other_version(pack: Path) -> None:
    """Whole."""
    write_manifest(pack, attrs.evolve(read_manifest(pack), version=99))


DAMAGES: dict[str, Callable[[Path], object]] = {
    **{
        f"no {name}": at(name, Path.unlink)
        for name in ("views.npy", "disparity.npy", "manifest.json")
    },
    "another version": _other_version,
    "cut": lambda pack: os.truncate(pack / "views.npy", 1000),
    "empty manifest": lambda pack: (pack / "manifest.json").write_text("{}"),
    **{
        f"{kind} as {name}": at(name, make)
        for kind, make in NO_FILES.items()
        for name in ("views.npy", "manifest.json")
    },
}


def test_a_damaged_pack_is_refused_and_made_again(
    folder: Path, scene_config: config.Scene, tmp_path: Path
) -> None:
    pack = Path(pack_scene(folder, scene_config).folder)
    for kind, damage in DAMAGES.items():
        damaged = shutil.copytree(pack, tmp_path / kind.replace("/", " "))
        damage(damaged)
        with pytest.raises(DamagedPackError, match="not a usable pack"):
            open_pack(damaged)
    assert open_pack(pack).complete
    os.truncate(pack / "views.npy", 1000)
    assert np.array_equal(pictures(pack_scene(folder, scene_config)), made.views(3, 3))


def test_what_cannot_be_finished_leaves_nothing(folder: Path, scene_config: config.Scene) -> None:
    data = (folder / "input_Cam008.png").read_bytes()
    (folder / "input_Cam008.png").write_bytes(data[:2000] + bytes(100) + data[2100:])
    with pytest.raises(UserError, match=r"input_Cam008\.png.*truncated"):
        pack_scene(folder, scene_config)
    assert left_over(scene_config) == [] and packs(scene_config) == []
    assert packed(folder, scene_config) is None


def test_a_pack_in_use_stays_until_nobody_has_it_open(
    folder: Path, scene_config: config.Scene
) -> None:
    pack_scene(folder, scene_config)
    found = packs(scene_config)[0].folder
    field = open_pack(found)
    assert not remove(found) and open_pack(found).rows == 3
    del field
    assert remove(found) and packs(scene_config) == []
    with pytest.raises(DamagedPackError, match="not a usable pack"):
        open_pack(found)


def test_a_scene_whose_files_changed_has_another_key(
    folder: Path, scene_config: config.Scene
) -> None:
    for path in (folder, folder.parent):  # the scene, and a folder of scenes
        before = key_of(path, scene_config)
        assert before == key_of(path, scene_config)
        os.utime(min(folder.rglob("*.png")), ns=(1, path == folder))
        assert key_of(path, scene_config) != before


def test_the_first_picture_needs_the_views_in_the_middle_only(
    tmp_path: Path, scene_config: config.Scene
) -> None:
    grid = made.views(5, 5)
    folder = with_truth(tmp_path / "scene", 5)
    seen = list[LightField]()

    def stop(pack: Path) -> None:
        field = open_pack(pack)
        assert not field.complete
        assert np.array_equal(pictures(field)[2, 2], grid[2, 2])
        assert np.array_equal(pictures(field)[0, 0], grid[1, 2]), "a copy of the nearest one"
        seen.append(field)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pack_scene(folder, scene_config, views_ready=stop)
    whole = pack_scene(folder, scene_config)
    assert whole.complete and np.array_equal(pictures(whole), grid)
    assert whole.folder == seen[0].folder and left_over(scene_config) == []


def test_only_packs_are_removed(tmp_path: Path, scene_config: config.Scene) -> None:
    mine = made.write_grid(tmp_path / "mine" / "boxes", made.views(2, 2, 24, 32))
    pack = Path(pack_scene(mine, scene_config).folder)
    (pack / "manifest.json").write_text("damaged")
    (pack.with_name("notes")).mkdir()
    (pack.with_name("2" * 24)).symlink_to(mine)
    (pack.parents[1] / "notes.txt").write_text("mine")
    (damaged,) = packs(scene_config)
    assert damaged.manifest is None and remove(damaged.folder)
    assert sorted(path.name for path in pack.parent.iterdir()) == ["2" * 24, "notes"]
    assert (pack.parents[1] / "notes.txt").exists() and len(list(mine.iterdir())) == 4
