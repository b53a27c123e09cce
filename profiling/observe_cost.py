"""What watching costs: CPU of the terminal monitor and of the page with a viewer, drops with and without, and what stays behind.

    uv run python profiling/observe_cost.py [--seconds 60] [--cycles 20]

Runs a session of the demo (display none, fixed quality), nothing, `lfpipe monitor` in a pseudo-terminal of 80x24, and
`lfpipe monitor --web` with a viewer that looks as the page does (figures and both pictures four times a second), in turns of
so many seconds; then attaches and detaches so many times, every other one by SIGKILL. Prints Markdown. Bounds: 2 % and 3 % of
a core.
"""

import contextlib
import fcntl
import http.client
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import tempfile
import termios
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from arguments import parser_of, start

from lfpipe.errors import UserError
from lfpipe.observe.session_reader import Watch
from lfpipe.supervisor.rundir import find
from lfpipe.transport import segment

NAME = "observe_cost"
PERIOD_S = 0.25
COMMAND = [sys.executable, "-m", "lfpipe"]
Counts = tuple[dict[str, int], int]  # drops of each stage, and pictures


def cpu_ns(pid: int) -> int:
    """CPU time of another process, by its own clock."""
    return time.clock_gettime_ns((~pid << 3) | 2)


def counts(watch: Watch) -> Counts:
    return {name: int(row["drops"]) for name, row in watch.rows.items() if int(row["state"])}, int(watch.rows["render"]["seq"])


@contextlib.contextmanager
def terminal() -> Iterator[subprocess.Popen[bytes]]:
    """`lfpipe monitor` on a screen that somebody reads."""
    outer, inner = pty.openpty()
    fcntl.ioctl(inner, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    env = {**os.environ, "TERM": "xterm-256color"}
    process = subprocess.Popen([*COMMAND, "monitor", "--session", NAME], stdin=inner, stdout=inner, stderr=inner, env=env)
    os.close(inner)

    def read() -> None:
        with contextlib.suppress(OSError):
            while os.read(outer, 65536):
                pass

    threading.Thread(target=read, daemon=True).start()
    yield process
    os.write(outer, b"q")
    process.wait(10)
    os.close(outer)


def served() -> tuple[subprocess.Popen[str], int, dict[str, str]]:
    """`lfpipe monitor --web`, its port, and the header that carries its token."""
    process = subprocess.Popen([*COMMAND, "monitor", "--session", NAME, "--web", "--port", "0"], stdout=subprocess.PIPE,
                               stderr=subprocess.STDOUT, text=True)  # fmt: skip
    assert process.stdout is not None
    found = re.search(r":(\d+)/\?token=(\S+)", process.stdout.readline())
    assert found is not None, "the page is not served"
    return process, int(found[1]), {"Authorization": f"Bearer {found[2]}"}


@contextlib.contextmanager
def page() -> Iterator[subprocess.Popen[str]]:
    """`lfpipe monitor --web` with one viewer."""
    process, port, token = served()
    left, seen = threading.Event(), {"": 0, "camera": 0, "picture": 0}

    def look() -> None:
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
        connection.request("GET", "/events?pictures", headers=token)
        told, event = connection.getresponse(), ""
        while not left.is_set():
            line = told.readline()
            if line.startswith(b"event: "):
                event = line[7:].decode().strip()
            elif line.startswith(b"data: "):
                seen[event], event = seen[event] + 1, ""
        connection.close()

    viewer, start = threading.Thread(target=look), time.monotonic()
    viewer.start()
    yield process
    left.set()
    viewer.join()
    expected = 0.8 * (time.monotonic() - start) / PERIOD_S
    assert min(seen.values()) > expected, f"the viewer saw {seen}, {expected:.0f} of each are expected"
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=10)


def turn(watch: Watch, what: str, seconds: float, process: subprocess.Popen[bytes] | subprocess.Popen[str] | None) -> str:
    """A line of the table: what one turn cost."""
    if process is not None:
        time.sleep(4)  # its start is no part of what it costs to keep it open
    before, start_ns = counts(watch), time.monotonic_ns()
    own_ns = cpu_ns(process.pid) if process is not None else 0
    time.sleep(seconds)
    spent_ns = cpu_ns(process.pid) - own_ns if process is not None else 0
    if not watch.living():
        raise SystemExit("the session ended: the machine is too busy to measure on, see what it said above")
    share, after = 100 * spent_ns / (time.monotonic_ns() - start_ns), counts(watch)
    drops = ", ".join(f"{name} {after[0][name] - before[0][name]}" for name in after[0])
    cost = "" if process is None else f"{share:.2f} %"
    return f"| {what} | {cost} | {(after[1] - before[1]) / seconds:.1f} | {drops} |"


def belongings(watch: Watch) -> dict[str, list[str]]:
    """What the session has: names in /dev/shm, files of its run directory, descriptors and children of its processes."""
    run = watch.session.run_dir
    pids = [int(row["pid"]) for row in watch.rows.values() if int(row["pid"])]
    parents = {Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[1] for pid in pids}
    found = {
        f"descriptors of {pid}": sorted(path.name for path in Path(f"/proc/{pid}/fd").iterdir())
        for pid in (*map(str, pids), *sorted(parents))
    }
    found["segments"] = sorted(segment.owned(watch.session.segment("")))
    found["files and FIFOs"] = sorted(str(path.relative_to(run)) for path in run.rglob("*"))
    for pid in parents:
        found[f"children of {pid}"] = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return found


def cycle(number: int) -> None:
    """Attaches, sees something, and leaves: a stream, a screen or a page in turn, every other one killed."""
    how = signal.SIGKILL if number % 2 else signal.SIGINT
    if number % 3 == 2:
        process, port, token = served()
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
        for path in ("/camera.jpg", "/picture.jpg"):
            connection.request("GET", path, headers=token)
            connection.getresponse().read()
        connection.close()
        process.send_signal(how)
        process.communicate(timeout=10)
        return
    outer, inner = pty.openpty()
    words = ["--json"] if number % 3 == 0 else []
    env = {**os.environ, "TERM": "xterm-256color"}
    command = [*COMMAND, "monitor", "--session", NAME, *words]
    watcher = subprocess.Popen(command, stdin=inner, stdout=inner, stderr=inner, env=env)
    os.close(inner)
    seen = 0
    while seen < 300 and select.select([outer], [], [], 20)[0]:
        seen += len(os.read(outer, 65536))
    watcher.send_signal(how)
    watcher.wait(10)
    os.close(outer)


def main() -> None:
    args = parser_of(__doc__, seconds=60.0, cycles=20).parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it, and so would its children
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_RUNTIME_DIR"] = folder
        quiet = ["--display", "none", "--set", "governor.quality=fixed", "--session", NAME]
        session = subprocess.Popen([*COMMAND, "up", "--demo", *quiet], stdout=subprocess.DEVNULL)
        try:
            report(args.seconds, args.cycles)
        finally:
            session.send_signal(signal.SIGINT)
            session.wait(20)


def report(seconds: float, cycles: int) -> None:
    end = time.monotonic() + 60
    while time.monotonic() < end:
        with contextlib.suppress(UserError), Watch(find(NAME)) as starting:
            if int(starting.rows["render"]["seq"]) > 200:
                break
        time.sleep(0.2)
    with Watch(find(NAME)) as watch:
        load = os.getloadavg()[0]
        print(f"{len(os.sched_getaffinity(0))} cores, load {load:.1f} at the start, {seconds:g} s each\n")
        print("| watched by | CPU of the watcher, of one core | pictures/s | dropped |\n|---|---|---|---|")
        print(turn(watch, "nobody", seconds, None), flush=True)
        with terminal() as screen:
            print(turn(watch, "`lfpipe monitor`, 4 Hz (bound 2 %)", seconds, screen), flush=True)
        print(turn(watch, "nobody", seconds, None), flush=True)
        with page() as server:
            print(turn(watch, "`lfpipe monitor --web`, one viewer (bound 3 %)", seconds, server), flush=True)
        print(turn(watch, "nobody", seconds, None), flush=True)
        time.sleep(5)  # a lent ring is taken back
        before = belongings(watch)
        for number in range(cycles):
            cycle(number)
        time.sleep(8)
        after = belongings(watch)
        changed = [f"{name}: {before.get(name)} before, {kept} after" for name, kept in after.items() if kept != before.get(name)]
        print(f"\n{cycles} times attached and detached: " + ("; ".join(changed) or "nothing stayed behind"))


if __name__ == "__main__":
    start(main)
