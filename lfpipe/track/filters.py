"""The filters by their names in the configuration, with their constants.

Constants of the default were chosen on videos of heads and on sequences of known motion, by the rule in
profiling/results/eyes.md, and checked on others (`profiling/eyes_tracks.py`). All are in distances
between the eyes and in seconds, so they are valid for any camera, picture size and viewer distance.
"""

from lfpipe.config import Track
from lfpipe.plugins import FILTERS, load
from lfpipe.track.kalman import Kalman
from lfpipe.track.motion_models import Predictive
from lfpipe.track.smoothing import EyeFilter, Mean, OneEuro


def make_filter(track: Track, loop_s: float = 0.0) -> EyeFilter:
    """Returns a new filter of the name in track. loop_s: delay of camera and display that predictions must cover."""
    if track.filter == "mean":
        return Mean(track.mean_k)
    if track.filter == "one-euro":
        return OneEuro(1.0, 2.0, 4.0)
    if track.filter == "kalman":
        return Kalman(1e4)
    name: str = track.filter
    if name == "predictive":
        return Predictive(loop_s=loop_s)
    made: EyeFilter = load(FILTERS, name)(track, loop_s)
    return made
