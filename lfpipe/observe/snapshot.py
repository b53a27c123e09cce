"""The state of a session as one plain map, read from the status table alone."""

from __future__ import annotations

from typing import Any

from lfpipe.transport.clock import now_ns
from lfpipe.transport.histogram import summary_ms
from lfpipe.transport.status import State, Table, rate_hz

CORE = ("capture", "track", "render")  # always told of; a stage that few sessions have is, once it has run
QUANTILES = ("p50_ms", "p95_ms", "p99_ms", "max_ms")


def snapshot(session: str, table: Table, started_ns: int) -> dict[str, Any]:
    """`{"session", "uptime_s", "camera_fps", "stages": {...}, "end_to_end": {...}, "horizon": {...}}`, as
    `lfpipe monitor --once --json` prints it.

    A stage's p50_ms.. are its busy time; wait and busy hold both in full. end_to_end: the age of a picture, from the
    sensor's stamp to its presentation. horizon: how far ahead of the sensor's stamp the eyes are predicted, over all refreshes.
    """
    stages: dict[str, Any] = {}
    for name, row in table.rows.items():
        if name not in CORE and row["state"] == State.NONE:
            continue
        wait, busy = summary_ms(row["wait"]), summary_ms(row["busy"])
        stages[name] = {
            "state": State(int(row["state"])).name,
            "pid": int(row["pid"]),
            "fps": round(rate_hz(row), 2),
            **{key: busy[key] for key in QUANTILES},
            "wait": wait,
            "busy": busy,
            "dropped": int(row["drops"]),
            "restarts": int(row["restarts"]),
            "count": int(row["seq"]),
            "cpu_s": round(int(row["cpu_ns"]) / 1e9, 2),
            "face": bool(row["face"]),
        }
    age, horizon = (summary_ms(table.rows["render"][name]) for name in ("age", "horizon"))
    return {
        "session": session,
        "uptime_s": round((now_ns() - started_ns) / 1e9, 2),
        "camera_fps": stages["capture"]["fps"],
        "stages": stages,
        "end_to_end": {"n": age["n"], **{key: age[key] for key in QUANTILES}},
        "horizon": {"n": horizon["n"], **{key: horizon[key] for key in QUANTILES}},
    }
