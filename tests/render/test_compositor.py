"""From eyes to pixels: directions of motion, promises of a key, every output, nonsense input; and
views of two eyes in a screen's
own pixels: whole rows, whole halves, shapes kept.
"""

import weakref
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import attrs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from lfpipe.config import Config, Render
from lfpipe.config.tree import Anaglyph, Method
from lfpipe.render.synthesis.anaglyph import MATRICES, arrange_stereo_pair, encode, recipe
from lfpipe.render.synthesis.compositor import Compositor
from lfpipe.render.viewer.viewer import Viewer
from lfpipe.scene.lightfield import UNKNOWN
from tests.render import rendered
from tests.render.rendered import METHODS, OUTPUTS
from tests.support.examples import examples

ANY = st.floats(allow_nan=True, allow_infinity=True)
# the left eye stands at larger x of the unmirrored picture
SEATED = np.array([[350.0, 240.0], [290.0, 240.0]])


def bgr(field: Any, row: int, col: int, frame: int = 0) -> NDArray[np.uint8]:
    planes = np.broadcast_to(field.views[frame, row, col], (3, field.height_px, field.width_px))
    return np.ascontiguousarray(planes[::-1].transpose(1, 2, 0))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("anaglyph", sorted(MATRICES))
def test_compose_at_stored_views_is_their_anaglyph_bit_for_bit(
    method: Method, anaglyph: Anaglyph
) -> None:
    field = rendered.field(3, 4)
    how = Render(method=method, anaglyph=anaglyph, ghost_compensation=30.0)
    wanted = encode(bgr(field, 1, 0), bgr(field, 1, 3), recipe(anaglyph, how.light, 30.0))
    np.testing.assert_array_equal(Compositor(field, how).compose((1.0, 0.0), (1.0, 3.0)), wanted)


def test_compose_for_screens_without_glasses() -> None:
    field = rendered.field(3, 5)
    left, middle, right = (bgr(field, 1, col) for col in (1, 2, 3))

    def picture(anaglyph: Anaglyph) -> NDArray[np.uint8]:
        return (
            Compositor(field, Render(method="warp", anaglyph=anaglyph))
            .compose((1.0, 1.0), (1.0, 3.0))
            .copy()
        )

    np.testing.assert_array_equal(picture("mono"), middle)
    side = picture("side-by-side")
    assert side.shape == left.shape
    for half, whole in ((side[:, :32], left), (side[:, 32:], right)):
        narrow = whole.reshape(64, 32, 2, 3).mean(axis=2)
        assert np.abs(half - narrow).max() <= 1


@examples(60)
@given(
    strange=st.lists(st.tuples(ANY, ANY, ANY, ANY, ANY), min_size=1, max_size=4),
    alpha_px=st.sampled_from(["auto", 1e-9, 12.0, 1e9]),
    grid=st.sampled_from([(1, 1), (1, 4), (3, 3)]),
    method=st.sampled_from(METHODS),
    anaglyph=st.sampled_from(OUTPUTS),
)
def test_viewer_takes_whatever_a_tracker_says(
    strange: list[Any], alpha_px: Any, grid: tuple[int, int], method: Method, anaglyph: Anaglyph
) -> None:
    field = rendered.field(*grid, 16, 16)
    how = Render(alpha_px=alpha_px, method=method, anaglyph=anaglyph)
    viewer = Viewer(field, Config(render=how))
    seated = (*SEATED.ravel().tolist(), 0.0)
    for k, (*eyes, velocity) in enumerate((seated, *strange, seated)):
        seen = rendered.record(filtered_px=np.reshape(eyes, (2, 2)), velocity_px_s=velocity)
        look = viewer.viewpoints(seen, k * 10**7, k * 10**7 + 10**6)
        assert np.isfinite([look.left, look.right]).all()
        picture = viewer.compositor.compose(look.left, look.right)
        assert picture.shape == (16, 16, 3)
        if anaglyph not in MATRICES:  # which mix, and so may leave the range
            assert field.views.min() <= picture.min() and picture.max() <= field.views.max()
    # seen well again, later: nothing of that is left
    look = viewer.viewpoints(seen, 10**10, 10**10)
    if grid[1] > 1 and alpha_px != 1e9 and method != "nearest":
        assert look.left[1] < look.right[1]


@pytest.mark.parametrize("method", ["nearest", "warp2"])
@pytest.mark.parametrize("threads", [2, 3, 8])
@pytest.mark.parametrize("unknown", [False, True])
def test_compose_with_several_threads_is_the_same_picture(
    method: Method, threads: int, unknown: bool
) -> None:
    field = attrs.evolve(rendered.field(2, 3, 131, 95))
    if unknown:
        disparity = np.array(field.disparity)
        disparity[..., 20:40, 10:30] = UNKNOWN
        field = attrs.evolve(field, disparity=disparity)
    how = Render(method=method, anaglyph="dubois", zero_plane_px=0.4)
    with ThreadPoolExecutor(threads - 1) as helpers:
        one, several = Compositor(field, how), Compositor(field, how, helpers, threads)
        for place in np.random.default_rng(1).uniform(0, 2, (8, 3)).tolist():
            left, right = (place[0] / 2, place[1]), (place[0] / 2, place[2])
            np.testing.assert_array_equal(one.compose(left, right), several.compose(left, right))
    kept = weakref.ref(field)
    del field, one, several
    assert kept() is None, "no cycle keeps a pack mapped until the next garbage collection"


LEFT, RIGHT = (10, 20, 200), (220, 120, 30)


def pair(size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    return np.full((size[1], size[0], 3), LEFT, np.uint8), np.full(
        (size[1], size[0], 3), RIGHT, np.uint8
    )


@pytest.mark.parametrize("view", [(64, 64), (300, 200)])
@pytest.mark.parametrize("screen", [(160, 90), (161, 91), (50, 120)])
@pytest.mark.parametrize("first_row", [0, 1])
def test_laid_out_gives_each_row_of_the_screen_to_one_eye(
    view: tuple[int, int], screen: tuple[int, int], first_row: int
) -> None:
    memory = np.ones((screen[1], screen[0], 3), np.uint8)
    out = arrange_stereo_pair(pair(view), "row-interleaved", screen, first_row, memory)
    assert out is memory and arrange_stereo_pair(
        pair(view), "row-interleaved", (7, 9), first_row, memory
    ).shape == (9, 7, 3)
    for row in range(screen[1]):
        shown = out[row][out[row].any(axis=1)]
        assert (shown == (LEFT, RIGHT)[(first_row + row) % 2]).all(), row
    rows, cols = out.any(axis=(1, 2)).sum(), out.any(axis=(0, 2)).sum()
    assert cols / rows == pytest.approx(view[0] / view[1], abs=0.06 * view[0] / view[1])


@pytest.mark.parametrize("anaglyph", OUTPUTS)
def test_each_frame_of_a_video_gets_its_own_picture(anaglyph: Anaglyph) -> None:
    """In every output, also those whose planes are built and kept."""
    still = rendered.field(3, 3)
    assert still.disparity is not None
    video = attrs.evolve(
        still,
        views=np.concatenate((still.views, 255 - still.views)),
        disparity=np.concatenate((still.disparity, still.disparity)),
    )
    drawn = Compositor(video, Render(method="nearest", anaglyph=anaglyph))
    for frame in (0, 1, 0):
        alone = attrs.evolve(video, views=video.views[frame : frame + 1])
        np.testing.assert_array_equal(
            drawn.compose((1.0, 0.0), (1.0, 2.0), frame),
            Compositor(alone, Render(method="nearest", anaglyph=anaglyph)).compose(
                (1.0, 0.0), (1.0, 2.0)
            ),
        )
