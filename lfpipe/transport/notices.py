"""What people should know, in words: the window and every monitor say the same."""

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from lfpipe.transport.clock import SECOND_NS, now_ns
from lfpipe.transport.histogram import Times, quantiles
from lfpipe.transport.status import State

FACELESS_NS = 4 * SECOND_NS  # a head may be turned away briefly
FAULT_NS = 2 * SECOND_NS  # a part that fails for a few frames works again
NO_FACE = "no face"  # such a notice begins with it
# A filter passes on its first measurement unchanged, whatever it does with the next ones.
WORKED_SHARE = 0.05
Rows = Mapping[str, NDArray[np.void]]


def faults(rows: Rows, t_ns: int) -> Iterator[tuple[str, bool]]:
    """Yields which part of a stage does not work, and whether it ever has. t_ns: now."""
    for row in rows.values():
        words = row["fault"].item().decode(errors="replace")
        if words and t_ns - int(row["fault_since_ns"]) > FAULT_NS:
            yield words, bool(row["outputs_ok"] > WORKED_SHARE * row["outputs_faulty"])


def notices(rows: Rows, source: str, shows: str) -> list[str]:
    """The notices, the most urgent alone. source, shows: names of the stages that make frames and
    show pictures.
    """
    t_ns = now_ns()
    if rows[source]["state"] == State.READY:
        return ["camera lost, trying again"]
    if broken := [f"{words}: the picture does not follow you" for words, _ in faults(rows, t_ns)]:
        return broken
    running = all(rows[name]["state"] == State.RUNNING for name in (source, shows))
    t_face_ns = int(rows[shows]["t_face_ns"])
    if running and t_face_ns and t_ns - t_face_ns > FACELESS_NS:
        seconds = (t_ns - t_face_ns) // SECOND_NS
        return [f"{NO_FACE} for {seconds} s: move into the camera's view"]
    return []


def latency_lines(age: Times, prediction: Times, vblanks: bool) -> list[str]:
    """The age of the pictures, at their blanks or at their hand-over, and how far ahead the eyes
    are predicted: a line each, as far as they are known.
    """
    lines = []
    if age["n"]:
        at = "its blank" if vblanks else "hand-over"
        metrics = quantiles(age, "p50_ms", "p95_ms", "p99_ms", "max_ms")
        lines.append(f"age of the picture at {at}: {metrics}")
    if prediction["n"]:
        metrics = quantiles(prediction, "p50_ms", "p95_ms")
        lines.append(f"eyes predicted ahead of the sensor by {metrics}")
    return lines
