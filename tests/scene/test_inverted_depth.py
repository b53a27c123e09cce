"""Depth is inverted without packing: state of the session, remembered for the scene, the
same bits as a turned pack.
"""

from pathlib import Path

import attrs
import numpy as np
import pytest

from lfpipe import config
from lfpipe.config import Render
from lfpipe.config.tree import Decision, Method
from lfpipe.render.synthesis.compositor import Compositor
from lfpipe.scene import lightfield
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.packer import facts
from lfpipe.scene.packing import pack_scene
from tests.scene import made

PLACES = [
    ((1.2, 1.3), (1.2, 3.4)),
    ((0.0, 0.5), (0.0, 2.5)),
    ((2.0, 2.0), (2.0, 2.0)),
    ((3.9, -0.7), (3.9, 1.5)),
]


@pytest.fixture(autouse=True)
def _own_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made.write_grid(tmp_path_factory.mktemp("scene") / "views", made.views(5, 5))


def pictures(field: LightField, method: Method) -> list[np.ndarray]:
    compositor = Compositor(field, Render(method=method, zero_plane_px=0.3))
    return [compositor.compose(*place).copy() for place in PLACES]


def test_inverted_it_is_bit_for_bit_a_pack_of_the_turned_grid(
    scene: Path, scene_config: config.Scene
) -> None:
    pack = pack_scene(scene, attrs.evolve(scene_config, flip="none"))
    turned = pack_scene(scene, attrs.evolve(scene_config, flip="both"))
    inverted = pack.inverted()
    assert (
        turned.manifest.key != pack.manifest.key
        and inverted.manifest.flips == turned.manifest.flips
    )
    assert np.array_equal(inverted.views, turned.views)
    assert inverted.disparity is not None and turned.disparity is not None
    stored = (
        inverted.disparity * inverted.disparity_scale_px,
        turned.disparity * turned.disparity_scale_px,
    )
    assert np.array_equal(*stored)
    assert (
        inverted.disparity_min_px == turned.disparity_min_px
        and inverted.disparity_max_px == turned.disparity_max_px
    )
    assert inverted.border_px == turned.border_px == pytest.approx((1.0, 1.0), abs=0.2)
    for method in ("nearest", "blend", "warp", "warp2"):
        for a, b in zip(pictures(inverted, method), pictures(turned, method), strict=True):
            assert np.array_equal(a, b), method
    assert not np.array_equal(pictures(pack, "warp2")[0], pictures(inverted, "warp2")[0])


def test_unknown_disparity_stays_unknown() -> None:
    from tests.render import rendered

    field = rendered.field(3, 3)
    assert field.disparity is not None
    field.disparity[:, :, :, :16, :16] = -128
    twice = field.inverted().inverted()
    for a, b in zip(pictures(field, "warp2"), pictures(twice, "warp2"), strict=True):
        assert np.array_equal(a, b)
    negated = np.where(field.disparity == -128, -128, -field.disparity.astype(int)).astype(np.int8)
    by_hand = attrs.evolve(
        field.inverted(),
        disparity=negated[:, ::-1, ::-1],
        disparity_scale_px=field.disparity_scale_px,
        depth_inverted=False,
    )
    for a, b in zip(pictures(field.inverted(), "warp2"), pictures(by_hand, "warp2"), strict=True):
        assert np.array_equal(a, b)


def test_the_choice_is_remembered_for_the_scene_and_the_setting_wins(
    scene: Path, scene_config: config.Scene
) -> None:
    def turned(setting: Decision = "auto") -> bool:
        return pack_scene(scene, attrs.evolve(scene_config, invert_depth=setting)).depth_inverted

    field = pack_scene(scene, scene_config)
    plain = field.depth_inverted
    lightfield.remember(field, "asked")
    assert turned() == plain, "a question is no answer"
    for word in ("yes", "no"):
        lightfield.remember(field, word)
        assert turned() == (word == "yes") and turned("yes") and not turned("no")
        again = pack_scene(scene, scene_config)
        flips = facts(again.manifest, again.folder)["flips"]
        assert flips["rows"] == flips["cols"] == (word == "yes")
    assert len(list((Path(scene_config.cache_dir) / "scenes").iterdir())) == 1, (
        "nothing is packed again"
    )
    for content in (b"perhaps", b"\xff\xfe", b"x" * 100):
        next(lightfield.folder().iterdir()).write_bytes(content)
        assert turned() == plain
