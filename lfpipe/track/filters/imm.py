"""Filter "predictive", the default one: several models of head motion, run in parallel and weighted
by how well each predicts (`models`), with measured noise and an outlier gate (`measurement`),
learnt gains of the prediction and a limit of its growth (`velocity`).

The midpoint of the eyes goes through the models; their half distance is smoothed separately.
Constants are in eye distances and in seconds, so they hold for any camera and viewer
(profiling/results/eyes.md). All arithmetic uses plain numbers: numpy's overhead would dominate.
"""

import math

import numpy as np

from lfpipe.config import Track
from lfpipe.track.filters.base import EyeFilter, Points
from lfpipe.track.filters.measurement import (
    HalfDistance,
    MeasurementNoise,
    MotionWeight,
    OutlierGate,
    eye_distance_of,
)
from lfpipe.track.filters.models import Models
from lfpipe.track.filters.velocity import FRAME_S, GrowthLimit, LearntMotion, VelocityGain


class ImmFilter(EyeFilter):
    """The default filter. device_latency_s: delay of camera and display that predictions cover."""

    holds_when_hidden = True

    def __init__(self, device_latency_s: float = 0.0) -> None:
        self._device_latency_s = device_latency_s
        super().__init__()

    def _start(self, t_ns: int, measured: Points) -> None:
        (lx, ly), (rx, ry) = measured.tolist()
        midpoint = (lx + rx) / 2, (ly + ry) / 2
        half = (lx - rx) / 2, (ly - ry) / 2
        self._half = HalfDistance(half)
        eye_distance_px = eye_distance_of(half)
        self._noise = MeasurementNoise(half, eye_distance_px)
        self._models = Models(midpoint, self._noise.midpoint_variance, eye_distance_px)
        self._motion = MotionWeight(midpoint)
        self._gain = VelocityGain(self._device_latency_s)
        self._learnt = LearntMotion(self._device_latency_s)
        self._growth = GrowthLimit(FRAME_S + self._device_latency_s)
        self._outliers = OutlierGate()
        self._used_ns = t_ns

    def _step(self, t_ns: int, dt_s: float, measured: Points) -> tuple[Points, Points]:
        (lx, ly), (rx, ry) = measured.tolist()
        (last_lx, last_ly), (last_rx, last_ry) = self._position.tolist()
        last_u, last_v = self._growth.velocity
        moved_x, moved_y = last_u * dt_s, last_v * dt_s
        midpoint = x, y = (lx + rx) / 2, (ly + ry) / 2
        last_x, last_y = (last_lx + last_rx) / 2, (last_ly + last_ry) / 2
        deviation_px = max(
            math.hypot(lx - last_lx - moved_x, ly - last_ly - moved_y),
            math.hypot(rx - last_rx - moved_x, ry - last_ry - moved_y),
        )
        since_s = (t_ns - self._used_ns) / 1e9
        if self._outliers.rejects(
            midpoint,
            (last_x + moved_x, last_y + moved_y),
            deviation_px,
            eye_distance_of(self._half.half),
            since_s,
        ):
            return self._position + self._velocity * dt_s, self._velocity
        self._used_ns = t_ns
        half = (lx - rx) / 2, (ly - ry) / 2
        eye_distance_px = eye_distance_of(half)
        noise = self._noise
        noise.update(half, eye_distance_px, since_s)
        models = self._models
        models.update(
            midpoint, noise.of_midpoint(since_s, models.velocity), eye_distance_px, since_s
        )
        self._half.update(half, noise.variance, since_s)
        mx, my = models.position
        u, v = models.velocity
        weight = self._motion.update(models.position, models.velocity, noise.variance, since_s)
        velocity = self._gain.apply(
            t_ns, since_s, models.position, (weight * u, weight * v), midpoint, eye_distance_px
        )
        innovation = x - last_x - moved_x, y - last_y - moved_y
        u, v = self._growth.limit(velocity, innovation, since_s)
        hx, hy = self._half.half
        hu, hv = self._half.velocity
        u, v = self._learnt.apply(t_ns, since_s, midpoint, (mx, my), (u, v), eye_distance_px)
        return (
            np.array(((mx + hx, my + hy), (mx - hx, my - hy))),
            np.array(((u + hu, v + hv), (u - hu, v - hv))),
        )


def make(track: Track, device_latency_s: float) -> ImmFilter:
    """Row "predictive" of the table of filters."""
    return ImmFilter(device_latency_s)
