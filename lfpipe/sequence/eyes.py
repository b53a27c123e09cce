"""Eyes in a sequence: those of the mouse that it holds instead of frames, and the true ones of a
generated sequence, with errors against them.
"""

import csv
import json
import os
from array import array
from pathlib import Path

import attrs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfpipe.errors import UserError, quoted
from lfpipe.eyes import EYES, MAX_EYE_PX
from lfpipe.files.safe_files import lines, reason
from lfpipe.files.trace import MAX_NS
from lfpipe.files.untrusted import finite, json_fields
from lfpipe.sequence.packets import COPY, MAX_PACKETS

TRUTH = "truth.csv"
COLUMNS = ("left_x_px", "left_y_px", "right_x_px", "right_y_px")
LINE_BYTES = 4096  # one of ours has some 200
REMEDY = (
    f"write one row per frame with columns t_ns, {', '.join(COLUMNS)}, and optionally visible (0"
    " or 1)"
)


@attrs.frozen(eq=False)
class Truth:
    """Ground truth of a recording."""

    t_ns: NDArray[np.int64]
    """(n,) since the first frame."""
    eyes_px: NDArray[np.float64]
    """(n, 2, 2)."""
    visible: NDArray[np.bool_]
    """(n,): both eyes are in view."""
    still: NDArray[np.bool_] = attrs.Factory(
        lambda self: np.zeros(len(self.t_ns), np.bool_), takes_self=True
    )
    """(n,): the head rests."""

    def at(self, t_ns: ArrayLike) -> NDArray[np.float64]:
        """The eyes (..., 2, 2) px at times (...) after the first frame, between its rows; constant
        before and after them.
        """
        columns = [
            np.interp(np.asarray(t_ns), self.t_ns, column)
            for column in self.eyes_px.reshape(-1, 4).T
        ]
        return np.stack(columns, axis=-1).reshape(*np.shape(t_ns), 2, 2)

    def sees(self, t_ns: ArrayLike) -> NDArray[np.bool_]:
        """Whether both eyes are in view in the frames before and after times (...); not before the
        first and after the last.
        """
        after = np.searchsorted(self.t_ns, t_ns)
        known = (np.asarray(t_ns) >= self.t_ns[0]) & (after < len(self.t_ns))
        return np.asarray(
            known
            & self.visible[np.maximum(after - 1, 0)]
            & self.visible[np.minimum(after, len(self.t_ns) - 1)]
        )

    def error_px(self, eyes_px: ArrayLike, t_ns: ArrayLike) -> NDArray[np.float64]:
        """Root mean square over both eyes (..., 2, 2) of the distance from the truth at times
        (...), px; NaN where hidden.
        """
        error_px = np.sqrt(np.square(np.subtract(eyes_px, self.at(t_ns))).sum(axis=(-2, -1)) / 2)
        return np.where(self.sees(t_ns), error_px, np.nan)


def eyes_line(record: NDArray[np.void], **stamps: int) -> bytes:
    """A record of dtype EYES as a packet: a line of JSON."""
    return (
        json.dumps(
            {**stamps, **{name: record[name].tolist() for name in EYES.names or ()}}
        ).encode()
        + b"\n"
    )


def eyes_of(line: bytes, where: str) -> NDArray[np.void]:
    """The record of dtype EYES in a line of `eyes_line`; what it does not name is 0.

    Raises UserError.
    """
    fields = json_fields(line, where, COPY)
    record = np.zeros((), EYES)
    # which its player sets
    for name in set(EYES.names or ()) & fields.values.keys() - {"t_tracked_ns"}:
        most = 1 if name == "face" else MAX_EYE_PX
        shape = record[name].shape
        try:
            value = np.asarray(fields.values[name], np.float64)
        except (ValueError, TypeError):
            value = np.array(np.nan)
        if value.shape != shape or not (np.abs(value) <= most).all():
            expected = f"{'x'.join(map(str, shape))} numbers" if shape else "a number"
            raise UserError(
                f"{where}: {name} is {quoted(fields.values[name])}, expected {expected} up to"
                f" {most:g}",
                COPY,
            )
        record[name] = value
    return record


def read_truth(folder: Path) -> Truth | None:
    """The truth of the sequence in folder, or None. Raises UserError if it cannot be read."""
    path = folder / TRUTH
    return table_of(path) if os.path.lexists(path) else None


def table_of(path: Path) -> Truth:
    """The truth in a table. Raises UserError with the wrong row and column."""
    stamps = array("q")
    numbers = array("d")
    visible = bytearray()
    still = bytearray()
    where = str(path)
    try:
        table = csv.DictReader(
            (line.decode() for _, line in lines(path, LINE_BYTES, REMEDY)), strict=True
        )
        columns = list(table.fieldnames or ())
        if missing := [name for name in ("t_ns", *COLUMNS) if columns.count(name) != 1]:
            raise UserError(
                f"{path}: not a table of true eyes: column {missing[0]} must exist exactly once",
                REMEDY,
            )
        for row in table:
            where = f"{path}:{table.line_num}"
            if None in row or None in row.values():
                raise ValueError(f"expected {len(columns)} values")
            for name in COLUMNS:
                if (px := finite(row[name], -MAX_EYE_PX, MAX_EYE_PX)) is None:
                    raise UserError(
                        f"{where}: {name} is {quoted(row[name])}, expected a number of px", REMEDY
                    )
                numbers.append(px)
            t_ns = int(row["t_ns"])
            last_ns = stamps[-1] if stamps else -MAX_NS - 1
            if not last_ns < t_ns <= MAX_NS:
                raise UserError(
                    f"{where}: times must rise: t_ns is {quoted(t_ns)}, after {last_ns}", REMEDY
                )
            if len(stamps) == MAX_PACKETS:
                raise UserError(f"{where}: more than {MAX_PACKETS} rows", REMEDY)
            stamps.append(t_ns)
            visible.append(row.get("visible") != "0")
            still.append(row.get("phase") == "still")
    except (csv.Error, ValueError) as error:
        raise UserError(f"{where}: not a line of a table: {error}", REMEDY) from None
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {reason(error)}", REMEDY) from None
    if not stamps:
        raise UserError(f"{path}: contains no row", REMEDY)
    t_ns_of = np.array(stamps, np.int64)
    points = np.array(numbers).reshape(-1, 2, 2)
    return Truth(
        t_ns_of - t_ns_of[0], points, np.array(visible, np.bool_), np.array(still, np.bool_)
    )


def summary(errors_px: NDArray[np.float64]) -> dict[str, float] | None:
    """{"n", "rms_px", "p95_px", "max_px"} of the errors that are numbers; None without any."""
    errors = errors_px[np.isfinite(errors_px)]
    if not len(errors):
        return None
    metrics = {
        "rms_px": np.sqrt(np.mean(errors**2)),
        "p95_px": np.percentile(errors, 95),
        "max_px": errors.max(),
    }
    return {"n": len(errors), **{name: round(float(value), 4) for name, value in metrics.items()}}
