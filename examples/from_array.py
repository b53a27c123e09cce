"""Shows a light field that exists only as an array, and saves it for `lfpipe up`.

Usage: python from_array.py views.npy
"""

import sys

import numpy as np

import lfpipe

if len(sys.argv) != 2:
    sys.exit(__doc__)

views = np.zeros((3, 3, 96, 128, 3), np.uint8)  # rows, columns, height, width, red first
for row in range(3):
    for col in range(3):
        views[row, col, 30 - 4 * row : 60 - 4 * row, 50 - 4 * col : 80 - 4 * col] = (255, 160, 40)
field = lfpipe.open_scene(views)
print("left and right eye:", lfpipe.render_anaglyph(field, (1, 0.5), (1, 1.5)).shape)
np.save(sys.argv[1], views)
