"""`lfpipe calibrate --latency` as a whole: the real window on Xvfb, and a camera that looks at that screen.

`python -m profiling.photon_window [--runs N]`, with Xvfb installed. Each run draws delays, camera and exposure anew.
"""

from __future__ import annotations

import json
import re
import sys
import tempfile
from pathlib import Path

import attrs
import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1]))

from arguments import parser_of, start

from tests.display.screen_camera import Optics, stamp_offset_ms
from tests.world import World, private_world
from tests.xvfb_screen import x_server

SCREEN = "1280x800x24"


def drawn(rng: np.random.Generator, buffer: Path) -> Optics:
    """Optics of one run."""
    rate_hz = float(rng.choice([15.0, 30.0, 60.0])) * (1 + rng.uniform(-0.02, 0.02))
    total_ms, share = rng.uniform(15, 150), rng.uniform(0.2, 0.8)
    return Optics(
        str(buffer),
        screen_ms=total_ms * share,
        camera_ms=total_ms * (1 - share),
        rate_hz=rate_hz,
        exposure_ms=min(rng.uniform(2, 30), 900 / rate_hz),
        readout_ms=rng.uniform(0, 0.9) * min(1e3 / rate_hz, 30),
        gamma=rng.uniform(1.8, 2.4),
        noise=rng.uniform(1, 6),
    )


def calibrated(world: World, display: str, optics: Optics, number: int) -> tuple[float, str]:
    """The truth, and what the command printed."""
    node = world.root / f"video{number}"
    node.write_text(json.dumps(attrs.asdict(optics)))
    world.module, world.env["DISPLAY"] = "tests.display.screen_camera", display
    size = ("--set", "camera.width_px=160", "--set", "camera.height_px=120", "--set", f"camera.rate_hz={optics.rate_hz:g}")
    out, err = world.start("calibrate", "--latency", "--camera", f"camera:{node}", *size).communicate(timeout=200)
    truth = Path(f"{node}.truth")
    xvfb_ms = json.loads(truth.read_text()) if truth.exists() else float("nan")
    return optics.screen_ms + stamp_offset_ms(optics) + xvfb_ms, out or err


def main() -> int:
    args = parser_of(__doc__, runs=24, seed=5).parse_args()
    runs, errors, held, refused = int(args.runs), [], 0, 0
    rng = np.random.default_rng(int(args.seed))
    command = ["Xvfb", "-screen", "0", SCREEN, "-nocursor", "-fbdir"]
    with (
        tempfile.TemporaryDirectory() as folder,
        private_world() as world,
        x_server([*command, folder], Path(folder)) as display,
    ):
        for number in range(runs):
            optics = drawn(rng, Path(folder) / "Xvfb_screen0")
            truth_ms, said = calibrated(world, display, optics, number)
            found = re.search(r": ([\d.]+) ms \(90 %: (-?[\d.]+) to ([\d.]+)", said)
            about = f"{optics.rate_hz:.1f} Hz, exposure {optics.exposure_ms:.0f} ms, readout {optics.readout_ms:.0f} ms"
            if found is None:
                refused += 1
                print(f"{about}, {truth_ms:.1f} ms: {said.splitlines()[0]}", flush=True)
                continue
            ms, low, high = map(float, found.groups())
            errors.append(abs(ms - truth_ms))
            held += low <= truth_ms <= high
            print(f"{about}, {truth_ms:.1f} ms: {ms - truth_ms:+.2f} ms, {low:.1f} to {high:.1f}", flush=True)
    within = sum(error <= 1 for error in errors)
    print(f"{runs} runs, {refused} refused, {within} within 1 ms, median {np.median(errors):.2f} ms, interval held {held}")
    return 0


if __name__ == "__main__":
    start(main)
