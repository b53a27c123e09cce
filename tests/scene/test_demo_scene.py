"""The demo's light field: exact by its own geometry, and in the layout that it claims."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene import layouts
from lfpipe.scene.layouts.demo import OFFSET_PX
from lfpipe.scene.pack import DEMO_VERSION, DEMOS, demo_scene


@pytest.mark.parametrize("name", DEMOS)
def test_every_view_follows_from_the_middle_one_by_its_disparity(tmp_path: Path, name: str) -> None:
    """Warped along the true disparity the middle view is the other view, wherever it sees the same;
    unwarped it is not.
    """
    scene = layouts.describe(demo_scene(tmp_path, name, 256), config.Scene())
    y, x = np.mgrid[0:256, 0:256].astype(np.float32)
    middle = scene.read(0, 4, 4)
    middle_d = scene.truth[4, 4]()
    assert (
        np.isfinite(middle_d).all()
        and middle_d.min() == pytest.approx(-1.0)
        and 0.75 < middle_d.max() < 1.05
    )
    known = scene.geometry
    assert known.focal_length_px and known.baseline_mm and known.focus_distance_mm
    at_infinity = known.focal_length_px * known.baseline_mm / known.focus_distance_mm
    assert at_infinity == pytest.approx(OFFSET_PX / 2, rel=1e-4), "half of 512 px"
    for row, col in ((3, 3), (3, 4), (4, 5), (5, 4)):
        other = scene.read(0, row, col).astype(int)
        d = scene.truth[row, col]()
        mx, my = x + d * (col - 4), y + d * (row - 4)
        warped = cv2.remap(middle, mx, my, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE).astype(
            int
        )
        same = np.abs(cv2.remap(middle_d, mx, my, cv2.INTER_NEAREST) - d) < 0.02
        same &= (mx > 1) & (mx < 254) & (my > 1) & (my < 254)
        error, unwarped = np.abs(warped - other)[same].mean(), np.abs(middle - other)[same].mean()
        assert same.mean() > 0.75 and error < 1.5 and error < 0.35 * unwarped


def test_a_cache_that_cannot_be_written_is_the_users_to_fix(tmp_path: Path) -> None:
    (tmp_path / f"demo-{DEMO_VERSION}").write_text("in the way")
    with pytest.raises(UserError, match="cache directory") as refused:
        demo_scene(tmp_path)
    assert "scene.cache_dir" in refused.value.remedy
