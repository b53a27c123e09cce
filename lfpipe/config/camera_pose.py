"""The camera's position, to convert eyes in its picture to points in front of the screen.

The screen's axes begin in the middle of the picture on it: x along it as in the camera's picture, y
down, z towards the viewer. The camera is at (0, -above, 0) and tilted down. Eyes e mm
apart that are p px apart in its picture are f e / p mm away along its axis (f its focal length in
px). `from_screen` converts them to the picture that the same camera would take from the middle of
the screen, looking straight ahead. In that picture, a viewer who leans towards the middle of the
screen does not move.
"""

from __future__ import annotations

import math

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.config.tree import Config, options

MIN_Z_MM = options()["screen.distance_mm"].low


def camera_focal_px(config: Config, frame_width_px: int) -> float:
    """Focal length of the webcam in px of a frame of width_px, from camera.focal_px or
    camera.fov_deg.
    """
    camera = config.camera
    scale = frame_width_px / camera.frame_px[0]
    if camera.focal_px != "auto":
        return float(camera.focal_px) * scale
    return scale * camera.width_px / 2 / math.tan(math.radians(camera.fov_deg) / 2)


@attrs.frozen(kw_only=True)
class CameraPose:
    """The camera's position and optics."""

    above_mm: float
    """From the middle of the picture on the screen up to the camera."""
    tilt: float
    """Radians, positive where it looks down."""
    focal_px: float
    """Of its picture."""
    middle_px: tuple[float, float]
    """Of its picture."""
    eyes_mm: float
    """Distance between the viewer's eyes."""

    @classmethod
    def of(cls, config: Config, size_px: tuple[int, int]) -> CameraPose | None:
        """As `configured`; None if the camera is assumed to be in the middle of the screen."""
        pose = cls.configured(config, size_px)
        return pose if pose.above_mm or pose.tilt else None

    @classmethod
    def configured(cls, config: Config, size_px: tuple[int, int]) -> CameraPose:
        """From the configuration, for pictures of size_px (width, height)."""
        return cls(
            above_mm=config.camera.above_mm,
            tilt=math.radians(config.camera.tilt_deg),
            focal_px=camera_focal_px(config, size_px[0]),
            middle_px=(size_px[0] / 2, size_px[1] / 2),
            eyes_mm=config.screen.eyes_mm,
        )

    def points_mm(
        self, eyes_px: NDArray[np.float64], eye_distance_px: float
    ) -> NDArray[np.float64]:
        """Eyes (2, 2) px, eye_distance_px apart if the head were not turned, as points (2, 3) mm
        on the screen's axes.
        """
        depth_mm = self.focal_px * self.eyes_mm / max(eye_distance_px, 1e-6)
        across, down = (eyes_px - self.middle_px).T * (depth_mm / self.focal_px)
        c = math.cos(self.tilt)
        s = math.sin(self.tilt)
        return np.stack(
            [across, down * c + depth_mm * s - self.above_mm, depth_mm * c - down * s], axis=1
        )

    def from_screen(
        self, eyes_px: NDArray[np.float64], eye_distance_px: float
    ) -> NDArray[np.float64]:
        """Eyes (2, 2) px of the camera's picture in px of the picture taken from the middle of the
        screen.
        """
        points = self.points_mm(eyes_px, eye_distance_px)
        return self.focal_px * points[:, :2] / np.maximum(points[:, 2:], MIN_Z_MM) + self.middle_px

    def from_camera(
        self, screen_px: NDArray[np.float64], eye_distance_px: float
    ) -> NDArray[np.float64]:
        """The inverse of `from_screen`: px of the camera's picture, for the same depth along the
        camera's axis.
        """
        depth_mm = self.focal_px * self.eyes_mm / max(eye_distance_px, 1e-6)
        c = math.cos(self.tilt)
        s = math.sin(self.tilt)
        slope = (screen_px - self.middle_px) / self.focal_px  # x / z and y / z on the screen's axes
        # y = down c + depth s - above and z = depth c - down s, with y = slope z: solved for down
        down_mm = (slope[:, 1] * depth_mm * c - depth_mm * s + self.above_mm) / (
            c + slope[:, 1] * s
        )
        z_mm = np.maximum(depth_mm * c - down_mm * s, MIN_Z_MM)
        return (
            self.focal_px / depth_mm * np.stack([slope[:, 0] * z_mm, down_mm], axis=1)
            + self.middle_px
        )
