"""Which of the face mesh's points stand around the eyes.

The 468 points, and the 5 + 5 of the iris that follow them when refined, are those of MediaPipe's canonical face model.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# The 16 points of each eyelid contour. The viewer's own left eye: at larger x in an unmirrored picture.
LEFT_EYE = np.array([263, 249, 390, 373, 374, 380, 381, 382, 362, 398, 384, 385, 386, 387, 388, 466])
RIGHT_EYE = np.array([33, 7, 163, 144, 145, 153, 154, 155, 133, 173, 157, 158, 159, 160, 161, 246])
_BOTH_EYES = np.concatenate([LEFT_EYE, RIGHT_EYE])
LEFT_IRIS, RIGHT_IRIS = 473, 468  # the centre points

EDGES = (10, 152, 234, 454)  # top of the forehead, chin, and the sides of the face


def eye_centres(points: NDArray[np.floating]) -> NDArray[np.float64]:
    """Eye centres as the mean of the 16 periocular points (what the paper uses); of the iris where the mesh is refined.

    points: (468, 2 or 3), or (478, 2 or 3) with irises. Returns float64 (2, 2): [[left x, y], [right x, y]].
    """
    if len(points) > RIGHT_IRIS:
        return points[[LEFT_IRIS, RIGHT_IRIS], :2].astype(np.float64)
    return np.asarray(points[_BOTH_EYES, :2].reshape(2, 16, 2).mean(axis=1, dtype=np.float64))


def box(points: NDArray[np.floating]) -> tuple[float, float, float, float]:
    """Upright box around points (n, 2 or 3): (x0, y0, x1, y1)."""
    (x0, y0), (x1, y1) = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    return float(x0), float(y0), float(x1), float(y1)
