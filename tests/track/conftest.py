"""The one face that is always there: the demo's portrait, placed where a test wants it."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from lfpipe.capture.recordings import PORTRAIT

Picture = NDArray[np.uint8]


@pytest.fixture(scope="session")
def portrait() -> Picture:
    image = cv2.imread(str(PORTRAIT))
    assert image is not None
    return image[:420].astype(np.uint8)  # head and shoulders, 512 wide


@pytest.fixture(scope="session")
def placed(portrait: Picture) -> Callable[..., Picture]:
    """placed((x, y, scale), ..., size=(640, 480)): heads, the middle of their eyes at (x, y), eyes
    89 px apart at scale 1.
    """

    def draw(*heads: tuple[float, float, float], size: tuple[int, int] = (640, 480)) -> Picture:
        out = np.full((size[1], size[0], 3), 90, np.uint8)
        for x, y, scale in heads:
            matrix = np.array([[scale, 0, x - 264 * scale], [0, scale, y - 190 * scale]])
            mask = cv2.warpAffine(
                np.full(portrait.shape[:2], 255, np.uint8), matrix, size, flags=cv2.INTER_NEAREST
            )
            head = cv2.warpAffine(portrait, matrix, size, flags=cv2.INTER_LINEAR)
            out[mask > 0] = head[mask > 0]
        return out

    return draw
