"""Rotation and mirroring of frames to match the camera's mounting."""

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.capture.frame_source import Frame, FrameSource, SourceInfo

_TURNS = {90: cv2.ROTATE_90_CLOCKWISE, 180: cv2.ROTATE_180, 270: cv2.ROTATE_90_COUNTERCLOCKWISE}


class OrientedSource:
    """Another source's frames, rotated clockwise by camera.rotate degrees, then mirrored if camera.mirror is set.

    It passes on no JPEGs, because those are not rotated; recordings are therefore upright.
    """

    def __init__(self, source: FrameSource, camera: config.Camera) -> None:
        self._source, self._camera = source, camera
        self._taken = np.empty((camera.height_px, camera.width_px, 3), np.uint8)
        self._turned = np.empty((camera.frame_px[1], camera.frame_px[0], 3), np.uint8)

    @property
    def info(self) -> SourceInfo:
        """Info of the other source, with the rotated size."""
        inner, upright = self._source.info, self._camera.rotate % 180 == 0
        width_px, height_px = inner.width_px, inner.height_px
        size = (width_px, height_px) if upright else (height_px, width_px)
        return attrs.evolve(inner, width_px=size[0], height_px=size[1], jpeg=False)

    def read(self, out: NDArray[np.uint8]) -> Frame | None:
        """See `FrameSource.read`."""
        frame = self._source.read(self._taken)
        if frame is None:
            return None
        rotate, mirror = self._camera.rotate, self._camera.mirror
        if not rotate:
            cv2.flip(self._taken, 1, dst=out)
        elif not mirror:
            cv2.rotate(self._taken, _TURNS[rotate], dst=out)
        else:
            cv2.flip(cv2.rotate(self._taken, _TURNS[rotate], dst=self._turned), 1, dst=out)
        return attrs.evolve(frame, packet=None)

    def close(self) -> None:
        self._source.close()


def as_read(pictures: NDArray[np.uint8], camera: config.Camera) -> NDArray[np.uint8]:
    """Upright pictures, (n, height, width), in the sensor's order of readout: row by row from the first."""
    unmirrored = pictures[:, :, ::-1] if camera.mirror else pictures
    return np.rot90(unmirrored, camera.rotate // 90, axes=(1, 2))


def orient(source: FrameSource, camera: config.Camera) -> FrameSource:
    """source, rotated and mirrored by the configuration; source itself if neither is configured."""
    return OrientedSource(source, camera) if camera.rotate or camera.mirror else source
