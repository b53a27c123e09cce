"""Position and size of the irises: MediaPipe's iris network on a crop of each eye (arXiv:2006.11341)."""

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.track.network import Network, model_file
from lfpipe.track.roi import Roi, Warp, around, fill, warp

SIZE_PX = 64
_SCALE = 2.3  # width of the crop in distances between the eye's corners
_CORNERS = ((362, 263), (33, 133))  # inner and outer of the viewer's left eye, outer and inner of the right: both left to right


class Irises:
    """Raises UserError if the network is missing or has another version."""

    def __init__(self, warp: Warp = warp) -> None:
        self._warp = warp
        self._network = Network(model_file("modules/iris_landmark/iris_landmark.tflite"), (1, SIZE_PX, SIZE_PX, 3), (15,))
        self.model = self._network.name

    def find(self, image: NDArray[np.uint8], points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Irises in px of image, uint8 (h, w, 3) BGR. points: (468, 2) px of the face mesh.

        Returns (2, 5, 2), left first: the centre and four points around it, as for `landmarks.iris_diameter`.
        """
        out = np.empty((2, 5, 2))
        for eye, (start, end) in enumerate(_CORNERS):
            middle, reach = (points[start] + points[end]) / 2, np.abs(points[end] - points[start]).max() / 2
            corners = (*(middle - reach), *(middle + reach))
            roi: Roi = around(corners, points[start], points[end], _SCALE)
            crop = roi.crop(image, SIZE_PX, cv2.BORDER_REPLICATE, self._warp)
            # the network knows only right eyes, so the left one is mirrored
            crop = crop if eye else np.ascontiguousarray(crop[:, ::-1])
            fill(self._network.input, crop, 0.0, 1.0)
            found = self._network.run()[0].reshape(5, 3)[:, :2].astype(np.float64)
            if not eye:
                found[:, 0] = SIZE_PX - found[:, 0]
            out[eye] = roi.to_picture(found, SIZE_PX)
        return out
