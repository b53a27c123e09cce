"""Light fields as arrays: the same pictures as from files, and mistakes with their remedy."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import lfpipe
from lfpipe.scene.layouts.arrays import require_views
from tests.hostile_sequences import made_sequence


@pytest.fixture
def cache(tmp_path: Path) -> dict[str, Any]:
    return {"scene.cache_dir": str(tmp_path / "cache")}


def _views(rows: int = 2, cols: int = 3, size: tuple[int, int] = (40, 48), seed: int = 0) -> np.ndarray:
    """A smooth picture that moves by 2 px from view to view, red first."""
    wide = cv2.GaussianBlur(np.random.default_rng(seed).integers(0, 256, (size[0] + 20, size[1] + 20, 3), np.uint8), (0, 0), 2)
    crop = [[wide[2 * r : 2 * r + size[0], 2 * c : 2 * c + size[1]] for c in range(cols)] for r in range(rows)]
    return np.array(crop)


def test_an_array_gives_the_pictures_of_its_files(tmp_path: Path, cache: dict[str, Any]) -> None:
    views = _views()
    (tmp_path / "png").mkdir()
    for row, col in np.ndindex(2, 3):
        cv2.imwrite(str(tmp_path / "png" / f"view_{row:02d}_{col:02d}.png"), views[row, col, ..., ::-1])
    np.save(tmp_path / "a.npy", views)
    np.savez(tmp_path / "a.npz", views=views)
    files = lfpipe.open_scene(tmp_path / "png", cache | {"scene.flip": "none", "scene.transpose": "no"})
    for scene in (views, tmp_path / "a.npy", tmp_path / "a.npz"):
        field = lfpipe.open_scene(scene, cache)
        assert (field.rows, field.cols, field.method) == (2, 3, files.method)
        for place in ((0, 0), (1, 2), (0.5, 1.25)):
            np.testing.assert_array_equal(lfpipe.render_view(field, *place), lfpipe.render_view(files, *place))
    report = lfpipe.replay(made_sequence(tmp_path / "walk"), views, settings=cache)
    assert (report["scene"]["rows"], report["scene"]["cols"]) == (2, 3)


@pytest.mark.parametrize(
    "change",
    [
        lambda v: v[None],
        lambda v: v[..., :1],
        lambda v: v.astype(np.uint16) * 257,
        lambda v: v / np.float32(255),
        lambda v: v.astype(np.float32),
        lambda v: v.astype(np.float64).tolist(),
    ],
)
def test_every_documented_form_is_taken(change: Any, cache: dict[str, Any]) -> None:
    views = _views()
    given_as = change(views / 255 if "tolist" in change.__code__.co_names else views)
    field = lfpipe.open_scene(given_as, cache, half_turn=False)
    shown = lfpipe.render_view(field, 1, 2, method="nearest")
    grey = np.asarray(given_as).shape[-1] == 1
    expected = np.repeat(views[1, 2, ..., :1], 3, axis=2) if grey else views[1, 2, ..., ::-1]
    assert np.abs(shown.astype(int) - expected).max() <= 1


def test_disparity_and_positions_come_with_an_array(cache: dict[str, Any], tmp_path: Path) -> None:
    disparity = np.full((2, 3, 40, 48), 2.0, np.float32)
    positions = np.stack(np.mgrid[0:2, 0:3], axis=-1) * 12.5
    field = lfpipe.open_scene(_views(), cache, disparity=disparity, positions=positions)
    assert field.disparity is not None and np.unique(field.disparity).size == 1  # the given one, not an estimate
    with pytest.raises(lfpipe.UserError, match="only for arrays"):
        lfpipe.open_scene(tmp_path, disparity=disparity)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    shape=st.lists(st.integers(0, 5), min_size=0, max_size=7).map(tuple),
    kind=st.sampled_from(["u1", "u2", "f4", "i8", "?", "c16"]),
)
def test_any_array_is_taken_or_refused(shape: tuple[int, ...], kind: str) -> None:
    views = np.zeros(shape, kind)
    good = len(shape) in (5, 6) and shape[-1] in (1, 3) and 0 not in shape and kind in ("u1", "u2", "f4")
    try:
        assert require_views(views, "x").ndim == 6 and good
    except lfpipe.UserError as error:
        assert error.remedy and not good


def test_damaged_files_are_refused(cache: dict[str, Any], tmp_path: Path) -> None:
    np.save(tmp_path / "whole.npy", _views())
    whole = (tmp_path / "whole.npy").read_bytes()
    np.save(tmp_path / "objects.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    np.savez(tmp_path / "other.npz", a=np.zeros(3), b=np.zeros(3))
    nan = np.full((1, 2, 8, 8, 3), np.nan, np.float32)
    np.save(tmp_path / "nan.npy", nan)
    for name, data in (("short.npy", whole[:500]), ("cut.npy", whole[:50]), ("text.npz", b"PK\3\4 nothing"), ("empty.npy", b"")):
        (tmp_path / name).write_bytes(data)
    for name in ("short.npy", "cut.npy", "text.npz", "empty.npy", "objects.npy", "other.npz", "nan.npy"):
        with pytest.raises(lfpipe.UserError) as caught:
            lfpipe.open_scene(tmp_path / name, cache)
        assert caught.value.remedy, name
