"""The state of a session as one plain map, from the status table alone."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfpipe.host.processes import usable_cores
from lfpipe.render.presence import ViewerState
from lfpipe.supervisor.process_table import CORE, SHOWN_BY, SOURCE, TRACKED_BY
from lfpipe.transport.clock import now_ns
from lfpipe.transport.histogram import summary_ms
from lfpipe.transport.status import State, busy_words, rate_hz

FACELESS_S = 4.0  # a head may be turned away briefly
BUSY_SHOWN_S = 0.5  # shorter work is not shown
QUANTILES = ("p50_ms", "p95_ms", "p99_ms", "max_ms")


def _notices(source: NDArray[np.void], display: NDArray[np.void], lowered: str) -> Iterator[str]:
    """Current messages for people, also shown in the window. lowered: what is reduced."""
    if source["state"] == State.READY:
        yield "camera lost, trying again"
    away_s = (now_ns() - int(display["t_face_ns"])) / 1e9
    if (
        source["state"] == State.RUNNING
        and display["state"] == State.RUNNING
        and display["t_face_ns"]
        and away_s > FACELESS_S
    ):
        yield f"no face for {away_s:.0f} s: move into the camera's view"
    if lowered:
        yield f"quality lowered: {lowered}"


def _stage(row: NDArray[np.void]) -> dict[str, Any]:
    wait, work = summary_ms(row["wait"]), summary_ms(row["busy"])
    words, since_s = busy_words(row), (now_ns() - int(row["busy_since_ns"])) / 1e9
    return {
        "state": State(int(row["state"])).name,
        "busy_with": f"{words}, {since_s:.0f} s" if words and since_s > BUSY_SHOWN_S else "",
        "fps": round(rate_hz(row), 2),
        **{key: work[key] for key in QUANTILES},
        "wait": wait,
        "busy": work,
        "dropped": int(row["drops"]),
        "count": int(row["seq"]),
        **{name: int(row[name]) for name in ("pid", "left_out", "missed", "restarts")},
        "cpu_s": round(int(row["cpu_ns"]) / 1e9, 2),
        "face": bool(row["face"]),
        "cpus": usable_cores(pid) if (pid := int(row["pid"])) else [],
    }


def snapshot(
    session: str, rows: Mapping[str, NDArray[np.void]], quality: NDArray[np.void], started_ns: int
) -> dict[str, Any]:
    """`{"session", "uptime_s", "camera_fps", "camera_light", "level", "viewer", "stages": {...}, "end_to_end": {...},
    "judder": {...}, "horizon": {...}, "motion_to_photon": {...}}`, as `lfpipe monitor --once --json` prints it.

    rows: of the stages, dtype ROW. quality: dtype SESSION.

    Of a stage: p50_ms.. describe its busy time; wait and busy contain all quantiles; busy_with: the work that blocks it, and
    since when; left_out: inputs left out on purpose; missed: refreshes of the display; cpus: the cores it may use now.
    end_to_end: the age of a picture, from the sensor's stamp to its presentation. horizon: how far ahead of the sensor's stamp
    the eyes are predicted. camera_light: words if the camera delivers clearly fewer frames than agreed. level, lowest_level: of
    quality, 0 is full; level_words: what is reduced, perhaps of another level during a change. viewer: a word of `ViewerState`.
    judder: refreshes that showed another picture than planned; percent: None if no screen reports its blanks.
    motion_to_photon: latency at the onset of a motion and steady, see docs/photon.md; None where nobody has moved.
    """
    stages = {
        name: _stage(row)
        for name, row in rows.items()
        if name in CORE or row["state"] != State.NONE
    }
    source, display = rows[SOURCE], rows[SHOWN_BY]
    viewer = ViewerState(int(display["viewer"]))
    if (
        display["state"] == State.NONE and rows[TRACKED_BY]["face"]
    ):  # without a picture nobody follows where the viewer sits
        viewer = ViewerState.SEATED
    level, words, planned = (
        int(quality["level"]),
        quality["words"].item().decode(errors="replace"),
        int(display["planned"]),
    )
    return {
        "session": session,
        "uptime_s": round((now_ns() - started_ns) / 1e9, 2),
        "camera_fps": stages[SOURCE]["fps"],
        "camera_light": f"too little light for {int(source['nominal_mhz']) / 1000:.3g} Hz"
        if source["dim"]
        else "",
        "level": level,
        "lowest_level": int(quality["lowest"]),
        "level_words": words,
        "viewer": viewer.word,
        "notices": list(_notices(source, display, words if level else "")),
        "stages": stages,
        "end_to_end": summary_ms(display["age"]),
        "judder": {
            "planned": planned,
            "juddered": int(display["juddered"]),
            "percent": round(100 * int(display["juddered"]) / planned, 3) if planned else None,
        },
        "horizon": summary_ms(display["horizon"]),
        "motion_to_photon": {
            f"{name}_ms": round(int(display[f"{name}_ns"]) / 1e6, 2) or None
            for name in ("onset", "steady")
        },
    }
