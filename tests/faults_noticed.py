"""Faults, each one line in a copy of the package: the short form of `lfpipe bench viewer --check`
notices it, or the tests of a room.

`pytest -m live tests/faults_noticed.py` tries all of them; who noticed is in
profiling/results/tests.md (`python -m tests.faults_noticed` prints its table).
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


class Fault(NamedTuple):
    """old becomes new in a file of lfpipe. room: whose tests are tried next."""

    name: str
    file: str
    old: str
    new: str
    room: str


FAULTS = (
    # of measures taken on 23 November 2026: ten of these passed every subject of `lfpipe bench`
    Fault(
        "the filter's gain to speed is doubled",
        "track/filters.py",
        "to_speed, kept = b / spread,",
        "to_speed, kept = 2 * b / spread,",
        "track",
    ),
    Fault(
        "the reported velocity is doubled",
        "track/filters.py",
        "np.array(((u, v), (u, v)))",
        "np.array(((2 * u, 2 * v), (2 * u, 2 * v)))",
        "track",
    ),
    Fault(
        "ViewSolver exchanges the eyes",
        "render/viewpoint.py",
        "if self._render.swap_eyes",
        "if not self._render.swap_eyes",
        "render",
    ),
    Fault(
        "the mixer exchanges red and blue",
        "render/anaglyph.py",
        "cv2.merge(channels[::-1], out[rows])",
        "cv2.merge(channels, out[rows])",
        "render",
    ),
    Fault(
        "pictures are due one blank late",
        "render/refresh.py",
        "return self.clock.nearest(self._due_ns)",
        "return self.clock.nearest(self._due_ns + self.clock.period_ns)",
        "render",
    ),
    Fault(
        "a distance that is NaN stays",
        "render/viewer.py",
        "if not LEAST_EYES_PX <= apart_px <= FAR_PX:",
        "if apart_px < LEAST_EYES_PX:",
        "render",
    ),
    Fault(
        "the gate for glitches is open",
        "track/filters.py",
        "if off > (STEP",
        "if off > 1e9 * (STEP",
        "track",
    ),
    Fault(
        "a filter is not reset after a gap",
        "track/smoothing.py",
        "abs(step_ns) >= MAX_STEP_NS",
        "abs(step_ns) >= 1000 * MAX_STEP_NS",
        "track",
    ),
    Fault(
        "a warp reads the neighbour's picture",
        "render/synthesis.py",
        "planes = [source(frame, view.row, view.col) for source in sources]\n"
        "            if steps ==",
        "planes = [source(frame, view.row, max(view.col - 1, 0)) for source in sources]\n"
        "            if steps ==",
        "render",
    ),
    Fault(
        "a warp goes the wrong way",
        "render/warper.py",
        "np.array((right * self._unit_px,",
        "np.array((-right * self._unit_px,",
        "render",
    ),
    Fault(
        "the picture exchanges the views of the eyes",
        "render/compositor.py",
        "frame, left, right = key",
        "frame, right, left = key",
        "render",
    ),
    Fault(
        "a picture is one refresh late",
        "render/choice.py",
        "seen_ns=target_ns + loop_ns + refresh_ns // 2,",
        "seen_ns=target_ns + loop_ns - refresh_ns // 2,",
        "render",
    ),
    Fault(
        "the row of the eyes is ignored",
        "render/viewpoint.py",
        "r0 + self._steps(middle_v - cy)",
        "r0",
        "render",
    ),
    Fault(
        "alpha is doubled",
        "render/viewer.py",
        "solver.alpha_px = self._apart_px / self.parallax",
        "solver.alpha_px = 2 * self._apart_px / self.parallax",
        "render",
    ),
    Fault(
        "the view jumps to its middle when a face is lost",
        "render/presence.py",
        "s = max((t_ns - self._lost_ns) / SECOND_NS - HOLD_S, 0.0) / AWAY_S",
        "s = 1e6",
        "render",
    ),
    Fault(
        "steps of the picture are not eased",
        "render/presence.py",
        "step = EASED_VIEWS * min(dt_s * EASED_HZ, 1.0)",
        "step = 10 * EASED_VIEWS",
        "render",
    ),
    Fault(
        "impossible eyes are not refused",
        "render/viewer.py",
        "return (lx, ly, rx, ry) if near else None",
        "return lx, ly, rx, ry",
        "render",
    ),
    Fault(
        "a warp uses the neighbour's disparity",
        "render/warper.py",
        "stored = self._map(frame, view.row, view.col)",
        "stored = self._map(frame, view.row, max(view.col - 1, 0))",
        "render",
    ),
    # twelve more
    Fault(
        "the loop's delay is left out",
        "render/choice.py",
        "seen_ns=target_ns + loop_ns + refresh_ns // 2,",
        "seen_ns=target_ns + refresh_ns // 2,",
        "render",
    ),
    Fault(
        "a dead tracker's eyes stay",
        "render/choice.py",
        "t_ns - newest.t_ns <= self._stale_ns",
        "t_ns - newest.t_ns <= 1000 * self._stale_ns",
        "render",
    ),
    Fault(
        "viewpoints are rounded to half a view",
        "render/compositor.py",
        "return max(1 / 1024, 2.0 ** math.floor(math.log2(step)))",
        "return 0.5",
        "render",
    ),
    Fault(
        "the plane of the screen moves the wrong way",
        "render/synthesis.py",
        "zero_plane_px * (self._centre[1] - position[1])",
        "zero_plane_px * (position[1] - self._centre[1])",
        "render",
    ),
    Fault(
        "warp2 fades from one view to the other the wrong way round",
        "render/viewpoint.py",
        "up, right = _faded(up, ROW_FADE), _faded(right, COL_FADE)",
        "up, right = 1 - _faded(up, ROW_FADE), 1 - _faded(right, COL_FADE)",
        "render",
    ),
    Fault(
        "no rest is ever measured",
        "render/presence.py",
        "if rest_ns < REST_S * SECOND_NS",
        "if rest_ns < 1000 * REST_S * SECOND_NS",
        "render",
    ),
    Fault(
        "depth ends at the edge of the zone",
        "render/viewpoint.py",
        "if self._render.keep_depth:",
        "if not self._render.keep_depth:",
        "render",
    ),
    Fault(
        "the neutral position follows slowly",
        "render/viewer.py",
        "NEUTRAL_S = 0.5",
        "NEUTRAL_S = 5.0",
        "render",
    ),
    Fault(
        "a neighbour takes over who is no nearer",
        "track/detector.py",
        "NEARER = 1.6",
        "NEARER = 0.5",
        "track",
    ),
    Fault(
        "pictures begin without a lead",
        "render/refresh.py",
        "return int(self._high_cost_ns + self._margin_ns)",
        "return 0",
        "render",
    ),
    Fault(
        "near and far of hidden parts are exchanged",
        "render/warper.py",
        "cv2.max(first, disparity, disparity)",
        "cv2.min(first, disparity, disparity)",
        "render",
    ),
    Fault(
        "acceleration is used against the motion",
        "track/filters.py",
        "speed * velocity[0] + ahead_s * ax",
        "speed * velocity[0] - ahead_s * ax",
        "track",
    ),
)


def noticed_by(fault: Fault, folder: Path) -> str:
    """Which figure or test notices a fault in a copy of the package; "" if none does."""
    for name in COPIED:
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, folder / name)
    path = folder / "lfpipe" / fault.file
    text = path.read_text()
    assert text.count(fault.old) == 1, f"{fault.file}: {fault.old!r} stands there not once"
    path.write_text(text.replace(fault.old, fault.new))
    suite = ("-m", "pytest", "-q", "-x", "-n", "0", "-p", "no:cacheprovider")
    for tests in ("bench/test_viewer.py", fault.room):
        run = _run(folder, *suite, f"tests/{tests}")
        lines = run.stdout.splitlines()
        failed = [line for line in lines if line.startswith("FAILED ")]
        if failed and tests != fault.room:
            figures = [line for line in lines if " is right" in line]
            return (
                f"`bench viewer`: {figures[0].rpartition('Error: ')[2]}" if figures else failed[0]
            )
        if failed:
            return failed[0].removeprefix("FAILED ").partition(" - ")[0]
    return ""


def _run(folder: Path, *words: str) -> "subprocess.CompletedProcess[str]":
    """Python in the folder, whose package comes before the one that is installed."""
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    return subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


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
