"""Frames turned and mirrored as a camera is mounted."""

from __future__ import annotations

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.capture.source import Frame, Source, SourceInfo

_TURNS = {90: cv2.ROTATE_90_CLOCKWISE, 180: cv2.ROTATE_180, 270: cv2.ROTATE_90_COUNTERCLOCKWISE}


class OrientedSource:
    """Another source's frames, turned clockwise by camera.rotate degrees and then mirrored where camera.mirror says so.

    Its frames no longer are the JPEGs that the other source delivers, so it hands out none: recordings of it stand upright.
    """

    def __init__(self, source: Source, camera: config.Camera) -> None:
        self._source, self._camera = source, camera
        self._taken = np.empty((camera.height_px, camera.width_px, 3), np.uint8)
        self._turned = np.empty((camera.frame_px[1], camera.frame_px[0], 3), np.uint8)

    @property
    def info(self) -> SourceInfo:
        """Of the other source, with the size as it is after the turn."""
        inner, upright = self._source.info, self._camera.rotate % 180 == 0
        width_px, height_px = inner.width_px, inner.height_px
        size = (width_px, height_px) if upright else (height_px, width_px)
        return attrs.evolve(inner, width_px=size[0], height_px=size[1], jpeg=False)

    def read(self, out: NDArray[np.uint8]) -> Frame | None:
        """See `Source.read`."""
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


def oriented(source: Source, camera: config.Camera) -> Source:
    """source as the camera is mounted: itself where that is upright and not mirrored."""
    return OrientedSource(source, camera) if camera.rotate or camera.mirror else source
