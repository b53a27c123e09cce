"""The records that travel from tracking to rendering and on, and their arithmetic."""

import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Eyes = tuple[float, float, float, float]  # x and y of the left eye, x and y of the right one

# Points are [[left x, left y], [right x, right y]] of the viewer's own eyes in px of the unmirrored
# camera picture, so the left eye is at larger x. The ring's slot header repeats source_seq,
# epoch and the stamps of the frame.
EYES = np.dtype(
    [
        ("raw_px", "<f8", (2, 2)),
        ("filtered_px", "<f8", (2, 2)),
        ("velocity_px_s", "<f8", (2, 2)),
        ("eye_distance_px", "<f8"),  # between the eyes as if the head were not turned; 0: not known
        ("confidence", "<f8"),
        ("width_px", "<i4"),
        ("height_px", "<i4"),
        ("t_tracked_ns", "<i8"),
        ("face", "<i4"),
        # counts the tracks of a face: another number means another face, or a gap
        ("generation", "<i4"),
        # HEAD_POINTS in the picture: right, down, away from the camera; zeros: not known
        ("head_px", "<f4", (10, 3)),
    ]
)

# the fields before head_px; packed into a record and unpacked from it
PLAIN = struct.Struct("<14d2iq2i")


class EyesRecord(NamedTuple):
    """A record of EYES without head_px, as plain numbers: on a path where each numpy call costs
    some microseconds.
    """

    raw_px: Eyes
    filtered_px: Eyes
    velocity_px_s: Eyes
    eye_distance_px: float
    confidence: float
    width_px: int
    height_px: int
    t_tracked_ns: int
    face: int
    generation: int

    @classmethod
    def of(cls, record: NDArray[np.void]) -> "EyesRecord":
        """From a record of dtype EYES, shape ()."""
        numbers = PLAIN.unpack_from(record)  # type: ignore[arg-type]
        return cls(numbers[:4], numbers[4:8], numbers[8:12], *numbers[12:])

    def write(self, record: NDArray[np.void]) -> None:
        """Fills a record of dtype EYES but for head_px."""
        points = (*self.raw_px, *self.filtered_px, *self.velocity_px_s)
        PLAIN.pack_into(record, 0, *points, *self[3:])  # type: ignore[arg-type]


# Points of MediaPipe's face mesh that jaw and mouth do not move: tip of the nose, top of the
# forehead, corners of the eyes from the right outer to the left outer one,
# temples, and in front of the ears.
HEAD_POINTS = (1, 10, 33, 133, 362, 263, 127, 356, 234, 454)

# A presented picture, for stages that share the session; the slot header repeats the stamps of
# its frame.
SHOWN = np.dtype(
    [("t_presented_ns", "<i8"), ("view", "<f8", (2, 2)), ("composed", "<i4"), ("face", "<i4")]
)

MIN_EYE_DISTANCE_PX = 0.5  # of a plausible face; a tracked one has at least 4 px
MAX_EYE_PX = 1e6  # coordinates beyond it are outside every camera's picture
# From one record to the next: after a longer gap, the past is discarded. A record that is older
# comes from a tracker that has died.
MAX_STEP_NS = 500_000_000
MAX_PREDICTION_S = 0.25  # a straight line predicts no head further than a quarter of a second


def is_plausible_px(*values: float) -> bool:
    """Whether all values are finite and within MAX_EYE_PX."""
    return all(-MAX_EYE_PX <= value <= MAX_EYE_PX for value in values)  # false for NaN


def low_pass_gain(dt_s: float, time_s: float) -> float:
    """Share of the new value in a first-order low-pass of time constant time_s over dt_s >= 0:
    backward Euler, within 0..1 for every step.

    (Explicit Euler's share, dt / time, passes 2 at long steps and then grows without bound.)
    """
    return dt_s / (dt_s + time_s)


def middle_of(eyes: Eyes) -> tuple[float, float]:
    """The point between the eyes."""
    lx, ly, rx, ry = eyes
    return (lx + rx) / 2, (ly + ry) / 2


def extrapolated(
    position_px: NDArray[np.float64], velocity_px_s: NDArray[np.float64], prediction_ns: int
) -> NDArray[np.float64]:
    """Where the eyes will be prediction_ns after their frame was taken, a time that is clamped to
    0 .. MAX_PREDICTION_S.

    position_px, velocity_px_s: (2, 2). Returns (2, 2) px.
    """
    prediction_s = min(max(prediction_ns, 0) / 1e9, MAX_PREDICTION_S)
    return position_px + velocity_px_s * prediction_s
