"""Photographs of phones: spatial photos, portraits with depth, and others."""

from pathlib import Path

import numpy as np
import pytest

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene.layouts import _CONVERTED, describe
from tests.scene import heic, made

pytest.importorskip("pillow_heif")
SCENE = config.Scene()


@pytest.fixture(scope="module")
def eyes() -> list[heic.Picture]:
    """The left and the right eye's picture."""
    views = made.views(1, 2, 96, 128)
    return [np.ascontiguousarray(view) for view in (views[0, 0], views[0, 1])]


@pytest.mark.parametrize("turned", [False, True])
def test_a_spatial_photo_is_a_pair_in_the_order_of_its_group(
    tmp_path: Path, eyes: list[heic.Picture], turned: bool
) -> None:
    items = (2, 1) if turned else (1, 2)
    path = heic.write(tmp_path / "IMG_0001.HEIC", eyes, group=(b"ster", *items))
    for place in (path, tmp_path):
        source = describe(place, SCENE)
        assert (source.layout, source.rows, source.cols) == ("stereo", 1, 2)
        assert source.certain and source.turn is not None and not source.turn.cols
        for col, item in enumerate(items):
            error = np.abs(source.read(0, 0, col).astype(int) - eyes[item - 1])
            assert error.mean() < 2


def test_a_portrait_is_a_picture_with_depth_whose_white_is_near(
    tmp_path: Path, eyes: list[heic.Picture]
) -> None:
    depth = np.ascontiguousarray(np.tile(np.linspace(0, 255, 128).astype(np.uint8), (96, 1)))
    source = describe(heic.write(tmp_path / "a.heic", eyes[:1], depth=depth), SCENE)
    assert source.layout == "rgbd" and source.truth
    near = next(iter(source.truth.values()))()
    assert near[:, -20:].mean() > near[:, :20].mean()


def test_any_other_is_one_picture_and_a_collection_is_refused(
    tmp_path: Path, eyes: list[heic.Picture]
) -> None:
    source = describe(heic.write(tmp_path / "a.heic", eyes[:1]), SCENE)
    assert (source.layout, source.rows, source.cols) == ("picture", 1, 1)
    assert np.abs(source.read(0, 0, 0).astype(int) - eyes[0]).mean() < 2
    for group in (None, (b"altr", 1, 2)):
        path = heic.write(tmp_path / "burst.heic", [*eyes, eyes[0]], group)
        with pytest.raises(UserError, match="a collection of 3 pictures") as caught:
            describe(path, SCENE)
        assert "heif-convert burst.heic" in caught.value.remedy


@pytest.mark.parametrize("keep", [0.2, 0.6, 0.98])
def test_a_truncated_one_is_refused(tmp_path: Path, eyes: list[heic.Picture], keep: float) -> None:
    path = heic.write(tmp_path / "a.heic", eyes, group=(b"ster", 1, 2))
    path.write_bytes(path.read_bytes()[: int(keep * path.stat().st_size)])
    with pytest.raises(UserError, match=r"a\.heic"):
        describe(path, SCENE).read(0, 0, 0)


def test_what_heif_convert_writes_opens(tmp_path: Path, eyes: list[heic.Picture]) -> None:
    import cv2

    for name, picture in (("a-1.jpg", eyes[0]), ("a-2.jpg", eyes[1])):
        (tmp_path / "pair").mkdir(exist_ok=True)
        cv2.imwrite(str(tmp_path / "pair" / name), picture[..., ::-1])
    assert describe(tmp_path / "pair", SCENE).cols == 2
    remedy = _CONVERTED[".heic", ".heif"][1]
    assert "pip install" in remedy and "heif-convert" in remedy
