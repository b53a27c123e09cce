"""The protocol of angular super-resolution: luma and PSNR as scikit-image's, the views that papers
keep.
"""

from functools import partial
from pathlib import Path

import attrs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.bench import table as metrics
from lfpipe.bench.results import Results
from lfpipe.bench.table import Protocol, measure_scenes
from lfpipe.render.plan import psnr_db
from lfpipe.scene.lightfield import LightField
from tests.bench.inputs import wall
from tests.support.examples import examples


@examples(15)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(56, 90),
    st.integers(56, 90),
    st.floats(0.1, 60),
    st.integers(0, 22),
)
def test_luma_and_psnr_are_those_of_scikit_image(
    seed: int, height: int, width: int, noise: float, border_px: int
) -> None:
    # here, because it takes longer to import than all of lfpipe
    from skimage.color import rgb2ycbcr
    from skimage.metrics import peak_signal_noise_ratio

    rng = np.random.default_rng(seed)
    a = rng.integers(0, 256, (3, height, width), np.uint8)
    b = np.clip(a + rng.normal(0, noise, a.shape), 0, 255).astype(np.uint8)
    luma = [metrics.studio_luma(p) for p in (a, b)]
    theirs = [rgb2ycbcr(p.transpose(1, 2, 0))[..., 0] for p in (a, b)]
    np.testing.assert_allclose(luma, theirs, rtol=0, atol=1e-11)
    x, y = (metrics.shaved(one, border_px) for one in luma)
    if (x != y).any():
        assert psnr_db(float(np.mean((x - y) ** 2))) == pytest.approx(
            peak_signal_noise_ratio(x, y, data_range=255),  # type: ignore[no-untyped-call]
            abs=1e-10,
        )
    assert metrics.ssim(x, x) == 1.0 and (metrics.ssim(x, y) < 1.0) == (x != y).any()


def _run(fields: list[LightField], protocol: Protocol | None = None) -> Results:
    scenes = [(Path(f"s{k}"), partial(attrs.evolve, field)) for k, field in enumerate(fields)]
    return measure_scenes(scenes, protocol or Protocol(border_px=8), lambda *_: None)


def test_methods_beside_each_other() -> None:
    field = wall(9, 9, 96)
    rows = _run([field]).rows
    assert [row.curve for row in rows] == ["nearest", "blend", "warp", "warp2"]
    assert all(row.parameter == "wall, 2x2 -> 7x7" and row.value("ms") > 0 for row in rows)
    db = {row.curve: row.value("psnr_db") for row in rows}
    assert db["warp2"] > db["blend"] > db["nearest"]
    views, maps = 4 * 3 * 96 * 96 / 1e6, 4 * 48 * 48 / 1e6
    assert [row.value("mb") for row in rows] == pytest.approx([views, views] + [views + maps] * 2)
    other = _run([field], Protocol(3, 8, timed=False)).rows
    assert other[0].name == "nearest, wall, 3x3 -> 7x7" and "ms" not in other[0].values
    flat = _run([wall(3, 3, 64, disparity=False)])
    assert [row.curve for row in flat.rows] == [
        "nearest",
        "blend",
    ] and not flat.failures, "no warps without disparity"
    assert "2x2 -> 3x3" in flat.rows[0].name
