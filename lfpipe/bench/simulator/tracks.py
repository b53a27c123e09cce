"""Recorded head tracks as paths of simulated viewers."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError

COLUMNS = "t_s,face,left_x,left_y,right_x,right_y"
SMOOTH_MS = 25.0  # standard deviation of the kernel that separates motion from landmark noise
EYE_DISTANCE_S = 1.0  # the same for the eye distance, which a turning head changes
EYE_DISTANCE_PX = 60.0  # of the simulated viewer, to which every track is scaled
REMEDY = f"give a table with the columns {COLUMNS}"


def read_track(path: Path) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The path (n, 3) of a track at each ms, about (0, 0): x and y of the midpoint of the eyes, and
    the eye distance, scaled to a median of EYE_DISTANCE_PX; and whether there is a face, (n,).

    Raises UserError if the table cannot be read.
    """
    t_s, face, eyes = read_table(path)
    known = np.flatnonzero(face)
    if len(known) < 2:
        raise UserError(f"{path}: contains no face", REMEDY)
    at_s = t_s[0] + np.arange(int((t_s[-1] - t_s[0]) * 1000)) / 1000
    lx, ly, rx, ry = (np.interp(at_s, t_s[known], eyes[known, k]) for k in range(4))
    eye_distance = _smoothed(np.hypot(lx - rx, ly - ry), EYE_DISTANCE_S * 1000)
    x = _smoothed((lx + rx) / 2, SMOOTH_MS)
    y = _smoothed((ly + ry) / 2, SMOOTH_MS)
    places = np.stack([x - np.median(x), y - np.median(y), eye_distance], axis=1)
    visible = face[np.searchsorted(t_s, at_s, side="right") - 1]
    return places * (EYE_DISTANCE_PX / float(np.median(eye_distance))), visible


def read_table(path: Path) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.float64]]:
    """Times (n,) in s, whether there is a face, and eyes (n, 4) px. Raises UserError."""
    try:
        head, *lines = path.read_text().splitlines() or [""]
        if head.strip() != COLUMNS:
            raise ValueError("wrong columns")
        rows = np.array(
            [[float(cell.strip() or "nan") for cell in line.split(",")] for line in lines]
        )
        if rows.shape[1:] != (6,):
            raise ValueError("expected six numbers in each row")
        face = rows[:, 1] > 0
        if not (np.isfinite(rows[:, :2]).all() and np.isfinite(rows[face]).all()):
            raise ValueError("only the eyes of a frame without a face may be missing")
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: not a head track: {error}", REMEDY) from None
    return rows[:, 0], face, rows[:, 2:]


def _smoothed(values: NDArray[np.float64], sigma: float) -> NDArray[np.float64]:
    """Smooths with a symmetric kernel, without delay."""
    column = cv2.GaussianBlur(
        values.reshape(-1, 1), (1, 0), sigmaX=0.01, sigmaY=sigma, borderType=cv2.BORDER_REPLICATE
    )
    return np.asarray(column, np.float64).ravel()
