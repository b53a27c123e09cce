"""Where the eyes really are in a made sequence, and how far off a measurement or a picture was."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.sequence.folder import TRUTH

COLUMNS = ("left_x_px", "left_y_px", "right_x_px", "right_y_px")


@attrs.frozen(eq=False)
class Truth:
    """t_ns: (n,) since the first frame. eyes_px: (n, 2, 2). visible: (n,), whether both eyes are in the picture."""

    t_ns: NDArray[np.int64]
    eyes_px: NDArray[np.float64]
    visible: NDArray[np.bool_]

    def at(self, t_ns: int) -> NDArray[np.float64] | None:
        """The eyes t_ns after the first frame, (2, 2) px, on the line between frames; None outside or while they are hidden."""
        if not self.t_ns[0] <= t_ns <= self.t_ns[-1]:
            return None
        after = int(np.searchsorted(self.t_ns, t_ns))
        before = max(after - 1, 0)
        if not (self.visible[before] and self.visible[after]):
            return None
        step_ns = int(self.t_ns[after] - self.t_ns[before])
        share = (t_ns - int(self.t_ns[before])) / step_ns if step_ns else 0.0
        return np.asarray(self.eyes_px[before] + share * (self.eyes_px[after] - self.eyes_px[before]), np.float64)

    def error_px(self, eyes_px: Any, t_ns: int) -> float | None:
        """Root mean square over both eyes of the distance from the truth at t_ns, px."""
        true = self.at(t_ns)
        return None if true is None else float(np.sqrt(np.square(np.subtract(eyes_px, true)).sum() / 2))


def read_truth(folder: Path) -> Truth | None:
    """The truth of the sequence in folder; None where it has none. Raises UserError where it cannot be read."""
    path = folder / TRUTH
    if not path.exists():
        return None
    try:
        with path.open(newline="") as file:
            rows = list(csv.DictReader(file))
        t_ns = np.array([int(row["t_ns"]) for row in rows], np.int64)
        eyes = np.array([[float(row[name]) for name in COLUMNS] for row in rows], np.float64).reshape(-1, 2, 2)
        visible = np.array([row.get("visible", "1") != "0" for row in rows], np.bool_)
    except (OSError, KeyError, ValueError, TypeError) as error:
        raise UserError(f"{path}: not a table of true eyes: {error!r}", f"columns t_ns, {', '.join(COLUMNS)}, visible") from None
    if len(t_ns) < 2 or np.any(np.diff(t_ns) <= 0):
        raise UserError(f"{path}: its times do not rise", "one row per frame, t_ns from the first frame on")
    return Truth(t_ns - t_ns[0], eyes, visible)


def summary(errors_px: list[float]) -> dict[str, float] | None:
    """{"n", "rms_px", "p95_px", "max_px"}; None where there is nothing to sum up."""
    if not errors_px:
        return None
    found = np.array(errors_px)
    rms, p95 = float(np.sqrt(np.mean(found**2))), float(np.percentile(found, 95))
    return {"n": len(errors_px), "rms_px": round(rms, 4), "p95_px": round(p95, 4), "max_px": round(float(found.max()), 4)}
