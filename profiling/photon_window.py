"""`lfpipe calibrate --latency` as a whole: the real window on Xvfb or sway, and a camera that looks at that screen.

`python -m profiling.photon_window [--runs N] [--seed N] [--screen xvfb|RATE]`; a rate in Hz takes sway. Each run draws delays,
camera and exposure anew. `--report FILE...` makes the table of what earlier runs printed.
"""

import contextlib
import json
import re
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import attrs
import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1]))

from arguments import existing, parser_of, start

from tests.display.screen_camera import Optics, stamp_offset_ms
from tests.sway_screen import sway
from tests.world import World, private_world
from tests.xvfb_screen import x_server

SIZE_PX = 640, 400
LINE = re.compile(r"(\S+): ([\d.]+) Hz, .*? ([\d.]+) ms: (?:([+-][\d.]+) ms, (-?[\d.]+) to ([\d.]+)|(.*))")


@contextlib.contextmanager
def shown(name: str) -> Iterator[tuple[Path, dict[str, str]]]:
    """A screen: what shows it to the camera, and the environment of its window."""
    width, height = SIZE_PX
    if name == "xvfb":
        with tempfile.TemporaryDirectory() as folder:
            command = ["Xvfb", "-screen", "0", f"{width}x{height}x24", "-nocursor", "-fbdir", folder]
            with x_server(command, Path(folder)) as display:
                yield Path(folder) / "Xvfb_screen0", {"DISPLAY": display}
    else:
        with sway(width, height, float(name)) as socket:
            yield Path(socket), {"WAYLAND_DISPLAY": socket, "SDL_VIDEODRIVER": "wayland"}


def drawn(rng: np.random.Generator, buffer: Path) -> Optics:
    """Optics of one run."""
    rate_hz = float(rng.choice([15.0, 30.0, 60.0])) * (1 + rng.uniform(-0.02, 0.02))
    total_ms, share = rng.uniform(15, 150), rng.uniform(0.2, 0.8)
    return Optics(
        str(buffer),
        quick=False,
        screen_ms=total_ms * share,
        camera_ms=total_ms * (1 - share),
        rate_hz=rate_hz,
        exposure_ms=min(rng.uniform(2, 30), 900 / rate_hz),
        readout_ms=rng.uniform(0, 0.9) * min(1e3 / rate_hz, 30),
        gamma=rng.uniform(1.8, 2.4),
        noise=rng.uniform(1, 6),
    )


def calibrated(world: World, optics: Optics, number: int) -> str:
    """What the command printed."""
    node = world.root / f"video{number}"
    node.write_text(json.dumps(attrs.asdict(optics)))
    world.module = "tests.display.screen_camera"
    size = ("--set", "camera.width_px=160", "--set", "camera.height_px=120", "--set", f"camera.rate_hz={optics.rate_hz:g}")
    out, err = world.start("calibrate", "--latency", "--camera", f"camera:{node}", *size).communicate(timeout=200)
    return out or err


def report(lines: list[str]) -> None:
    """Prints a table by screen and one by camera."""
    rows = [found.groups() for line in lines if (found := LINE.match(line))]
    print("| | runs | refused | within 1 ms | error, median | 95 % | largest | mean with its sign | 90 % interval holds |")
    print("|---|---|---|---|---|---|---|---|---|")
    cameras = [(f"camera {hz} Hz", [row for row in rows if abs(float(row[1]) / hz - 1) < 0.1]) for hz in (15, 30, 60)]
    screens = [(name, [row for row in rows if row[0] == name]) for name in dict.fromkeys(row[0] for row in rows)]
    for name, part in (*screens, *cameras, ("all", rows)):
        if not any(row[3] for row in part):
            continue
        good = np.array([[float(value) for value in row[2:6]] for row in part if row[3]]).reshape(-1, 4)
        truth, errors, low, high = good.T
        sizes = np.abs(errors)
        held = np.mean((low <= truth) & (truth <= high))
        print(
            f"| {name} | {len(part)} | {len(part) - len(good)} | {np.mean(sizes <= 1):.1%} | {np.median(sizes):.2f} ms"
            f" | {np.quantile(sizes, 0.95):.2f} ms | {sizes.max():.2f} ms | {errors.mean():+.2f} ms | {held:.1%} |"
        )


def main() -> int:
    parser = parser_of(__doc__, runs=24, seed=5, screen="xvfb")
    parser.add_argument("--report", type=existing, nargs="+")
    args = parser.parse_args()
    if args.report:
        report([line for path in args.report for line in path.read_text().splitlines()])
        return 0
    rng, lines = np.random.default_rng(int(args.seed)), []
    with shown(args.screen) as (buffer, env), private_world() as world:
        world.env |= env
        for number in range(int(args.runs)):
            optics = drawn(rng, buffer)
            truth_ms = optics.screen_ms + stamp_offset_ms(optics)
            said = calibrated(world, optics, number)
            about = f"{optics.rate_hz:.1f} Hz, exposure {optics.exposure_ms:.0f} ms, readout {optics.readout_ms:.0f} ms"
            if found := re.search(r": ([\d.]+) ms \(90 %: (-?[\d.]+) to ([\d.]+)", said):
                ms, low, high = map(float, found.groups())
                result = f"{ms - truth_ms:+.2f} ms, {low:.1f} to {high:.1f}"
            else:
                result = said.splitlines()[0]
            lines.append(f"{args.screen}: {about}, {truth_ms:.1f} ms: {result}")
            print(lines[-1], flush=True)
    report(lines)
    return 0


if __name__ == "__main__":
    start(main)
