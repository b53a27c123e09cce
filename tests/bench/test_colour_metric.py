"""The simulated glasses, checked against known facts."""

import numpy as np
import pytest

from lfpipe.bench.glasses import GLASS, RED_CYAN
from lfpipe.render.synthesis.anaglyph import LEAKS, encode, recipe
from profiling.anaglyph import (
    GREEN_MAGENTA,
    Encoder,
    ghost,
)


def encoder(name: str, light: str = "linear", ghost_compensation: float = 0.0) -> Encoder:
    how = recipe(name, light, ghost_compensation)
    return lambda left, right: encode(left, right, how)


@pytest.mark.parametrize(
    ("name", "compensation", "least", "most"),
    [
        ("colour", 0.0, 0.146, 0.150),  # green light through the red glass
        ("dubois", 0.0, -0.03, 0.03),
        *(
            (name, 100.0, -0.03, 0.03)
            for name in ("colour", "grey", "half-colour", "wimmer", "dubois")
        ),
    ],
)
def test_ghosts_and_their_compensation(
    name: str, compensation: float, least: float, most: float
) -> None:
    assert least < ghost(encoder(name, "linear", compensation))[0] < most


@pytest.mark.parametrize(("compensation", "much"), [(0.0, True), (100.0, False)])
def test_ghosts_through_green_and_magenta(compensation: float, much: bool) -> None:
    how = encoder("dubois-green-magenta", "linear", compensation)
    assert all((abs(leak) > 0.03) == much for leak in ghost(how, glasses=GREEN_MAGENTA))


def test_ghosts_on_black_have_nothing_to_take_away() -> None:
    assert ghost(encoder("colour"))[1] < 0.005
    assert ghost(encoder("colour", "linear", 100.0), pedestal=0.0)[0] > 0.1


def test_leaks_are_those_of_the_simulated_glasses() -> None:
    for name, through in LEAKS.items():
        glasses = GREEN_MAGENTA if name == "dubois-green-magenta" else RED_CYAN
        np.testing.assert_array_equal(through, [GLASS[glass][1] for glass in glasses])
