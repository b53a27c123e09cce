"""Simulated glasses: the light that reaches an eye from a screen.

The matrices turn linear RGB of an ordinary LCD into the XYZ that reaches an eye through each
filter. They integrate spectra of display and filters (digitised in the public project angler.js,
after Woods' measurements) over the CIE 1931 observer. The display's white is D65 with Y = 1.
"""

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

# XYZ of a screen's red, green and blue at full intensity, through each filter
GLASS = {
    "red": np.array([(0.1909, 0.0259, 0.0001), (0.0922, 0.0135, 0.0001), (0.0, 0.0, 0.0)]),
    "cyan": np.array([(0.0010, 0.0778, 0.1070), (0.0009, 0.2381, 0.0658), (0.0, 0.0744, 0.5735)]),
    "green": np.array([(0.0006, 0.0429, 0.0044), (0.0006, 0.1266, 0.0170), (0.0, 0.0052, 0.0026)]),
    "magenta": np.array(
        [(0.2437, 0.0309, 0.0512), (0.1174, 0.0153, 0.0043), (0.0, 0.0044, 0.2621)]
    ),
}
RED_CYAN = ("red", "cyan")


def curve(ratio: Float) -> Float:
    """The cube root of CIELAB, with its linear start."""
    return np.where(
        ratio > (6 / 29) ** 3, np.cbrt(np.maximum(ratio, 0.0)), ratio * (29 / 6) ** 2 / 3 + 4 / 29
    )


def lightness(luminance: Float, white: float) -> Float:
    """CIE L*, 0..100 for luminance up to white."""
    return np.asarray(116 * curve(luminance / white) - 16)
