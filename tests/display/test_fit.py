"""A picture in an area: whole, centred, undistorted."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.files.decoding import fit_area
from lfpipe.render.pair_layout import scale_into

sides = st.integers(1, 4000)


@given(sides, sides, sides, sides)
def test_the_picture_fills_one_direction_and_keeps_its_aspect(pw: int, ph: int, aw: int, ah: int) -> None:
    x, y, w, h = fit_area((pw, ph), (aw, ah))
    assert x >= 0 and y >= 0 and x + w <= aw and y + h <= ah
    assert w == aw or h == ah
    assert abs(x - (aw - w - x)) <= 1 and abs(y - (ah - h - y)) <= 1
    scale = min(aw / pw, ah / ph)
    assert abs(w - max(1, pw * scale)) <= 0.5 + 1e-6 and abs(h - max(1, ph * scale)) <= 0.5 + 1e-6


@given(st.integers(4, 40), st.integers(4, 40), st.integers(0, 255))
def test_scaling_keeps_the_neighbours_and_a_flat_colour(w: int, h: int, value: int) -> None:
    memory = np.full((h + 2, w + 2, 4), 7, np.uint8)
    scale_into(np.full((16, 16, 4), value, np.uint8), memory[1:-1, 1:-1])
    assert (memory[1:-1, 1:-1] == value).all()
    memory[1:-1, 1:-1] = 7
    assert (memory == 7).all()
