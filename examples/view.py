"""Saves the view between two cameras of a light field.

Usage: python view.py SCENE view.png
"""

import sys

import cv2

import lfpipe

if len(sys.argv) != 3:
    sys.exit(__doc__)

field = lfpipe.open_scene(sys.argv[1])
picture = lfpipe.render_view(field, (field.rows - 1) / 2, (field.cols - 1) / 2 + 0.5)
cv2.imwrite(sys.argv[2], picture)
print(f"{field.name}: {field.rows}x{field.cols} views, drawn by {field.method}")
