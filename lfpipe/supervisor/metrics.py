"""The state of a session, read from the status table alone: the common source of `lfpipe monitor`,
its page, `ctl status`, `--json`, and the end of `lfpipe up`.
"""

from collections.abc import Mapping
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.host.worker import usable_cores
from lfpipe.notices import notices
from lfpipe.supervisor.process_table import CORE, SHOWN_BY, SOURCE, TRACKED_BY
from lfpipe.transport.ring import now_ns
from lfpipe.transport.status import MetricSet, State, Times, busy_work, rate_hz, summary_ms

SEATED = "seated"  # the viewer of a session without pictures, while tracking sees a face


@attrs.frozen(kw_only=True)
class StageMetrics:
    """One stage."""

    state: str
    """A name of `State`."""
    busy_with: str
    """The work that blocks it, with its duration; "" if none."""
    fps: float
    """Outputs per second."""
    p50_ms: float
    """Of its busy time."""
    p95_ms: float
    p99_ms: float
    max_ms: float
    wait: Times
    """From publication by the previous stage until taken by this one."""
    busy: Times
    """From taken to published."""
    dropped: int
    """Inputs that it lost."""
    count: int
    """Outputs."""
    pid: int
    left_out: int
    """Inputs skipped on purpose."""
    missed: int
    """Refreshes of the display without a picture from it."""
    restarts: int
    cpu_s: float
    face: bool
    """Whether its newest input showed a face."""
    cpus: list[int]
    """The cores that it may use now."""
    metrics: dict[str, Any]
    """The metrics that it declares, by name: of type `transport.metrics.Value`."""
    cpu_percent: float | None = None
    """Known to monitors that follow a session."""
    rss_mb: float | None = None

    @classmethod
    def of(cls, row: NDArray[np.void], declared: MetricSet) -> "StageMetrics":
        """The metrics in a row of the table."""
        busy = summary_ms(row["busy"])
        metrics = declared.read(row)
        work = busy_work(row)
        since_s = (now_ns() - int(row["busy_since_ns"])) / 1e9
        pid = int(row["pid"])
        return cls(
            state=State(int(row["state"])).name,
            busy_with=f"{work}, {since_s:.0f} s" if work and since_s > 0.5 else "",
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
            face=bool(metrics.get("face")),
            cpus=usable_cores(pid) if pid else [],
            metrics=metrics,
        )


@attrs.frozen(kw_only=True)
class Judder:
    """Refreshes of a screen that reports its vertical blanks."""

    planned: int
    juddered: int
    """Those that showed another picture than planned."""
    percent: float | None
    """None if no screen reports its vertical blanks."""


@attrs.frozen(kw_only=True)
class MotionToPhoton:
    """Latency of the picture behind the viewer, see docs/photon.md; None without head motion."""

    onset_ms: float | None
    steady_ms: float | None


@attrs.frozen(kw_only=True)
class SessionMetrics:
    """A session, as `lfpipe monitor --once --json` prints it."""

    session: str
    uptime_s: float
    camera_fps: float
    level: int
    """Of quality; 0 is full."""
    lowest_level: int
    level_words: str
    """The reductions; during a change, possibly those of another level."""
    viewer: str
    """The viewer's presence."""
    notices: list[str]
    """For people."""
    stages: dict[str, StageMetrics]
    end_to_end: Times
    """Age of a picture, from the sensor's stamp to its presentation."""
    judder: Judder
    prediction: Times
    """How far ahead of the sensor's stamp the eyes are predicted."""
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
    session: str,
    rows: Mapping[str, NDArray[np.void]],
    declared: Mapping[str, MetricSet],
    quality: NDArray[np.void],
    started_ns: int,
) -> SessionMetrics:
    """The metrics of a session. rows, declared: of the stages, as a `status.Table` has them.
    quality: dtype SESSION.
    """
    stages = {
        name: StageMetrics.of(row, declared[name])
        for name, row in rows.items()
        if name in CORE or row["state"] != State.NONE
    }
    display: dict[str, Any] = stages[SHOWN_BY].metrics
    # without pictures, no stage follows the viewer
    follows = stages[SHOWN_BY].state != State.NONE.name or not stages[TRACKED_BY].face
    level = int(quality["level"])
    description = quality["words"].item().decode(errors="replace")
    planned, juddered = display["planned"], display["juddered"]
    t_face_ns, source = display["t_face_ns"], stages[SOURCE].metrics
    now = [notice.text for notice in notices(rows, SOURCE, SHOWN_BY, t_face_ns, source)]
    return SessionMetrics(
        session=session,
        uptime_s=round((now_ns() - started_ns) / 1e9, 2),
        camera_fps=stages[SOURCE].fps,
        level=level,
        lowest_level=int(quality["lowest"]),
        level_words=description,
        viewer=display["viewer"] if follows else SEATED,
        notices=[*now, f"quality lowered: {description}"] if level else now,
        stages=stages,
        end_to_end=summary_ms(rows[SHOWN_BY]["age"]),
        judder=Judder(
            planned=planned,
            juddered=juddered,
            percent=round(100 * juddered / planned, 3) if planned else None,
        ),
        prediction=display["prediction"],
        motion_to_photon=MotionToPhoton(
            onset_ms=display["onset_ms"], steady_ms=display["steady_ms"]
        ),
    )
