"""A picture in an area: whole, centred, undistorted."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.files.decoding import fit_area
from lfpipe.render.pair_layout import scale_into

sides, small = st.integers(1, 4000), st.integers(4, 40)


@given(sides, sides, sides, sides)
def test_the_picture_fills_one_direction_and_keeps_its_aspect(pw: int, ph: int, aw: int, ah: int) -> None:
    x, y, w, h = fit_area((pw, ph), (aw, ah))
    assert min(x, y) >= 0 and x + w <= aw and y + h <= ah and (w == aw or h == ah)
    assert abs(x - (aw - w - x)) <= 1 and abs(y - (ah - h - y)) <= 1
    scale = min(aw / pw, ah / ph)
    assert max(abs(w - max(1, pw * scale)), abs(h - max(1, ph * scale))) <= 0.5 + 1e-6


@given(small, small, st.integers(0, 255))
def test_scaling_keeps_the_neighbours_and_a_flat_colour(w: int, h: int, value: int) -> None:
    memory, wanted = (np.full((h + 2, w + 2, 4), 7, np.uint8) for _ in range(2))
    wanted[1:-1, 1:-1] = value
    scale_into(np.full((16, 16, 4), value, np.uint8), memory[1:-1, 1:-1])
    np.testing.assert_array_equal(memory, wanted)
