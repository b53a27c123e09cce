"""Names as Windows gives them to copies and to a selection that is renamed at once: `photo (1).JPG`."""

from pathlib import Path

import cv2
import numpy as np

from lfpipe import config
from lfpipe.scene import layouts


def test_numbers_in_brackets_and_capital_endings_are_views_in_their_order(tmp_path: Path) -> None:
    texture = cv2.GaussianBlur(np.random.default_rng(7).integers(0, 255, (120, 400, 3), np.uint8), (0, 0), 3)
    for k in range(16):
        row, col = divmod(k, 4)
        made = tmp_path / "made.jpg"
        cv2.imwrite(str(made), texture[20 + 2 * row : 100 + 2 * row, 20 + 2 * col : 200 + 2 * col])
        made.rename(tmp_path / f"photo ({k + 1}).JPG")
    found = layouts.describe(tmp_path, config.Scene())
    assert (found.layout, found.rows, found.cols) == ("numbered", 4, 4)
    alone = layouts.describe(tmp_path / "photo (1).JPG", config.Scene())
    assert (alone.layout, alone.rows * alone.cols) == ("picture", 1)
