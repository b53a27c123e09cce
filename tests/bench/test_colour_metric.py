"""The simulated glasses, checked against known facts."""

import numpy as np
import pytest

from lfpipe.bench.glasses import GLASS, RED_CYAN, lightness
from lfpipe.render.synthesis.anaglyph import LEAKS, encode, recipe
from profiling.anaglyph import (
    BARE,
    GREEN_MAGENTA,
    Encoder,
    fused_error,
    ghost,
    lab,
    rivalry,
    seen_xyz,
)


def encoder(name: str, light: str = "linear", ghost_compensation: float = 0.0) -> Encoder:
    how = recipe(name, light, ghost_compensation)
    return lambda left, right: encode(left, right, how)


def test_lightness_and_lab_at_known_points() -> None:
    assert lightness(np.array([1.0, 0.184187, 0.0]), 1.0) == pytest.approx([100, 50, 0], abs=1e-3)
    white = BARE.sum(axis=1)
    assert lab(white, white) == pytest.approx([100, 0, 0], abs=1e-9)
    assert seen_xyz(np.full((1, 3), 255, np.uint8), BARE)[0] == pytest.approx(white)
    # a glass passes its own colour best
    for name, own in (("red", 0), ("cyan", 1), ("green", 1), ("magenta", 0)):
        assert int(np.argmax(GLASS[name][1])) == own and (GLASS[name][1] <= BARE[1]).all()


def test_rivalry_and_colour_error_of_the_encodings() -> None:
    """In the paper's encoding a red thing is bright for the left eye and black for the right one;
    grey seen as grey is whole.
    """
    grey = np.repeat(np.linspace(0, 255, 64).astype(np.uint8)[:, None, None], 3, axis=2)
    assert (
        rivalry(encoder("grey")(grey, grey)) < 1e-6
        and fused_error(grey, encoder("grey")(grey, grey)) < 1e-6
    )
    red = np.zeros((4, 4, 3), np.uint8)
    red[..., 2] = 255
    assert rivalry(encoder("colour")(red, red)) == pytest.approx(92, abs=2)
    assert rivalry(encoder("dubois")(red, red)) < 20 and rivalry(encoder("wimmer")(red, red)) < 1
    rng = np.random.default_rng(2)
    picture = np.rint(rng.uniform(60, 190, (32, 32, 1)) + rng.uniform(-25, 25, (32, 32, 3))).astype(
        np.uint8
    )
    pictures = {
        name: encoder(name)(picture, picture)
        for name in ("colour", "grey", "dubois", "half-colour", "wimmer")
    }
    rivalries = {name: rivalry(out) for name, out in pictures.items()}
    errors = {name: fused_error(picture, out) for name, out in pictures.items()}
    assert (
        rivalries["dubois"] < rivalries["colour"] / 2
        and rivalries["wimmer"] < rivalries["half-colour"]
    )
    assert errors["colour"] < errors["dubois"] < errors["grey"]


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
