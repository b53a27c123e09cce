"""Rotation of the head: fits MediaPipe's canonical face model to the network's points.

The fit (Kabsch, Acta Cryst. A32, 1976) uses points that jaw and mouth do not move. The mesh assumes parallel camera rays, so the
angles are relative to the line of sight from the camera to the head, not to the camera's axis.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

HeadTurn = tuple[float, float, float]  # yaw, pitch, roll in degrees

# Point of the mesh -> its position in the canonical model, cm: x to the face's left, y up, z out of the face.
_MODEL_CM = {
    1: (0.0, -1.126865, 7.475604),  # tip of the nose
    10: (0.0, 8.261778, 4.481535),  # top of the forehead
    33: (-4.445859, 2.663991, 3.173422),  # corners of the eyes, right outer to left outer
    133: (-1.856432, 2.585245, 3.757904),
    362: (1.856432, 2.585245, 3.757904),
    263: (4.445859, 2.663991, 3.173422),
    127: (-7.743095, 2.364999, -2.005167),  # temples
    356: (7.743095, 2.364999, -2.005167),
    234: (-7.664182, 0.673132, -2.435867),  # in front of the ears
    454: (7.664182, 0.673132, -2.435867),
}
HEAD_POINTS = np.array(list(_MODEL_CM))
_MODEL = np.array(list(_MODEL_CM.values())) * (1.0, -1.0, -1.0)  # on the picture's axes: y down, z away from the camera
_CENTRED = _MODEL - _MODEL.mean(axis=0)  # its rows sum to 0, so the points need not be centred


def head_turn(points: ArrayLike) -> HeadTurn:
    """Yaw, pitch, roll in degrees, 0 for a face that looks along the line of sight: yaw to the person's own right, pitch up, roll
    towards their right shoulder. Applied in the order yaw, pitch, roll, about axes that turn with the head.

    points: (10, 3), those of HEAD_POINTS, on the picture's axes in any unit: x right, y down, z away from the camera.
    """
    u, _, vt = np.linalg.svd(np.asarray(points, np.float64).T @ _CENTRED)
    rotation = u @ vt
    x, y, z = rotation.tolist()
    if x[0] * (y[1] * z[2] - y[2] * z[1]) - x[1] * (y[0] * z[2] - y[2] * z[0]) + x[2] * (y[0] * z[1] - y[1] * z[0]) < 0:
        u[:, 2] *= -1  # a reflection would fit better, but is impossible
        rotation = u @ vt
    return turn_of(rotation)


def turn_of(rotation: NDArray[np.float64]) -> HeadTurn:
    """The angles of a rotation (3, 3) on the picture's axes."""
    r = rotation.tolist()
    pitch = math.asin(min(max(r[1][2], -1.0), 1.0))
    return math.degrees(math.atan2(r[0][2], r[2][2])), math.degrees(pitch), math.degrees(-math.atan2(r[1][0], r[1][1]))
