"""The trace as Chrome trace-event JSON for Perfetto and chrome://tracing: one track per stage.

Slices: capture from the sensor's stamp to the decoded frame, track from there to its eyes, render
while a picture is composed, display until it is presented. Format: "Trace Event Format" (Google,
2016) with complete events X and metadata M.
"""

import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from lfpipe.errors import UserError
from lfpipe.files.output import PLACE, check_output
from lfpipe.files.safe_files import reason, replaced
from lfpipe.files.trace import trace_lines
from lfpipe.supervisor.process_table import CORE
from lfpipe.transport.control import FILE_CHECK_TIMEOUT_S, Message

TRACKS = (*CORE, "display")
PID = 1
# sends the session a command, perhaps with timeout_s; returns its answer
Ask = Callable[..., Message]


def events(trace: Iterable[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Trace events of a trace's objects. Times in microseconds of CLOCK_MONOTONIC."""
    yield {"name": "process_name", "ph": "M", "pid": PID, "tid": 0, "args": {"name": "lfpipe"}}
    for tid, name in enumerate(TRACKS, 1):
        yield {"name": "thread_name", "ph": "M", "pid": PID, "tid": tid, "args": {"name": name}}
        yield {
            "name": "thread_sort_index",
            "ph": "M",
            "pid": PID,
            "tid": tid,
            "args": {"sort_index": tid},
        }
    end_ns = dict.fromkeys(TRACKS, 0)

    def slice_of(name: str, start: int, end: int, **about: Any) -> dict[str, Any]:
        """A slice, shortened so that slices of a track do not overlap: viewers would nest them."""
        start = max(start, end_ns[name])
        end_ns[name] = end = max(end, start)
        return {
            "name": name,
            "cat": "stage",
            "ph": "X",
            "pid": PID,
            "tid": TRACKS.index(name) + 1,
            "ts": start / 1e3,
            "dur": (end - start) / 1e3,
            "args": {"source_seq": line["source_seq"], "epoch": line["epoch"], **about},
        }

    before = None
    for line in trace:
        if (line["epoch"], line["source_seq"]) != before:
            before = line["epoch"], line["source_seq"]
            yield slice_of("capture", line["t_sensor_ns"], line["t_read_ns"])
            yield slice_of("track", line["t_read_ns"], line["t_tracked_ns"], face=line["face"])
        if line["composed"]:
            started_ns = line.get("t_started_ns", line["t_tracked_ns"])
            composed_ns = line["t_composed_ns"]
            presented_ns = line["t_presented_ns"] or composed_ns  # 0: replaced before it was seen
            yield slice_of(
                "render", started_ns, composed_ns, method=line["method"], view=line["view"]
            )
            age_ms = (presented_ns - line["t_sensor_ns"]) / 1e6
            yield slice_of("display", composed_ns, presented_ns, age_ms=age_ms)


def convert(source: Path, out: Path, overwrite: bool = False) -> None:
    """Writes the JSON Lines trace `source` as trace events to `out`, readable by its owner only.
    Raises UserError and leaves out unchanged.
    """
    check_output(out, [source], overwrite)
    remedy = "name a trace of `lfpipe up --trace` or `lfpipe trace start`"
    lines = (fields.values for fields in trace_lines(source, remedy))
    try:
        with replaced(out) as file:
            for number, event in enumerate(events(lines)):
                start = b",\n" if number else b'{"displayTimeUnit": "ms", "traceEvents": [\n'
                file.write(start + json.dumps(event).encode())
            file.write(b"\n]}\n")
    except OSError as error:
        raise UserError(f"{out}: {reason(error)}", PLACE) from None


def begin_trace(ask: Ask, out: Path | None) -> Path:
    """Starts a trace of a running session, in a new file in this folder if out is None.

    Returns its path. Raises UserError.
    """
    out = (out or Path(time.strftime("lfpipe-%Y%m%d-%H%M%S.jsonl"))).absolute()
    ask({"cmd": "trace", "path": str(out)}, FILE_CHECK_TIMEOUT_S)
    return out


def finish_trace(ask: Ask) -> Path:
    """Ends the trace that `begin_trace` started. Returns its path. Raises UserError if none
    runs.
    """
    return Path(ask({"cmd": "trace", "path": ""})["path"])
