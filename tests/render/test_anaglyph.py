"""Anaglyph methods compared with their published matrices in floating point, without shortcuts."""

import numpy as np
import pytest
from numpy.typing import NDArray

from lfpipe.render.synthesis.anaglyph import (
    LEAKS,
    MATRICES,
    decoded,
    encode,
    encoded,
    recipe,
)

GLASSES = sorted(MATRICES)
CROSSED = [name for name in GLASSES if name.startswith("dubois")]
Picture = NDArray[np.uint8]


def exact(left: Picture, right: Picture, name: str, light: str) -> NDArray[np.float64]:
    """The method by its matrix, float64 BGR code values 0..255."""
    linear = light == "linear" and name in CROSSED
    both = [p[..., ::-1] / 255 for p in (left, right)]
    if linear:
        both = [decoded(p) for p in both]
    matrix = np.array(MATRICES[name])  # (channel, eye, rgb)
    mixed = np.clip(both[0] @ matrix[:, 0].T + both[1] @ matrix[:, 1].T, 0, 1)
    value: NDArray[np.float64] = (encoded(mixed) if linear else mixed)[..., ::-1] * 255
    return value


def lit_channels(name: str) -> NDArray[np.bool_]:
    """(3,) red, green and blue: False where the matrix has an empty row."""
    return np.abs(np.array(MATRICES[name])).sum(axis=(1, 2)) > 0  # type: ignore[no-any-return]


@pytest.mark.parametrize("name", GLASSES)
@pytest.mark.parametrize(("light", "ghost_compensation"), [("linear", 0.0), ("gamma", 40.0)])
def test_encode_keeps_greys_at_every_level(
    name: str, light: str, ghost_compensation: float
) -> None:
    grey = np.repeat(np.arange(256, dtype=np.uint8)[:, None, None], 3, axis=2)
    picture = encode(grey, grey, recipe(name, light, ghost_compensation))
    lit = lit_channels(name)[::-1]  # BGR
    np.testing.assert_array_equal(picture[..., lit], grey[..., lit])
    assert not picture[..., ~lit].any()


@pytest.mark.parametrize("name", GLASSES)
@pytest.mark.parametrize("light", ["linear", "gamma"])
def test_encode_is_close_to_the_exact_matrix(name: str, light: str) -> None:
    rng = np.random.default_rng(3)  # moderate colours, as photographs have them
    grey, colour = rng.uniform(30, 220, (2, 16, 16, 1)), rng.uniform(-30, 30, (2, 16, 16, 3))
    left, right = np.rint(grey + colour).clip(0, 255).astype(np.uint8)
    error = np.abs(encode(left, right, recipe(name, light)) - exact(left, right, name, light))
    assert error.mean() < 0.6
    assert error.max() < (6 if name in CROSSED else 1)


def test_ghost_compensation_cancels_the_leak_through_the_red_glass() -> None:
    assert recipe("dubois-amber-blue", "linear", 100.0) == recipe(
        "dubois-amber-blue", "linear", 0.0
    )
    left = np.full((1, 256, 3), 128, np.uint8)
    right = np.repeat(np.arange(256, dtype=np.uint8)[None, :, None], 3, axis=2)
    for name in ("colour", "grey", "half-colour", "wimmer"):
        seen = {}
        for strength in (0.0, 50.0, 100.0):
            picture = decoded(encode(left, right, recipe(name, "linear", strength)) / 255.0)
            through_red = picture[..., 2] + LEAKS[name][0][1] / LEAKS[name][0][0] * picture[..., 1]
            seen[strength] = float(np.ptp(through_red))
        assert seen[100.0] < 0.05 * seen[0.0]
        assert seen[50.0] == pytest.approx(seen[0.0] / 2, rel=0.1)
