"""Views between the stored ones: exact on the grid, continuous off it, right on a scene with known
depth, sane on nonsense; and blocks of 2x2 pixels against the same thing done pixel by pixel.
"""

import attrs
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from lfpipe.config.quality import WARPS
from lfpipe.render.plan import psnr_db
from lfpipe.render.synthesis import warper
from lfpipe.render.synthesis.engine import Synthesiser
from lfpipe.render.synthesis.scene_views import SceneViews, size_of
from lfpipe.render.synthesis.viewpoint import Position
from lfpipe.render.synthesis.warper import Blocks, places
from lfpipe.scene.lightfield import LightField
from tests.render import rendered
from tests.render.rendered import METHODS
from tests.support.examples import examples


def made(
    field: LightField,
    method: str,
    position: Position,
    zero_plane_px: float = 0.0,
    channels: int = 1,
) -> NDArray[np.uint8]:
    outs = [np.zeros((field.height_px, field.width_px), np.uint8) for _ in range(channels)]
    sources = [lambda frame, r, c, k=k: field.views[frame, r, c, k] for k in range(channels)]
    planes = Synthesiser(SceneViews(field), method).render(
        position, 0, zero_plane_px, sources, outs
    )
    return np.stack([plane.copy() for plane in planes])


def scores(field: LightField, position: Position, scale: float) -> dict[str, float]:
    """PSNR of every method against the view drawn for position, 16 px off the border: what enters
    there was never seen.
    """
    row, col = (
        scale * (p - (count - 1) / 2)
        for p, count in zip(position, (field.rows, field.cols), strict=True)
    )
    inner = (slice(None), slice(16, -16), slice(16, -16))
    truth = rendered.view(row, col, field.height_px, field.width_px)[:1].astype(float)[inner]
    return {
        method: psnr_db(float(np.mean((made(field, method, position)[inner] - truth) ** 2)))
        for method in METHODS
    }


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("channels", [1, 2, 3])
def test_synthesiser_at_stored_views_is_exact(method: str, channels: int) -> None:
    regular = rendered.field(3, 4)
    offsets = np.random.default_rng(1).uniform(-0.2, 0.2, (3, 4, 2)).astype(np.float32)
    for field in (regular, attrs.evolve(regular, offsets=offsets)):
        for row, col in np.ndindex(3, 4):
            np.testing.assert_array_equal(
                made(field, method, (row, col), 0.0, channels), field.views[0, row, col, :channels]
            )


def test_synthesiser_uses_the_offsets_of_cameras() -> None:
    """Views drawn at offset places come out right between them only if the offsets are used, and
    used with their sign.
    """
    field = rendered.field(3, 3, 96, 96)
    offsets = np.random.default_rng(5).uniform(-0.4, 0.4, (3, 3, 2)).astype(np.float32)
    views = field.views.copy()
    for row, col in np.ndindex(3, 3):
        views[0, row, col] = rendered.view(
            offsets[row, col, 0] + row - 1, offsets[row, col, 1] + col - 1, 96, 96
        )
    field = attrs.evolve(field, views=views)
    knowing = attrs.evolve(field, offsets=offsets)
    middle = offsets[:2, :2].mean(axis=(0, 1)) - 0.5  # of the four cameras around (0.5, 0.5)
    # within the square: its edges moved too, its stored disparities did not
    inner = (slice(None), slice(24, 40), slice(24, 40))
    truth = rendered.view(middle[0], middle[1], 96, 96)[:1].astype(float)[inner]

    def error(subject: LightField) -> float:
        return psnr_db(float(np.mean((made(subject, "warp", (0.5, 0.5))[inner] - truth) ** 2)))

    assert error(knowing) > 40
    assert error(knowing) > error(field) + 6


@pytest.mark.parametrize(
    ("side", "scale", "position"),
    [
        # beyond the grid the warp goes on
        *((5, 2.0, place) for place in ((2.0, -1.0), (4.5, 2.0), (5.0, 5.0))),
        *(
            (3, scale, place)
            for scale in (5.0, 8.0)
            for place in ((1.5, 1.5), (1.0, 0.5), (0.5, 2.0), (1.0, -1.0), (1.0, 0.3))
        ),
    ],
)
def test_synthesiser_warps_keep_their_lead_where_parts_are_hidden(
    side: int, scale: float, position: Position
) -> None:
    """Near and far part by up to 24 px: the warp must neither copy the square into what it uncovers
    nor lose its front edge.
    """
    found = scores(rendered.field(side, side, 96, 96, scale=scale), position, scale)
    assert min(found[method] for method in WARPS) > found["nearest"] + 5


@pytest.mark.parametrize("method", WARPS)
def test_synthesiser_in_bands_makes_the_same_picture(
    method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    fields = rendered.field(3, 3, scale=4.0), rendered.noise(3, 3, 37, 41, 30.0, seed=1)
    places = (0.3, 1.6), (1.0, 2.4), (-0.7, 0.5)
    whole = [made(field, method, place, 0.5, 3) for field in fields for place in places]
    monkeypatch.setattr(
        warper, "bands_of", lambda rows, _: [slice(k, min(k + 7, rows)) for k in range(0, rows, 7)]
    )
    banded = [made(field, method, place, 0.5, 3) for field in fields for place in places]
    for one, other in zip(whole, banded, strict=True):
        np.testing.assert_array_equal(one, other)


SIZES = [(1, 1), (1, 6), (5, 1), (2, 2), (7, 9), (8, 12)]


def through(
    plane: NDArray[np.uint8], dx: NDArray[np.float32], dy: NDArray[np.float32]
) -> NDArray[np.uint8]:
    """plane, each block displaced by its (dx, dy)."""
    subject = Blocks(*plane.shape)
    x, y = places(*plane.shape)
    drawn = np.empty((*x.shape, 4), np.uint8)
    out = np.full(plane.shape, 99, np.uint8)
    reach = subject.reach(slice(0, len(y)), float(np.abs(dy).max()))
    subject.sample(plane, x + dx, y + dy, reach, drawn)
    subject.pixels(drawn, out)
    return out


@examples(60)
@given(st.sampled_from(SIZES), st.integers(0, 1000), st.sampled_from([0.0, 0.6, 3.0, 100.0]))
def test_blocks_sample_as_pixels_do_beyond_the_border_too(
    size: tuple[int, int], seed: int, reach_px: float
) -> None:
    height, width = size
    rng = np.random.default_rng(seed)
    plane = rng.integers(0, 256, size, np.uint8)
    dx, dy = rng.uniform(-reach_px, reach_px, (2, *size_of(height, width))).astype(np.float32)
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    each_x, each_y = (
        np.repeat(np.repeat(d, 2, axis=0), 2, axis=1)[:height, :width] for d in (dx, dy)
    )
    wanted = cv2.remap(
        plane, x + each_x, y + each_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    error = np.abs(through(plane, dx, dy).astype(int) - wanted).max()
    assert error <= (reach_px > 0), (
        "the margin shifts the rounding of coordinates; where nothing moves the plane comes back"
    )
