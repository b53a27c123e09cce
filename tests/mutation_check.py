"""Faults, each one line in a copy of the package: the short form of `lfpipe bench viewer --check`
notices it, or a file of the default suite.

`pytest -m live tests/mutation_check.py` tries all of them; who noticed is in
profiling/results/tests.md (`python -m tests.mutation_check` prints its table).
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
COPIED = ("lfpipe", "tests", "profiling", "tools", "pyproject.toml", "config.toml")
PYTEST = (sys.executable, "-m", "pytest", "-q", "-x", "-n", "0", "-p", "no:cacheprovider")
PROFILE = "--hypothesis-profile=unshrunk"


class Fault(NamedTuple):
    """old becomes new in a file of lfpipe; these tests notice it."""

    name: str
    file: str
    old: str
    new: str
    tests: str = "bench/test_viewer.py"

    def text(self) -> str:
        """The file as it is. Raises AssertionError unless old stands in it once."""
        text = (ROOT / "lfpipe" / self.file).read_text()
        assert text.count(self.old) == 1, f"{self.file}: {self.old!r} stands there not once"
        return text


FAULTS = (
    # of measures taken on 23 November 2026: ten of these passed every subject of `lfpipe bench`
    Fault(
        "the filter's gain to speed is doubled",
        "track/filters/models.py",
        "velocity_gain = b / spread",
        "velocity_gain = 2 * b / spread",
    ),
    Fault(
        "the reported velocity is doubled",
        "track/filters/imm.py",
        "u, v = self._growth.limit(velocity, innovation, since_s)",
        "u, v = (2 * one for one in self._growth.limit(velocity, innovation, since_s))",
    ),
    Fault(
        "ViewSolver exchanges the eyes",
        "render/synthesis/viewpoint.py",
        "if self._render.swap_eyes",
        "if not self._render.swap_eyes",
    ),
    Fault(
        "the mixer exchanges red and blue",
        "render/synthesis/anaglyph.py",
        "cv2.merge(channels[::-1], out[rows])",
        "cv2.merge(channels, out[rows])",
    ),
    Fault(
        "pictures are due one vblank late",
        "render/display/refresh.py",
        "return self.clock.nearest(self._due_ns)",
        "return self.clock.nearest(self._due_ns + self.clock.period_ns)",
    ),
    Fault(
        "a distance that is NaN stays",
        "render/viewer/viewer.py",
        "if not MIN_EYE_DISTANCE_PX <= eye_distance_px <= MAX_EYE_PX:",
        "if eye_distance_px < MIN_EYE_DISTANCE_PX:",
        "render/test_viewer.py",
    ),
    Fault(
        "the gate for glitches is open",
        "track/filters/measurement.py",
        "rejected = deviation_px > limit",
        "rejected = deviation_px > 1e9 * limit",
    ),
    Fault(
        "a filter is not reset after a gap",
        "track/filters/base.py",
        "abs(step_ns) >= MAX_STEP_NS",
        "abs(step_ns) >= 1000 * MAX_STEP_NS",
        "track/test_filters.py",
    ),
    Fault(
        "a warp reads the neighbour's picture",
        "render/synthesis/engine.py",
        "planes = [source(frame, view.row, view.col) for source in sources]\n"
        "            if steps ==",
        "planes = [source(frame, view.row, max(view.col - 1, 0)) for source in sources]\n"
        "            if steps ==",
    ),
    Fault(
        "a warp goes the wrong way",
        "render/synthesis/warper.py",
        "np.array((right * self._unit_px,",
        "np.array((-right * self._unit_px,",
    ),
    Fault(
        "the picture exchanges the views of the eyes",
        "render/synthesis/compositor.py",
        "frame, left, right = key",
        "frame, right, left = key",
    ),
    Fault(
        "a picture is one refresh late",
        "render/choice.py",
        "seen_ns=target_ns + device_latency_ns + refresh_ns // 2,",
        "seen_ns=target_ns + device_latency_ns - refresh_ns // 2,",
    ),
    Fault(
        "the row of the eyes is ignored",
        "render/synthesis/viewpoint.py",
        "r0 + self._steps(middle_v - cy)",
        "r0",
    ),
    Fault(
        "alpha is doubled",
        "render/viewer/viewer.py",
        "solver.alpha_px = self._eye_distance_px / self.parallax",
        "solver.alpha_px = 2 * self._eye_distance_px / self.parallax",
    ),
    Fault(
        "the view jumps to its middle when a face is lost",
        "render/viewer/presence.py",
        "s = max((t_ns - self._lost_ns) / SECOND_NS - HOLD_S, 0.0) / AWAY_S",
        "s = 1e6",
    ),
    Fault(
        "steps of the picture are not eased",
        "render/viewer/presence.py",
        "step = EASED_VIEWS * min(dt_s * EASED_HZ, 1.0)",
        "step = 10 * EASED_VIEWS",
    ),
    Fault(
        "impossible eyes are not refused",
        "render/viewer/viewer.py",
        "return (lx, ly, rx, ry) if is_plausible_px(lx, ly, rx, ry) else None",
        "return lx, ly, rx, ry",
        "render/test_compositor.py::test_viewer_takes_whatever_a_tracker_says",
    ),
    Fault(
        "a warp uses the neighbour's disparity",
        "render/synthesis/warper.py",
        "stored = self._map(frame, view.row, view.col)",
        "stored = self._map(frame, view.row, max(view.col - 1, 0))",
    ),
    # twelve more
    Fault(
        "the loop's delay is left out",
        "render/choice.py",
        "seen_ns=target_ns + device_latency_ns + refresh_ns // 2,",
        "seen_ns=target_ns + refresh_ns // 2,",
    ),
    Fault(
        "a dead tracker's eyes stay",
        "render/choice.py",
        "t_ns - newest.t_ns <= self._stale_ns",
        "t_ns - newest.t_ns <= 1000 * self._stale_ns",
        "render/test_choice.py",
    ),
    Fault(
        "viewpoints are rounded to half a view",
        "render/synthesis/compositor.py",
        "return max(1 / 1024, 2.0 ** math.floor(math.log2(step)))",
        "return 0.5",
    ),
    Fault(
        "the plane of the screen moves the wrong way",
        "render/synthesis/cameras.py",
        "zero_px * (self.centre[1] - at[1])",
        "zero_px * (at[1] - self.centre[1])",
    ),
    Fault(
        "warp2 fades from one view to the other the wrong way round",
        "render/synthesis/viewpoint.py",
        "up, right = _faded(up, ROW_FADE), _faded(right, COL_FADE)",
        "up, right = 1 - _faded(up, ROW_FADE), 1 - _faded(right, COL_FADE)",
    ),
    Fault(
        "no rest is ever measured",
        "render/viewer/presence.py",
        "if rest_ns < REST_S * SECOND_NS",
        "if rest_ns < 1000 * REST_S * SECOND_NS",
    ),
    Fault(
        "depth ends at the edge of the zone",
        "render/synthesis/viewpoint.py",
        "if self._render.keep_depth:",
        "if not self._render.keep_depth:",
    ),
    Fault(
        "a new seat is not taken",
        "render/viewer/viewer.py",
        "self._centre_px = solver.centre_px = rest.x_px, rest.y_px",
        "pass",
    ),
    Fault(
        "stamps of another clock are used",
        "capture/camera.py",
        "MAX_AGE_NS = STALE_NS * 3 // 5",
        "MAX_AGE_NS = STALE_NS * 4",
    ),
    Fault(
        "a hand is any motion of one eye",
        "track/eye_tracker.py",
        "off_px = min(",
        "off_px = max(",
        "track/test_eye_tracker.py",
    ),
    Fault(
        "a hidden eye is held at its raw place",
        "track/eye_tracker.py",
        "self._position_px = self._trusted_position_px",
        "self._position_px = self._raw_px",
        "track/test_eye_tracker.py",
    ),
    Fault(
        "the gate looks at the left eye only",
        "track/filters/imm.py",
        "math.hypot(rx - last_rx - moved_x, ry - last_ry - moved_y)",
        "math.hypot(lx - last_lx - moved_x, ly - last_ly - moved_y)",
        "track/test_filters.py",
    ),
    Fault(
        "a nearer face wins at its first scan",
        "track/detector.py",
        "NEARER_SCANS = 4",
        "NEARER_SCANS = 1",
        "track/test_engines.py",
    ),
    Fault(
        "the gate refuses a head that shakes fast",
        "track/filters/measurement.py",
        "limit += USUAL_WEIGHT * self._usual_px",
        "limit += 0.0",
    ),
    Fault(
        "rotation goes the other way",
        "track/filters/measurement.py",
        "return -self._rate * y, self._rate * x",
        "return self._rate * y, -self._rate * x",
    ),
    Fault(
        "the last steps are not fitted",
        "track/filters/velocity.py",
        "self._weights = [a + gain * missed",
        "self._weights = [a + 0 * gain * missed",
    ),
    Fault(
        "the former seat is forgotten",
        "render/viewer/presence.py",
        "self._left = Seat(self._last, self._measured, t_ns)",
        "self._left = None",
    ),
    Fault(
        "a neighbour takes over who is no nearer",
        "track/detector.py",
        "MIN_NEARER_RATIO = 1.6",
        "MIN_NEARER_RATIO = 0.5",
    ),
    Fault(
        "pictures begin without a lead",
        "render/display/refresh.py",
        "return int(self._cost_ns + self._margin_ns)",
        "return 0",
    ),
    Fault(
        "depth of hidden parts is inverted",
        "render/synthesis/warper.py",
        "cv2.max(first, disparity, disparity)",
        "cv2.min(first, disparity, disparity)",
    ),
    Fault(
        "acceleration is used against the motion",
        "track/filters/velocity.py",
        "speed_gain * velocity[0] + ahead_s * ax",
        "speed_gain * velocity[0] - ahead_s * ax",
    ),
    # nobody noticed these before
    Fault(
        "a video stays at its first frame",
        "render/synthesis/scene_views.py",
        "self._views[frame, row, col, channel]",
        "self._views[0, row, col, channel]",
        "render/test_compositor.py",
    ),
    Fault(
        "rows below a bar go to the other eye",
        "render/synthesis/pair_layout.py",
        "row = (eye - first_row - y) % 2",
        "row = (eye - first_row) % 2",
        "render/test_compositor.py",
    ),
    Fault(
        "the digest of a picture is that of one colour",
        "render/listeners/replay_writer.py",
        "zlib.crc32(picture.data)",
        "zlib.crc32(picture[..., 0].tobytes())",
        "replay/test_compare.py",
    ),
    Fault(
        "the monitor exchanges p95 and p99",
        "monitor/monitor.py",
        '("p50_ms", "p95_ms", "p99_ms")',
        '("p50_ms", "p99_ms", "p95_ms")',
        "monitor/test_monitor.py",
    ),
    Fault(
        "the prediction is measured in ms",
        "render/listeners/status_row.py",
        "int(MAX_PREDICTION_S * 1e9)",
        "int(MAX_PREDICTION_S * 1e3)",
        "render/test_listeners.py",
    ),
    Fault(
        "LSL pictures have the time of sending",
        "extras/share/output.py",
        'self._lsl_s(int(record["t_presented_ns"]))',
        "self._lsl_s(now_ns())",
        "extras/share/test_outputs.py",
    ),
    # and of what came after
    Fault(
        "costs above a period are not learned",
        "render/display/refresh.py",
        "counted_ns = min(counted_ns, self._last_cost_ns)",
        "return",
        "render/test_refresh.py",
    ),
    Fault(
        "an edge along the baseline decides disparity",
        "scene/disparity.py",
        "np.maximum(energy, 0) + np.float32(ENERGY_FLOOR)",
        "np.ones_like(energy)",
        "scene/test_disparity.py",
    ),
    Fault(
        "the governor forgets a loss",
        "supervisor/governor.py",
        "self._required_s = min(2 * self._required_s, MAX_HEADROOM_S)",
        "self._required_s = HEADROOM_S",
        "supervisor/test_governor.py",
    ),
)


def noticed_by(fault: Fault, folder: Path) -> str:
    """Which figure or test notices a fault in a copy of the package; "" if none does."""
    for name in COPIED:
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, folder / name)
    text = fault.text().replace(fault.old, fault.new)
    (folder / "lfpipe" / fault.file).write_text(text)
    run = subprocess.run(
        [*PYTEST, PROFILE, f"tests/{fault.tests}"],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder)},  # before the package that is installed
        capture_output=True,
        text=True,
        check=False,
    )
    lines = run.stdout.splitlines()
    metrics = [line.rpartition("Error: ")[2] for line in lines if " is right" in line]
    failed = [line for line in lines if line.startswith("FAILED ")]
    if failed and metrics:
        return f"`bench viewer`: {metrics[0]}"
    return failed[0].removeprefix("FAILED ").partition(" - ")[0] if failed else ""


@pytest.mark.live
@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_fault_is_noticed(fault: Fault, tmp_path: Path) -> None:
    assert noticed_by(fault, tmp_path), f"{fault.file}: {fault.new}"


if __name__ == "__main__":
    print("| fault | file | noticed by |\n|---|---|---|")
    for one in FAULTS:
        with tempfile.TemporaryDirectory() as name:
            who = noticed_by(one, Path(name)) or "**nobody**"
        print(f"| {one.name} | {one.file} | {who} |", flush=True)
