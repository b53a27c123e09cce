"""A trace as an MCAP file, which Foxglove plots.

    /picture   lfpipe.Picture   the line of the trace
    /latency   lfpipe.Latency   ms of each stage, and the picture's age when presented

The time of a message is when its picture was presented, on CLOCK_MONOTONIC.
"""

import json
from pathlib import Path

from lfpipe.files.mcap_file import McapFile, schema
from lfpipe.files.trace import trace_lines

NUMBER, COUNT, FLAG = {"type": "number"}, {"type": "integer"}, {"type": "boolean"}
SIDES = {"type": "object", "properties": {side: {"type": "array", "items": NUMBER} for side in ("left", "right")}}
STAGES = {  # ms from one stamp to another
    "capture_ms": ("t_sensor_ns", "t_read_ns"),
    "track_ms": ("t_read_ns", "t_tracked_ns"),
    "render_ms": ("t_started_ns", "t_composed_ns"),
    "display_ms": ("t_composed_ns", "t_presented_ns"),
    "age_ms": ("t_sensor_ns", "t_presented_ns"),
}


def convert_mcap(source: Path, out: Path) -> int:
    """Writes the JSON Lines trace `source` to the new file out; returns the number of pictures. Raises UserError."""
    count = 0
    with McapFile(out) as file:
        picture = {"source_seq": COUNT, "face": FLAG, "composed": FLAG, "eyes_used": SIDES, "view": SIDES}
        file.channel("/picture", "lfpipe.Picture", schema("lfpipe.Picture", **picture))
        file.channel("/latency", "lfpipe.Latency", schema("lfpipe.Latency", **dict.fromkeys(STAGES, NUMBER)))
        for fields in trace_lines(source, "a trace written by `lfpipe up --trace`"):
            line = fields.values
            t_ns = max(0, int(line["t_presented_ns"]))
            spans = {name: (a, b) for name, (a, b) in STAGES.items() if a in line and b in line}
            latency = {name: (line[b] - line[a]) / 1e6 for name, (a, b) in spans.items()}
            file.message("/picture", t_ns, json.dumps(line).encode())
            file.message("/latency", t_ns, json.dumps(latency).encode())
            count += 1
    return count
