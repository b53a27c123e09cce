"""Pictures in an area, and views of two eyes in a screen's own pixels: whole rows, whole halves, shapes kept."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.files.decoding import fit_area
from lfpipe.render.pair_layout import laid_out, scale_into

LEFT, RIGHT = (10, 20, 200), (220, 120, 30)


def pair(size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    return np.full((size[1], size[0], 3), LEFT, np.uint8), np.full((size[1], size[0], 3), RIGHT, np.uint8)


@pytest.mark.parametrize("view", [(64, 64), (300, 200)])
@pytest.mark.parametrize("screen", [(160, 90), (161, 91), (50, 120)])
@pytest.mark.parametrize("first_row", [0, 1])
def test_every_row_of_the_screen_is_one_eyes(view: tuple[int, int], screen: tuple[int, int], first_row: int) -> None:
    memory = np.ones((screen[1], screen[0], 3), np.uint8)
    out = laid_out(pair(view), "row-interleaved", screen, first_row, memory)
    assert out is memory and laid_out(pair(view), "row-interleaved", (7, 9), first_row, memory).shape == (9, 7, 3)
    for row in range(screen[1]):
        shown = out[row][out[row].any(axis=1)]
        assert (shown == (LEFT, RIGHT)[(first_row + row) % 2]).all(), row
    rows, cols = out.any(axis=(1, 2)).sum(), out.any(axis=(0, 2)).sum()
    assert cols / rows == pytest.approx(view[0] / view[1], abs=0.06 * view[0] / view[1])


@pytest.mark.parametrize("screen", [(160, 90), (200, 200), (320, 100)])
def test_each_half_when_stretched_is_its_view_in_its_own_shape(screen: tuple[int, int]) -> None:
    out = laid_out(pair((60, 40)), "side-by-side", screen)
    for eye, colour in enumerate((LEFT, RIGHT)):
        stretched = out[:, eye * screen[0] // 2 : (eye + 1) * screen[0] // 2].repeat(2, axis=1)
        assert (stretched[stretched.any(axis=2)] == colour).all()
        rows, cols = np.nonzero(stretched.any(axis=(1, 2)))[0], np.nonzero(stretched.any(axis=(0, 2)))[0]
        assert np.ptp(cols) / np.ptp(rows) == pytest.approx(1.5, abs=0.05)
        assert abs(cols.mean() - (screen[0] - 1) / 2) <= 2 and abs(rows.mean() - (screen[1] - 1) / 2) <= 1, "in its middle"


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
