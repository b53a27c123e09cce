"""Views and disparities at the size at which they are drawn."""

import threading
from concurrent.futures import ThreadPoolExecutor

import attrs
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from lfpipe.config import Config, Render
from lfpipe.config.tree import Method
from lfpipe.render.plan import psnr_db
from lfpipe.render.synthesis.compositor import Compositor
from lfpipe.render.synthesis.scene_views import reduced_disparity
from lfpipe.render.viewer.viewer import Canvas, Viewer
from lfpipe.scene.lightfield import UNKNOWN
from tests.render import rendered

SIZES = st.tuples(st.integers(1, 40), st.integers(1, 40))


@given(
    levels=st.tuples(st.integers(-127, 127), st.integers(-127, 127)),
    mask=arrays.arrays(np.bool_, SIZES),
    unknown=arrays.arrays(np.bool_, SIZES),
    share=st.floats(0.1, 1),
)
def test_reduced_disparity_never_averages_across_an_edge(
    levels: tuple[int, int], mask: np.ndarray, unknown: np.ndarray, share: float
) -> None:
    near, far = max(levels), min(levels)
    whole = np.where(mask, np.int8(near), np.int8(far))
    hidden = cv2.resize(unknown.astype(np.uint8), mask.shape[::-1], interpolation=cv2.INTER_NEAREST)
    whole = np.where(hidden.astype(bool), np.int8(UNKNOWN), whole)
    size = tuple(max(1, round(n * share)) for n in mask.shape[::-1])
    found = reduced_disparity(whole, size, edge=8.0).astype(int)
    if near - far > 16:
        assert set(np.unique(found)) <= {near, far, UNKNOWN} | {
            value for value in range(far, near + 1) if min(near - value, value - far) <= 8
        }
    if not hidden.any():
        assert UNKNOWN not in found
    if hidden.all():
        assert (found == UNKNOWN).all()


@pytest.mark.parametrize("method", rendered.METHODS)
@pytest.mark.parametrize("share", [0.7, 0.4])
def test_a_reduced_picture_is_the_full_one_reduced(method: Method, share: float) -> None:
    field = rendered.field(3, 3, 240, 200)
    how = Render(method=method, anaglyph="dubois", zero_plane_px=0.5)
    size_px = round(200 * share), round(240 * share)
    full, small = Compositor(field, how), Compositor(field, how, size_px=size_px)
    for left, right in ((0.0, 1.0), (0.3, 0.9), (1.4, 2.0)):
        places = (0.6, left), (0.6, right)
        whole = cv2.resize(full.compose(*places), size_px, interpolation=cv2.INTER_AREA)
        error = small.compose(*places).astype(float) - whole
        assert psnr_db(float(np.mean(error**2))) > 35


def test_viewer_draws_what_the_screen_shows_and_never_waits_for_it() -> None:
    shown = [(100, 120)]
    field = rendered.field(3, 3, 240, 200)
    with ThreadPoolExecutor(1) as preparer:
        viewer = Viewer(
            field,
            Config(render=Render(method="warp2")),
            canvas=Canvas(shown_px=lambda _: shown[-1], preparer=preparer),
        )
        assert viewer.compositor.size_px == (100, 120)
        viewer.viewpoints(rendered.record(), 0, 0)
        assert viewer.full_picture().shape == (240, 200, 3)
        gate = threading.Event()
        preparer.submit(gate.wait)
        shown.append((50, 60))
        assert not viewer.update_compositor() and viewer.compositor.size_px == (100, 120)
        gate.set()
        preparer.submit(int).result()  # after the preparation
        assert viewer.update_compositor()
        assert viewer.compositor.size_px == (50, 60)
        viewer.set_quality(attrs.evolve(viewer.config, render=Render(method="nearest")), share=0.5)
        preparer.submit(int).result()
        assert viewer.update_compositor() and viewer.compositor.method == "nearest"
        assert viewer.compositor.size_px == (25, 30)
        shown.append((2000, 2400))  # nothing is drawn larger than it is
        viewer.set_quality(viewer.config)
        preparer.submit(int).result()
        assert viewer.update_compositor() and viewer.compositor.size_px == (200, 240)
