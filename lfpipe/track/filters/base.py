"""The base of all filters: how one is made, the protocol, checks of stamps and measurements, and
prediction.

No filter reads a clock. Stamps are subtracted as integers before conversion to float, so no
precision is lost on a machine that has been up for years. Speeds are in eye distances per second:
a near head moves by more pixels, and the noise of its landmarks grows in proportion.
"""

import importlib
from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import FILTER_MODULES, Track
from lfpipe.eyes import MAX_STEP_NS, extrapolated, is_plausible_px
from lfpipe.plugins import FILTERS, make

Points = NDArray[np.float64]
Vector = tuple[float, float]

MIN_STEP_NS = 200_000  # less means a duplicate frame; noise / dt would give a wild velocity


class EyeFilter(ABC):
    """A filter: subclasses implement _start and _step.

    The prediction is position + velocity * time, so a filter reports the velocity to use for
    extrapolation.
    """

    restarts_after_loss = False
    """Whether it is reset when the face is lost, so that it never mixes data from before and after.
    """
    holds_when_hidden = False
    """Whether the eyes are held while something hides the face. The filters for comparison do not
    hold: they behave as published."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Discards everything: the next measurement is the first."""
        self._t_ns: int | None = None
        self._position = np.full((2, 2), np.nan)
        self._velocity = np.zeros((2, 2))

    def update(self, t_ns: int, measurement: Points) -> tuple[Points, Points]:
        """Adds the eyes measured at t_ns, float64 (2, 2) px; returns (position, velocity), both (2,
        2), px and px/s, which the filter still uses: copy them before you change them.

        An implausible measurement (`lfpipe.eyes.is_plausible_px`) counts as missing. A stamp less
        than MIN_STEP_NS after the last one means a duplicate frame, which is ignored. A step of at
        least MAX_STEP_NS, forwards or backwards, starts a new run. Before the first good
        measurement, the position is NaN.
        """
        t_ns = int(t_ns)  # a numpy integer could overflow in subtractions
        measured = np.array(measurement, np.float64)
        left, right = measured.tolist()
        if not is_plausible_px(*left, *right):
            return self.predict(t_ns), self._velocity
        step_ns = 0 if self._t_ns is None else t_ns - self._t_ns
        if self._t_ns is None or abs(step_ns) >= MAX_STEP_NS:
            self.reset()
            self._t_ns = t_ns
            self._position = measured
            self._start(t_ns, measured)
        elif step_ns >= MIN_STEP_NS:
            self._t_ns = t_ns
            self._position, self._velocity = self._step(t_ns, step_ns / 1e9, measured)
        return self._position, self._velocity

    def predict(self, t_ns: int) -> Points:
        """The predicted eyes at t_ns, (2, 2) px; at most `lfpipe.eyes.MAX_PREDICTION_S` ahead,
        never back.
        """
        return extrapolated(
            self._position, self._velocity, 0 if self._t_ns is None else int(t_ns) - self._t_ns
        )

    @abstractmethod
    def _start(self, t_ns: int, measured: Points) -> None:
        """Processes the first measurement of a run."""

    @abstractmethod
    def _step(self, t_ns: int, dt_s: float, measured: Points) -> tuple[Points, Points]:
        """New (position, velocity) at t_ns, dt_s after the last measurement."""


def make_filter(track: Track, device_latency_s: float = 0.0) -> EyeFilter:
    """A new filter of the name in track: a built-in one, or a plug-in.

    device_latency_s: delay of camera and display that predictions must cover.
    """
    if (module := FILTER_MODULES.get(track.filter)) is not None:
        maker = importlib.import_module(f"{__package__}.{module}").make
        built_in: EyeFilter = maker(track, device_latency_s)
        return built_in
    plugin: EyeFilter = make(FILTERS, track.filter, track, device_latency_s)
    return plugin
