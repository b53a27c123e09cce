"""What LFPIPE_HOST=portable costs beside Linux's own host: wake-ups, frame rate, CPU. Side by side, medians of the rounds.

    uv run python profiling/host_cost.py [--rounds 3] [--seconds 6] [--write 1]

wake: from `notify` to the return of another process's poller, 2000 wakes 2 ms apart. pictures/s: with pace=max, composed. CPU: of
the whole tree at 30 Hz, in percent of a core. start: from the command to the first picture.
--write 1 replaces the last section of profiling/results/hosts.md.
"""

import os
import platform
import signal
import statistics
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
from arguments import parser_of, start

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.faults.session import PLAIN
from tests.faults.watcher import write_checked_frames
from tests.world import World, private_world, write_scene

RESULTS = Path(__file__).parent / "results" / "hosts.md"
HEAD = "\n## Linux's own host and the portable one\n"
HOSTS = ("native", "portable")
FIGURES = (
    "wake p50 us",
    "wake p99 us",
    "pictures/s, pace=max",
    "drops, pace=max",
    "CPU % at 30 Hz",
    "age p50 ms at 30 Hz",
    "start s",
)
WAKES = 2000
READ = """
import sys, time, pathlib, zmq
from lfpipe.host import wake
path = pathlib.Path(sys.argv[1])
reader = wake.Wake(path, reads=True)
reader.drain()
poller = zmq.Poller()
poller.register(reader.fd, zmq.POLLIN)
print("ready", flush=True)
found, sent_ns = [], 0
while sent_ns != 1:
    poller.poll(1000)
    t_ns = time.monotonic_ns()
    if (sent_ns := reader.drain()) > 1:
        found.append(t_ns - sent_ns)
print(*found)
"""
MAKE = "import pathlib, sys; from lfpipe.host import wake; wake.make(pathlib.Path(sys.argv[1]))"
WRITE = """
import sys, time, pathlib
from lfpipe.host import wake
writer = wake.Wake(pathlib.Path(sys.argv[1]))
for _ in range(int(sys.argv[2])):
    writer.notify(time.monotonic_ns())
    time.sleep(0.002)
writer.notify(1)
"""


def wakes_us(world: World) -> tuple[float, float]:
    """p50 and p99."""
    path = world.root / f"wake{time.monotonic_ns()}"
    subprocess.run([sys.executable, "-c", MAKE, str(path)], env=world.env, check=True)
    words = [str(path), str(WAKES)]
    reader = subprocess.Popen([sys.executable, "-c", READ, *words], stdout=subprocess.PIPE, text=True, env=world.env)
    assert reader.stdout is not None and reader.stdout.readline()
    subprocess.run([sys.executable, "-c", WRITE, *words], env=world.env, check=True)
    found = np.array(reader.communicate(timeout=30)[0].split(), dtype=float) / 1e3
    return float(np.median(found)), float(np.percentile(found, 99))


def tree_cpu_s(pid: int) -> float:
    """CPU seconds of a process and its living descendants."""
    times = [each.cpu_times() for each in (psutil.Process(pid), *psutil.Process(pid).children(recursive=True))]
    return sum(each.user + each.system for each in times)


def session(world: World, scene: Path, camera: str, seconds: float) -> tuple[float, float, int, float, float]:
    """Pictures per second, CPU in percent of a core, drops, age p50 in ms, seconds to the first picture."""
    world.trace.unlink(missing_ok=True)
    options = [f"--set={text}" for text in ("render.clock=camera", "governor.quality=fixed", *PLAIN)]
    began = time.monotonic()
    process = world.up(scene, *options, camera=camera)
    world.pictures()
    start_s = time.monotonic() - began
    time.sleep(1.0)
    before, cpu_s, t = len(world.lines()), tree_cpu_s(process.pid), time.monotonic()
    time.sleep(seconds)
    pictures, cpu_s, dt = len(world.lines()) - before, tree_cpu_s(process.pid) - cpu_s, time.monotonic() - t
    rows = world.lines()[before:]
    drops = sum(stage.get("drops", 0) for stage in world.monitor()["stages"].values())
    age_ms = statistics.median((row["t_presented_ns"] - row["t_sensor_ns"]) / 1e6 for row in rows)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=30)
    return pictures / dt, 100 * cpu_s / dt, drops, age_ms, start_s


def one(host: str, world: World, scene: Path, frames: Path, seconds: float) -> dict[str, float]:
    """All figures once."""
    world.env["LFPIPE_HOST"] = "" if host == "native" else host
    p50, p99 = wakes_us(world)
    fast = session(world, scene, f"file:{frames}?loop=1&pace=max", seconds)
    calm = session(world, scene, f"file:{frames}?loop=1&pace=30", seconds)
    return dict(zip(FIGURES, (p50, p99, fast[0], fast[2], calm[1], calm[3], calm[4]), strict=True))


def main() -> int:
    args = parser_of(__doc__, rounds=3, seconds=6.0, write=0).parse_args()
    found: dict[str, list[dict[str, float]]] = {host: [] for host in HOSTS}
    with private_world() as world:
        world.env["TMPDIR"] = str(world.root)  # a registry of its own
        scene, frames = (
            write_scene(world.root / "scene"),
            write_checked_frames(world.root / "frames", 640, 480, 40),
        )
        for _ in range(args.rounds):
            for host in HOSTS:
                found[host].append(one(host, world, scene, frames, args.seconds))
                print(host, found[host][-1], file=sys.stderr)
    lines = [f"| | {' | '.join(HOSTS)} |", "|---" * 3 + "|"]
    for figure in FIGURES:
        values = [statistics.median(each[figure] for each in found[host]) for host in HOSTS]
        lines.append(f"| {figure} | {' | '.join(f'{value:.4g}' for value in values)} |")
    where = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, load average {psutil.getloadavg()[1]:.1f}"
    about = f"`python profiling/host_cost.py` on {where}; medians of {args.rounds} rounds of {args.seconds:g} s, in turns."
    text = f"{about}\n\n" + "\n".join(lines) + "\n"
    print(text)
    if args.write:
        RESULTS.write_text(f"{RESULTS.read_text().partition(HEAD)[0].rstrip()}\n{HEAD}\n{text}")
    return 0


if __name__ == "__main__":
    start(main)
