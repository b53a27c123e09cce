"""What the shader `warp.glsl` reads: its source, maps of disparity, and the mixture of colours; for
a GPU of this machine, and for the exported page.
"""

from importlib import resources
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.render.synthesis.anaglyph import Recipe
from lfpipe.render.synthesis.warper import SOFT, Levels

WINDOW = 4  # cells of a side: the nearest surface in a region takes a sixteenth of its lookups


def source() -> str:
    """The shader without its version."""
    return resources.files(__package__).joinpath("warp.glsl").read_text("utf-8")


def disparity_texels(levels: Levels) -> NDArray[np.uint8]:
    """(rows, columns, 3) for the texture `disparities`. levels: 128 is none, 0 unknown."""
    highest = cv2.dilate(levels, np.ones((WINDOW, WINDOW), np.uint8), anchor=(0, 0))
    unknown = cv2.blur(np.where(levels == 0, np.uint8(255), np.uint8(0)), (SOFT, SOFT))
    return np.asarray(cv2.merge([levels, highest, unknown]), np.uint8)


def mixture(recipe: Recipe) -> dict[str, Any]:
    """The uniforms that mix a recipe's picture."""
    planes = [(*plane.weights, float(plane.eye)) for plane in recipe.planes]
    channels = recipe.channels
    return {
        "own": [planes[channel.own] for channel in channels],
        "crossed": [
            planes[channel.own if channel.cross is None else channel.cross] for channel in channels
        ],
        "linear": (recipe.planes[0].linear, recipe.linear),
        "gains": [(channel.own_gain, channel.cross_gain) for channel in channels],
    }
