"""The simulated glasses, checked against known facts."""

import numpy as np

from lfpipe.bench.glasses import GLASS, RED_CYAN
from lfpipe.render.synthesis.anaglyph import LEAKS
from profiling.anaglyph import (
    GREEN_MAGENTA,
)


def test_leaks_are_those_of_the_simulated_glasses() -> None:
    for name, through in LEAKS.items():
        glasses = GREEN_MAGENTA if name == "dubois-green-magenta" else RED_CYAN
        np.testing.assert_array_equal(through, [GLASS[glass][1] for glass in glasses])
