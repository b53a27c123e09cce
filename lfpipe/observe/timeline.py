"""The trace as Chrome trace-event JSON, which Perfetto and chrome://tracing open: a track per stage, arrows along a frame.

Slices: capture from the sensor's stamp to the decoded frame, track from there to its eyes, render while a picture is composed,
display until it is presented. Format: "Trace Event Format" (Google, 2016) with complete events X, flows s, t and f, and
metadata M.
"""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from lfpipe.errors import UserError
from lfpipe.files.output import PLACE, check_output, finished_output
from lfpipe.files.safe_files import reason
from lfpipe.files.trace import trace_lines
from lfpipe.supervisor.process_table import CORE

TRACKS = (*CORE, "display")
PID = 1


class _Track:
    """Slices of one track, shortened so that they do not overlap: viewers would nest overlapping slices."""

    def __init__(self, name: str) -> None:
        self.name, self.tid, self._end_ns = name, TRACKS.index(name) + 1, 0

    def slice(self, start_ns: int, end_ns: int, args: dict[str, Any]) -> dict[str, Any]:
        start_ns = max(start_ns, self._end_ns)
        self._end_ns = end_ns = max(end_ns, start_ns)
        times = {"ts": start_ns / 1e3, "dur": (end_ns - start_ns) / 1e3}
        return {"name": self.name, "cat": "stage", "ph": "X", "pid": PID, "tid": self.tid, **times, "args": args}


def events(trace: Iterable[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Trace events of a trace's objects. Times in microseconds of CLOCK_MONOTONIC."""
    yield {"name": "process_name", "ph": "M", "pid": PID, "tid": 0, "args": {"name": "lfpipe"}}
    for index, name in enumerate(TRACKS):
        about = {"pid": PID, "tid": index + 1}
        yield {"name": "thread_name", "ph": "M", **about, "args": {"name": name}}
        yield {"name": "thread_sort_index", "ph": "M", **about, "args": {"sort_index": index}}
    capture, track, render, display = (_Track(name) for name in TRACKS)
    before = None
    for line in trace:
        frame = (line["epoch"], line["source_seq"])
        args = {"source_seq": line["source_seq"], "epoch": line["epoch"]}
        flow = {"name": "frame", "cat": "frame", "pid": PID, "id": f"{frame[0]}.{frame[1]}"}
        made: list[tuple[str, dict[str, Any]]] = []
        if frame != before:
            before, shown = frame, False
            made.append(("s", capture.slice(line["t_sensor_ns"], line["t_read_ns"], args)))
            made.append(("t", track.slice(line["t_read_ns"], line["t_tracked_ns"], {**args, "face": line["face"]})))
        if line["composed"]:
            what = {**args, "method": line["method"], "view": line["view"]}
            drawn = render.slice(line.get("t_started_ns", line["t_tracked_ns"]), line["t_composed_ns"], what)
            presented_ns = line["t_presented_ns"] or line["t_composed_ns"]  # 0: replaced before it was seen
            age_ms = (presented_ns - line["t_sensor_ns"]) / 1e6
            put = display.slice(line["t_composed_ns"], presented_ns, {**args, "age_ms": age_ms})
            made += [("" if shown else "t", drawn), ("" if shown else "f", put)]
            shown = True  # later pictures of the same frame are predictions from it: one arrow is enough
        for kind, piece in made:
            yield piece
            if kind:  # an arrow is bound to the slice around its time
                end = {"bp": "e"} if kind == "f" else {}
                yield {**flow, "ph": kind, "tid": piece["tid"], "ts": piece["ts"] + piece["dur"] / 2, **end}


def convert(source: Path, out: Path) -> None:
    """Writes the JSON Lines trace `source` as trace events to `out`, for its owner alone. Raises UserError; out then stays as it
    was."""
    check_output(out, [source])
    lines = (fields.values for fields in trace_lines(source, "a trace written by `lfpipe up --trace`"))
    try:
        with finished_output(out) as output:
            for number, event in enumerate(events(lines)):
                start = b",\n" if number else b'{"displayTimeUnit": "ms", "traceEvents": [\n'
                output.file.write(start + json.dumps(event).encode())
            output.file.write(b"\n]}\n")
    except OSError as error:
        raise UserError(f"{out}: {reason(error)}", PLACE) from None


def finish_trace(ask: Callable[[dict[str, Any]], dict[str, Any]], out: Path | None) -> Path:
    """Ends the running timeline, converts it and removes the raw lines. Returns its path.

    ask: sends the session a command. out: the file, None for the one given at the start. Raises UserError if no timeline is
    running, or if out cannot be written. In that case the timeline continues, or its raw lines are kept.
    """
    if out is not None:
        check_output(out)
    part = Path(ask({"cmd": "trace", "path": ""})["path"])
    out = out or part.with_suffix("")
    try:
        convert(part, out)
    except UserError as error:
        raise UserError(error.message, f"its lines are kept as {part}; start another one, where there is room") from None
    part.unlink(missing_ok=True)
    return out
