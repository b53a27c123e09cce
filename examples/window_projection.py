"""The camera of a 3D scene for which the screen is a window: OpenGL matrices for an eye.

Usage: python window_projection.py X Y Z, the eye in mm from the middle of the picture
"""

import sys

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]


def window_projection(
    eye_mm: tuple[float, float, float],
    screen_mm: tuple[float, float],
    near_mm: float = 50.0,
    far_mm: float = 20000.0,
) -> tuple[Matrix, Matrix]:
    """The matrices (projection, view), 4x4 each, for an eye (x, y, z) and a screen (width, height).

    The screen lies in the plane z = 0; points behind it have negative z. The frustum is off-axis,
    and the camera never rotates: R. Kooima, Generalized Perspective Projection, 2009.
    """
    (x, y, z), (width, height) = eye_mm, screen_mm
    left, right = ((side - x) * near_mm / z for side in (-width / 2, width / 2))
    bottom, top = ((side - y) * near_mm / z for side in (-height / 2, height / 2))
    depth = far_mm - near_mm
    projection = np.array(
        [
            [2 * near_mm / (right - left), 0, (right + left) / (right - left), 0],
            [0, 2 * near_mm / (top - bottom), (top + bottom) / (top - bottom), 0],
            [0, 0, -(far_mm + near_mm) / depth, -2 * far_mm * near_mm / depth],
            [0, 0, -1, 0],
        ]
    )
    view = np.eye(4)
    view[:3, 3] = -x, -y, -z
    return projection, view


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    x_mm, y_mm, z_mm = map(float, sys.argv[1:])
    projection, view = window_projection((x_mm, y_mm, z_mm), (530, 300))
    print(projection.round(4))
    print(view)
