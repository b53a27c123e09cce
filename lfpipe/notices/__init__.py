"""User-facing notices, shared by the window and the monitors."""

from collections.abc import Iterator, Mapping
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.transport.ring import SECOND_NS, now_ns
from lfpipe.transport.status import State, Times, quantiles

FACELESS_NS = 4 * SECOND_NS  # a head may be turned away briefly
FAULT_NS = 2 * SECOND_NS  # a part that fails for a few frames works again
# A filter passes on its first measurement unchanged, whatever it does with the next ones.
WORKED_SHARE = 0.05
Rows = Mapping[str, NDArray[np.void]]


@attrs.frozen
class Notice:
    """A condition that people should know about while it lasts."""

    text: str
    nobody: bool = False
    """Whether it is that nobody is seen."""


@attrs.frozen
class Fault:
    """A part of a stage that does not work."""

    text: str
    has_worked: bool
    """Whether it worked before."""


def faults(rows: Rows, t_ns: int) -> Iterator[Fault]:
    """Yields the parts of stages that do not work. t_ns: now."""
    for row in rows.values():
        text = row["fault"].item().decode(errors="replace")
        if text and t_ns - int(row["fault_since_ns"]) > FAULT_NS:
            yield Fault(text, bool(row["outputs_ok"] > WORKED_SHARE * row["outputs_faulty"]))


def notices(
    rows: Rows, source: str, shows: str, t_face_ns: int, frames: Mapping[str, Any]
) -> list[Notice]:
    """The notices, the most urgent alone. source, shows: names of the stages that make frames and
    show pictures. t_face_ns: when a picture was last made for a face; 0: never. frames: the
    metrics of the source.
    """
    t_ns = now_ns()
    if rows[source]["state"] == State.READY:
        return [Notice("camera lost, trying again")]
    if broken := list(faults(rows, t_ns)):
        return [Notice(f"{fault.text}: the picture does not follow you") for fault in broken]
    if frames["covered"]:
        return [Notice("the camera is covered, or its shutter closed: its frames show nothing")]
    running = all(rows[name]["state"] == State.RUNNING for name in (source, shows))
    if running and t_face_ns and t_ns - t_face_ns > FACELESS_NS:
        seconds = (t_ns - t_face_ns) // SECOND_NS
        return [Notice(f"no face for {seconds} s: move into the camera's view", nobody=True)]
    return []


def latency_lines(age: Times, prediction: Times, vblanks: bool) -> list[str]:
    """The age of the pictures, at their vertical blank or at submission, and how far ahead the eyes
    are predicted: a line each, as far as they are known.
    """
    lines = []
    if age["n"]:
        at = "vertical blank" if vblanks else "submission"
        metrics = quantiles(age, "p50_ms", "p95_ms", "p99_ms", "max_ms")
        lines.append(f"age of the picture at {at}: {metrics}")
    if prediction["n"]:
        metrics = quantiles(prediction, "p50_ms", "p95_ms")
        lines.append(f"eyes predicted ahead of the sensor by {metrics}")
    return lines
