"""The shader draws what the processor draws, from equal keys; where it cannot, or no longer, the
processor does. Here a software renderer runs it.
"""

import ctypes
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import attrs
import cv2
import numpy as np
import pytest

from lfpipe.config import Render
from lfpipe.config.tree import Anaglyph
from lfpipe.extras.gpu import painter as subject
from lfpipe.extras.gpu.painter import Gpu, open_gpu
from lfpipe.render.synthesis.compositor import Compositor, open_painters
from lfpipe.render.synthesis.viewpoint import Position
from lfpipe.scene.lightfield import UNKNOWN, LightField
from tests.render import rendered

ALIKE_DB = 45.0
VIEWPOINTS = 20


@pytest.fixture(scope="module")
def thread() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(1) as one:
        yield one


@pytest.fixture(scope="module")
def gpu(thread: ThreadPoolExecutor) -> Gpu:
    opened, words = open_gpu("gpu", thread)
    if opened is None:
        pytest.skip(words)
    return opened


def viewpoints(field: LightField) -> Iterator[tuple[Position, Position]]:
    """Of the left and the right eye: within the grid and somewhat beyond it, on rows and between
    them.
    """
    rng = np.random.default_rng(3)
    for number in range(VIEWPOINTS):
        row = rng.uniform(0, field.rows - 1)
        row = float(round(row)) if number % 3 == 0 else row
        middle = rng.uniform(-0.5, field.cols - 0.5)
        half = rng.uniform(0.1, min(1.5, (field.cols - 1) / 2))
        yield (row, middle - half), (row, middle + half)


def worst_db(gpu: Gpu, field: LightField, how: Render, scale: float = 1.0) -> float:
    """The lowest PSNR of the shader's pictures against the processor's."""
    size_px = round(scale * field.width_px), round(scale * field.height_px)
    exact, drawn = (Compositor(field, how, size_px=size_px, gpu=one) for one in (None, gpu))
    worst = np.inf
    for number, eyes in enumerate(viewpoints(field)):
        key = drawn.key(*eyes, number)
        assert key == exact.key(*eyes, number)
        worst = min(worst, cv2.PSNR(exact.draw(key), drawn.draw(key)))
    assert not gpu.failure
    return worst


def with_unknown(field: LightField) -> LightField:
    assert field.disparity is not None
    disparity = field.disparity.copy()
    disparity[..., : field.width_px // 6] = UNKNOWN
    disparity[..., -5:-2, :] = UNKNOWN
    return attrs.evolve(field, disparity=disparity)


def bent(field: LightField) -> LightField:
    offsets = np.random.default_rng(5).uniform(-0.2, 0.2, field.offsets.shape)
    return attrs.evolve(field, offsets=offsets.astype(np.float32))


SMOOTH = rendered.field(5, 5, 96, 128, texture=0.4)
CASES = {
    "plain": (SMOOTH, 1.0),
    "odd size": (rendered.field(3, 4, 91, 101, texture=0.4), 1.0),
    "one row": (rendered.field(1, 6, 96, 128, texture=0.4), 1.0),
    "far apart": (rendered.field(3, 3, 96, 128, scale=4.0, texture=0.4), 1.0),
    "inverted": (SMOOTH.inverted(), 1.0),
    "unknown": (with_unknown(SMOOTH), 1.0),
    "unknown, inverted": (with_unknown(SMOOTH).inverted(), 1.0),
    "cameras off the grid": (bent(SMOOTH), 1.0),
    "grey": (attrs.evolve(SMOOTH, views=SMOOTH.views[:, :, :, :1]), 1.0),
    "smaller": (with_unknown(SMOOTH), 0.6),
}


@pytest.mark.parametrize("case", CASES)
def test_the_shader_draws_what_the_processor_draws(gpu: Gpu, case: str) -> None:
    field, scale = CASES[case]
    assert worst_db(gpu, field, Render(method="warp2"), scale) >= ALIKE_DB


@pytest.mark.parametrize("anaglyph", ["dubois", "half-colour", "side-by-side", "row-interleaved"])
def test_every_output_is_that_of_the_processor(gpu: Gpu, anaglyph: Anaglyph) -> None:
    for light, compensation in (("linear", 40.0), ("gamma", 0.0)):
        how = Render(
            method="warp",
            anaglyph=anaglyph,
            light=light,  # type: ignore[arg-type]
            ghost_compensation=compensation,
        )
        assert worst_db(gpu, SMOOTH, how) >= ALIKE_DB, light


def test_views_that_do_not_fit_take_the_place_of_others(
    gpu: Gpu, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(subject, "BUDGET_BYTES", 0)
    assert worst_db(gpu, SMOOTH, Render(method="warp2")) >= ALIKE_DB


def test_another_frame_of_a_live_scene_is_uploaded(gpu: Gpu) -> None:
    how = Render(method="warp2")
    drawn = Compositor(SMOOTH, how, gpu=gpu)
    drawn.compose((1.5, 1.2), (1.5, 2.7))
    other = attrs.evolve(SMOOTH, views=255 - SMOOTH.views)
    drawn.replace(other)
    exact = Compositor(other, how).compose((1.5, 1.2), (1.5, 2.7))
    assert cv2.PSNR(exact, drawn.compose((1.5, 1.2), (1.5, 2.7))) >= ALIKE_DB


def test_after_a_lost_context_the_processor_draws(thread: ThreadPoolExecutor, gpu: Gpu) -> None:
    del gpu  # here is one
    lost = Gpu(thread)
    how = Render(method="warp2")
    drawn, exact = Compositor(SMOOTH, how, gpu=lost), Compositor(SMOOTH, how)
    eyes = (1.5, 1.2), (1.5, 2.7)
    assert not np.array_equal(drawn.compose(*eyes), exact.compose(*eyes))
    egl = ctypes.CDLL("libEGL.so.1")
    egl.eglGetCurrentDisplay.restype = ctypes.c_void_p
    release = egl.eglMakeCurrent
    release.argtypes = [ctypes.c_void_p] * 4
    thread.submit(lambda: release(egl.eglGetCurrentDisplay(), None, None, None)).result()
    np.testing.assert_array_equal(drawn.compose(*eyes), exact.compose(*eyes))
    assert lost.failure
    for field in (SMOOTH, rendered.field(3, 3)):  # others do not try it again
        np.testing.assert_array_equal(
            Compositor(field, how, gpu=lost).compose(*eyes),
            Compositor(field, how).compose(*eyes),
        )


def test_without_gpu_or_library_the_processor_draws_and_says_why(
    thread: ThreadPoolExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert open_painters("cpu", thread) == (None, "CPU")
    monkeypatch.setitem(sys.modules, "moderngl", None)
    assert open_painters("gpu", thread) == (None, "CPU: the extra gpu is not installed")
