"""The state of a session, read from the status table alone: the one source of `lfpipe monitor`, its
page, `ctl status`, `--json`, and the end of `lfpipe up`.
"""

from collections.abc import Mapping
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.host.processes import usable_cores
from lfpipe.render.viewer.presence import ViewerState
from lfpipe.supervisor.process_table import CORE, SHOWN_BY, SOURCE, TRACKED_BY
from lfpipe.transport.clock import now_ns
from lfpipe.transport.histogram import Times, summary_ms
from lfpipe.transport.notices import notices
from lfpipe.transport.status import State, busy_words, rate_hz

BUSY_SHOWN_S = 0.5  # shorter work is not shown


@attrs.frozen(kw_only=True)
class StageMetrics:
    """One stage."""

    state: str  # a name of `State`
    busy_with: str  # the work that blocks it, and since when; "" if none
    fps: float  # outputs per second
    # of its busy time
    p50_ms: float
    p95_ms: float
    p99_ms: float
    max_ms: float
    wait: Times  # from publication by the previous stage until taken by this one
    busy: Times  # from taken to published
    dropped: int  # inputs that it lost
    count: int  # outputs
    pid: int
    left_out: int  # inputs left out on purpose
    missed: int  # refreshes of the display without a picture from it
    restarts: int
    cpu_s: float
    face: bool
    cpus: list[int]  # the cores that it may use now
    # of a monitor that watches for a while
    cpu_percent: float | None = None
    rss_mb: float | None = None

    @classmethod
    def of(cls, row: NDArray[np.void]) -> "StageMetrics":
        """The figures in a row of the table."""
        busy = summary_ms(row["busy"])
        words = busy_words(row)
        since_s = (now_ns() - int(row["busy_since_ns"])) / 1e9
        pid = int(row["pid"])
        return cls(
            state=State(int(row["state"])).name,
            busy_with=f"{words}, {since_s:.0f} s" if words and since_s > BUSY_SHOWN_S else "",
            fps=round(rate_hz(row), 2),
            p50_ms=busy["p50_ms"],
            p95_ms=busy["p95_ms"],
            p99_ms=busy["p99_ms"],
            max_ms=busy["max_ms"],
            wait=summary_ms(row["wait"]),
            busy=busy,
            dropped=int(row["drops"]),
            count=int(row["seq"]),
            pid=pid,
            left_out=int(row["left_out"]),
            missed=int(row["missed"]),
            restarts=int(row["restarts"]),
            cpu_s=round(int(row["cpu_ns"]) / 1e9, 2),
            face=bool(row["face"]),
            cpus=usable_cores(pid) if pid else [],
        )


@attrs.frozen(kw_only=True)
class Judder:
    """Refreshes of a screen that reports its blanks."""

    planned: int
    juddered: int  # those that showed another picture than planned
    percent: float | None  # None if no screen reports its blanks


@attrs.frozen(kw_only=True)
class MotionToPhoton:
    """Latency of the picture behind the viewer, see docs/photon.md; None where nobody has moved."""

    onset_ms: float | None
    steady_ms: float | None


@attrs.frozen(kw_only=True)
class SessionMetrics:
    """A session, as `lfpipe monitor --once --json` prints it."""

    session: str
    uptime_s: float
    camera_fps: float
    camera_light: str  # words if the camera delivers clearly fewer frames than agreed
    level: int  # of quality; 0 is full
    lowest_level: int
    level_words: str  # what is reduced; perhaps of another level during a change
    viewer: str  # a word of `ViewerState`
    notices: list[str]  # for people
    stages: dict[str, StageMetrics]
    end_to_end: Times  # age of a picture, from the sensor's stamp to its presentation
    judder: Judder
    prediction: Times  # how far ahead of the sensor's stamp the eyes are predicted
    motion_to_photon: MotionToPhoton

    @property
    def used_stages(self) -> dict[str, StageMetrics]:
        """The stages that the session has needed."""
        return {name: stage for name, stage in self.stages.items() if stage.state != "NONE"}

    def to_dict(self) -> dict[str, Any]:
        """As plain values, for JSON and messages."""
        return attrs.asdict(
            self, filter=lambda field, value: field.name not in EXTRA or value is not None
        )


EXTRA = ("cpu_percent", "rss_mb")  # present only if known


def session_metrics(
    session: str, rows: Mapping[str, NDArray[np.void]], quality: NDArray[np.void], started_ns: int
) -> SessionMetrics:
    """The figures of a session. rows: of the stages, dtype ROW. quality: dtype SESSION."""
    source, display = rows[SOURCE], rows[SHOWN_BY]
    viewer = ViewerState(int(display["viewer"]))
    # without pictures, no stage follows the viewer
    if display["state"] == State.NONE and rows[TRACKED_BY]["face"]:
        viewer = ViewerState.SEATED
    level = int(quality["level"])
    words = quality["words"].item().decode(errors="replace")
    planned, juddered = int(display["planned"]), int(display["juddered"])
    light = f"too little light for {int(source['nominal_mhz']) / 1000:.3g} Hz"
    now = notices(rows, SOURCE, SHOWN_BY)
    stages = {
        name: StageMetrics.of(row)
        for name, row in rows.items()
        if name in CORE or row["state"] != State.NONE
    }
    return SessionMetrics(
        session=session,
        uptime_s=round((now_ns() - started_ns) / 1e9, 2),
        camera_fps=stages[SOURCE].fps,
        camera_light=light if source["dim"] else "",
        level=level,
        lowest_level=int(quality["lowest"]),
        level_words=words,
        viewer=viewer.word,
        notices=[*now, f"quality lowered: {words}"] if level else now,
        stages=stages,
        end_to_end=summary_ms(display["age"]),
        judder=Judder(
            planned=planned,
            juddered=juddered,
            percent=round(100 * juddered / planned, 3) if planned else None,
        ),
        prediction=summary_ms(display["prediction"]),
        motion_to_photon=MotionToPhoton(
            onset_ms=round(int(display["onset_ns"]) / 1e6, 2) or None,
            steady_ms=round(int(display["steady_ns"]) / 1e6, 2) or None,
        ),
    )
