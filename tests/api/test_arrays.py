"""Light fields as arrays: the same pictures as from files, and mistakes with their remedy."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfpipe
from tests.scene import made
from tests.support.hostile_sequences import made_sequence
from tests.support.refusal import refusal

VIEWS = made.wall(2, 3, 40, 48)


@pytest.fixture
def cache(tmp_path: Path) -> dict[str, Any]:
    return {"scene.cache_dir": str(tmp_path / "cache")}


def test_open_scene_of_an_array_gives_the_pictures_of_its_files(
    tmp_path: Path, cache: dict[str, Any]
) -> None:
    np.savez(tmp_path / "a.npz", views=VIEWS)
    files = lfpipe.open_scene(
        made.write_grid(tmp_path / "png", VIEWS),
        cache | {"scene.flip": "none", "scene.transpose": "no"},
    )
    for scene in (VIEWS, tmp_path / "a.npz"):
        field = lfpipe.open_scene(scene, cache)
        assert (field.rows, field.cols, field.method) == (2, 3, files.method)
        for place in ((0, 0), (1, 2), (0.5, 1.25)):
            np.testing.assert_array_equal(
                lfpipe.render_view(field, *place), lfpipe.render_view(files, *place)
            )
    report = lfpipe.replay(made_sequence(tmp_path / "walk"), VIEWS, settings=cache)
    assert (report["scene"]["rows"], report["scene"]["cols"]) == (2, 3)


@pytest.mark.parametrize(
    "change",
    [
        lambda v: v[None],
        lambda v: v[..., :1],
        lambda v: v.astype(np.uint16) * 257,
        lambda v: v.astype(">u2") * 257,  # big-endian
        lambda v: v / np.float32(255),
        lambda v: v.astype(np.float32),
        lambda v: v.astype(np.float64).tolist(),
    ],
)
def test_open_scene_takes_every_documented_form(change: Any, cache: dict[str, Any]) -> None:
    given_as = change(VIEWS / 255 if "tolist" in change.__code__.co_names else VIEWS)
    field = lfpipe.open_scene(given_as, cache, invert_depth=False)
    shown = lfpipe.render_view(field, 1, 2, method="nearest")
    grey = np.asarray(given_as).shape[-1] == 1
    expected = np.repeat(VIEWS[1, 2, ..., :1], 3, axis=2) if grey else VIEWS[1, 2, ..., ::-1]
    assert np.abs(shown.astype(int) - expected).max() <= 1


def test_open_scene_takes_a_light_field_and_its_views(cache: dict[str, Any]) -> None:
    field = lfpipe.open_scene(VIEWS, cache)
    assert repr(field) == f"<LightField {field.name!r}: 2x3 views of 48x40, method {field.method}>"
    with lfpipe.open_scene(field, cache) as again:
        assert (again.folder, again.method) == (field.folder, field.method)
    again.close()
    planes = refusal(lfpipe.open_scene, field.views, cache)
    assert "planes" in planes.message and "np.moveaxis(views, 3, -1)" in planes.remedy
    copy = lfpipe.open_scene(np.moveaxis(field.views, 3, -1), cache)
    np.testing.assert_array_equal(copy.views, field.views)


def test_open_scene_takes_disparity_and_positions(cache: dict[str, Any], tmp_path: Path) -> None:
    disparity = np.full((2, 3, 40, 48), 1.0, np.float32)  # the pictures say 2
    positions = np.stack([*np.mgrid[0:2, 0:3]], axis=-1) * 12.5
    field = lfpipe.open_scene(VIEWS, cache, disparity=disparity, positions=positions)
    # the given one, not an estimate
    assert field.disparity is not None and np.unique(field.disparity).size == 1
    turned = lfpipe.open_scene(VIEWS[::-1, ::-1], cache, positions=positions[::-1, ::-1])
    np.testing.assert_array_equal(
        lfpipe.render_view(turned, 0, 0, method="nearest"), VIEWS[0, 0, ..., ::-1]
    )
    assert "only arrays have" in str(refusal(lfpipe.open_scene, tmp_path, disparity=disparity))
