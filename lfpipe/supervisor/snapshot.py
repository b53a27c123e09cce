"""The state of a session as one plain map, read only from the status table."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lfpipe.host.processes import scheduling
from lfpipe.render.presence import ViewerState
from lfpipe.supervisor.process_table import CORE, SHOWN_BY, SOURCE
from lfpipe.transport.clock import now_ns
from lfpipe.transport.histogram import summary_ms
from lfpipe.transport.status import State, busy_words, rate_hz

FACELESS_S = 4.0  # a head may be turned away briefly
BUSY_SHOWN_S = 0.5  # shorter work is not shown
QUANTILES = ("p50_ms", "p95_ms", "p99_ms", "max_ms")


class StatusRows(Protocol):
    """What `snapshot` reads: a status table, or copies of its rows."""

    @property
    def rows(self) -> dict[str, NDArray[np.void]]:
        """Name of a stage -> record of dtype ROW."""

    @property
    def session(self) -> NDArray[np.void]:
        """Record of dtype SESSION."""


def busy(row: NDArray[np.void]) -> str:
    """The work that blocks a stage, and since when: `reading the recording, 3 s`; empty below BUSY_SHOWN_S."""
    words, since_s = busy_words(row), (now_ns() - int(row["busy_since_ns"])) / 1e9
    return f"{words}, {since_s:.0f} s" if words and since_s > BUSY_SHOWN_S else ""


def quality(table: StatusRows) -> dict[str, Any]:
    """`{"level", "lowest_level", "level_words"}`: 0 for full quality, the last level, what is
    reduced. If read during a change, the words may be those of another level.
    """
    now = table.session
    words = now["words"].item().decode(errors="replace")
    return {"level": int(now["level"]), "lowest_level": int(now["lowest"]), "level_words": words}


def light(table: StatusRows) -> str:
    """`too little light for 30 Hz` if the camera delivers clearly fewer frames than agreed; else empty."""
    row = table.rows[SOURCE]
    return f"too little light for {int(row['nominal_mhz']) / 1000:.3g} Hz" if row["dim"] else ""


def viewer(table: StatusRows) -> str:
    """The viewer's state, a word of `ViewerState`."""
    return ViewerState(int(table.rows[SHOWN_BY]["viewer"])).word


def judder_percent(row: NDArray[np.void]) -> float | None:
    """Refreshes of the screen that showed another picture than planned, in %; None if no screen reports its blanks."""
    planned = int(row["planned"])
    return round(100 * int(row["juddered"]) / planned, 3) if planned else None


def motion_to_photon(row: NDArray[np.void]) -> dict[str, float | None]:
    """`{"onset_ms", "steady_ms"}`: latency at the onset of a motion and steady latency, as docs/photon.md defines them; None
    where nobody has moved yet."""
    return {f"{name}_ms": round(int(row[f"{name}_ns"]) / 1e6, 2) or None for name in ("onset", "steady")}


def notices(table: StatusRows) -> list[str]:
    """Current messages for people, also shown in the window."""
    found, rows = [], table.rows
    capture, shown = rows[SOURCE], rows[SHOWN_BY]
    if capture["state"] == State.READY:
        found.append("camera lost, trying again")
    away_s = (now_ns() - int(shown["t_face_ns"])) / 1e9
    if capture["state"] == State.RUNNING and shown["state"] == State.RUNNING and shown["t_face_ns"] and away_s > FACELESS_S:
        found.append(f"no face for {away_s:.0f} s: move into the camera's view")
    if int(table.session["level"]):
        found.append(f"quality lowered: {quality(table)['level_words']}")
    return found


def snapshot(session: str, table: StatusRows, started_ns: int) -> dict[str, Any]:
    """`{"session", "uptime_s", "camera_fps", "camera_light", "level", "viewer", "stages": {...}, "end_to_end": {...},
    "judder": {...}, "horizon": {...}, "motion_to_photon": {...}}`, as `lfpipe monitor --once --json` prints it.

    A stage's p50_ms.. describe its busy time; wait and busy contain all quantiles. end_to_end: the age of a picture, from the
    sensor's stamp to its presentation. horizon: how far ahead of the sensor's stamp the eyes are predicted, over all refreshes.
    busy_with: see `busy`; level: see `quality`. left_out: inputs left out on purpose; missed: refreshes of
    the display. cpus, nice: from the kernel, now.
    """
    stages: dict[str, Any] = {}
    for name, row in table.rows.items():
        if name not in CORE and row["state"] == State.NONE:
            continue
        cores, nice = scheduling(int(row["pid"]))
        wait, work = summary_ms(row["wait"]), summary_ms(row["busy"])
        stages[name] = {
            "state": State(int(row["state"])).name,
            "busy_with": busy(row),
            "pid": int(row["pid"]),
            "fps": round(rate_hz(row), 2),
            **{key: work[key] for key in QUANTILES},
            "wait": wait,
            "busy": work,
            "dropped": int(row["drops"]),
            "left_out": int(row["left_out"]),
            "missed": int(row["missed"]),
            "restarts": int(row["restarts"]),
            "count": int(row["seq"]),
            "cpu_s": round(int(row["cpu_ns"]) / 1e9, 2),
            "face": bool(row["face"]),
            "cpus": cores,
            "nice": nice,
        }
    shown = table.rows[SHOWN_BY]
    age, horizon = (summary_ms(table.rows[SHOWN_BY][name]) for name in ("age", "horizon"))
    return {
        "session": session,
        "uptime_s": round((now_ns() - started_ns) / 1e9, 2),
        "camera_fps": stages[SOURCE]["fps"],
        "camera_light": light(table),
        **quality(table),
        "viewer": viewer(table),
        "notices": notices(table),
        "stages": stages,
        "end_to_end": {"n": age["n"], **{key: age[key] for key in QUANTILES}},
        "judder": {"planned": int(shown["planned"]), "juddered": int(shown["juddered"]), "percent": judder_percent(shown)},
        "horizon": {"n": horizon["n"], **{key: horizon[key] for key in QUANTILES}},
        "motion_to_photon": motion_to_photon(shown),
    }
