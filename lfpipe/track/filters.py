"""The filters by their names in the configuration, with their constants.

Constants were fitted on sequences of known motion (tools/make_sequence.py, measured by the landmark network at 30 Hz, with and
without noise on top), for the least error on the screen with no more jitter of a still viewer than the mean of five:
`lfpipe bench filters`. On other faces and paths they do as well (`profiling/eyes_heldout.py`, profiling/results/eyes.md).
They are in distances between the eyes and in seconds, so they hold for any camera, picture size and viewer distance.
"""

from __future__ import annotations

from lfpipe.config import Track
from lfpipe.track.kalman import Kalman, Predictive
from lfpipe.track.smoothing import EyeFilter, Mean, OneEuro


def make_filter(track: Track) -> EyeFilter:
    """The filter that track names, at its start."""
    if track.filter == "mean":
        return Mean(track.mean_k)
    if track.filter == "one-euro":
        return OneEuro(1.0, 2.0, 4.0)
    if track.filter == "kalman":
        return Kalman(1e4)
    return Predictive(OneEuro(0.4, 5.0, 1.5), Kalman(4e4), 0.55)
