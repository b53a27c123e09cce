"""The points of the face mesh around the eyes.

The 468 points are those of MediaPipe's canonical face model.
"""

import math

import numpy as np
from numpy.typing import NDArray

from lfpipe.eyes import HEAD_POINTS

# The 16 points of each eyelid contour. The viewer's own left eye:
# at larger x in an unmirrored picture.
LEFT_EYE = np.array(
    [263, 249, 390, 373, 374, 380, 381, 382, 362, 398, 384, 385, 386, 387, 388, 466]
)
RIGHT_EYE = np.array([33, 7, 163, 144, 145, 153, 154, 155, 133, 173, 157, 158, 159, 160, 161, 246])
Point = tuple[float, float]

EDGES = (10, 152, 234, 454)  # top of the forehead, chin, and the sides of the face

# outer corners of the eyes, right to left: defines the rotation of a face's region
EYE_LINE = (33, 263)
# corners and lower lid: the first of LEFT_EYE and RIGHT_EYE. A blink moves the upper lid by a third
# of an eye
_LIDS = 9
_KEY = np.concatenate([LEFT_EYE[:_LIDS], RIGHT_EYE[:_LIDS], EYE_LINE, HEAD_POINTS])
_HEAD = 2 * _LIDS + len(EYE_LINE)  # index of the first of HEAD_POINTS in _KEY
# From the mean of these points to that of all 16 in open eyes, in eye distances:
# upwards, and away from the nose. Medians over 60 pictures of 10 people (0.0355, 0.0073) and 429
# frames of a talking person (0.0370, 0.0062).
_RAISE, _SPREAD = 0.036, 0.0067


def eye_points(
    points: NDArray[np.floating], depth: NDArray[np.floating], scale: np.float32
) -> tuple[Point, Point, Point, Point, float, NDArray[np.float64]]:
    """(left eye, right eye, their outer corners, the eye distance in 3-D, the points of HEAD_POINTS
    (10, 3)), from points (2, 468), x and y of the mesh, and depth (468,), its unscaled z. A blink
    does not move them.

    A centre is the mean of the eye's corners and lower lid, shifted to the paper's centre: the mean
    of all 16 periocular points of an open eye.
    """
    keys = np.empty((3, len(_KEY)))
    points.take(_KEY, 1, keys[:2])
    keys[2] = depth.take(_KEY) * scale
    xs, ys, zs = keys.tolist()  # plain numbers from here: a numpy call after a pause costs 15 us
    lx = ly = lz = rx = ry = rz = 0.0
    for k in range(_LIDS):
        lx, ly, lz = lx + xs[k], ly + ys[k], lz + zs[k]
        rx, ry, rz = rx + xs[k + _LIDS], ry + ys[k + _LIDS], rz + zs[k + _LIDS]
    lx, ly, lz, rx, ry, rz = lx / _LIDS, ly / _LIDS, lz / _LIDS, rx / _LIDS, ry / _LIDS, rz / _LIDS
    dx, dy = lx - rx, ly - ry
    up_x, up_y, out_x, out_y = _RAISE * dy, -_RAISE * dx, _SPREAD * dx, _SPREAD * dy
    right = 2 * _LIDS
    left = 2 * _LIDS + 1
    eyes = (lx + up_x + out_x, ly + up_y + out_y), (rx + up_x - out_x, ry + up_y - out_y)
    eye_distance = (1 + 2 * _SPREAD) * math.sqrt(dx * dx + dy * dy + (lz - rz) ** 2)
    return *eyes, (xs[left], ys[left]), (xs[right], ys[right]), eye_distance, keys[:, _HEAD:].T
