"""A vanished terminal and lost output: sessions end cleanly, or continue if they should."""

import fcntl
import json
import os
import pty
import resource
import shlex
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from lfpipe.sequence.folder import open_sequence
from tests.faults.session import runs
from tests.world import World

pytestmark = pytest.mark.live

LARGE = ("--set", "camera.width_px=1280", "--set", "camera.height_px=720", "--set", "camera.rate_hz=60")
SMALL = ("--set", "camera.width_px=160", "--set", "camera.height_px=120")


class Terminal:
    """A shell command as the session leader of a real terminal, until `close`."""

    def __init__(self, world: World, script: str) -> None:
        self._fd, inner = pty.openpty()

        def take_terminal() -> None:
            os.setsid()
            fcntl.ioctl(0, termios.TIOCSCTTY, 0)
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))

        pipes = {"stdin": inner, "stdout": inner, "stderr": inner, "text": False}
        self.shell = subprocess.Popen(["sh", "-c", script], cwd=world.root, env=world.env, preexec_fn=take_terminal, **pipes)
        os.close(inner)

    def close(self) -> None:
        """Acts like closing the window: all its processes get SIGHUP, and writing fails."""
        os.close(self._fd)


def lfpipe(*words: str | Path) -> str:
    return shlex.join([sys.executable, "-m", "lfpipe", *map(str, words)])


def frames(out: Path) -> int:
    return (out / "frames.jsonl").read_text().count("\n") if (out / "frames.jsonl").exists() else 0


def stages(world: World) -> list[int]:
    return [stage["pid"] for stage in world.monitor()["stages"].values()]


def test_closing_the_terminal_ends_a_recording_in_order(world: World) -> None:
    out = world.root / "rec"
    terminal = Terminal(world, f"{lfpipe('record', out, '--camera', 'demo', *LARGE)}; true")
    world.wait_for(lambda: frames(out) > 10, "frames")
    terminal.close()
    terminal.shell.wait(60)
    world.wait_for(lambda: not world.left(), "clean end", 60)
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["complete"] and manifest["frames"] == len(open_sequence(out).packets) > 10


@pytest.mark.parametrize("signum", [signal.SIGHUP, signal.SIGINT, signal.SIGQUIT])
def test_a_signal_from_the_terminal_to_all_its_processes_ends_a_recording_in_order(world: World, signum: int) -> None:
    out = world.root / "rec"
    terminal = Terminal(world, f"exec {lfpipe('record', out, '--camera', 'demo', *LARGE)}")
    world.wait_for(lambda: frames(out) > 10, "frames")
    os.killpg(terminal.shell.pid, signum)
    if signum == signal.SIGHUP:
        time.sleep(0.1)
        os.killpg(terminal.shell.pid, signum)  # the shell passes it on, and so does the kernel
    world.wait_for(lambda: terminal.shell.poll() is not None, "end", 60)
    world.wait_for(lambda: not world.left(), "clean end", 60)
    world.wait_for(lambda: json.loads((out / "manifest.json").read_text())["complete"], "end of the recording", 60)
    terminal.close()


@pytest.fixture(params=["terminal", "pipe", "closed"])
def deaf(request: pytest.FixtureRequest, world: World, scene: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A session without output that ignores the end of its terminal."""
    wish = ("--camera", "demo", "--display", "none", "--trace", world.trace, "--session", world.name)
    command = lfpipe("up", scene, *wish, *SMALL)
    if request.param == "terminal":
        terminal = Terminal(world, f"trap '' HUP; exec {command}")
        shell = terminal.shell
        world.pictures(5)
        terminal.close()
    elif request.param == "pipe":
        shell = subprocess.Popen(
            ["sh", "-c", f"exec {command}"], cwd=world.root, env=world.env, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
        world.pictures(5)
        assert shell.stdout is not None and shell.stderr is not None
        shell.stdout.close()
        shell.stderr.close()
    else:
        shell = subprocess.Popen(["sh", "-c", f"exec {command} <&- >&- 2>&-"], cwd=world.root, env=world.env)
        world.pictures(5)
    yield shell
    if shell.poll() is None:
        shell.kill()
        shell.wait()


def test_a_session_without_ears_goes_on_says_what_it_has_to_say_and_ends_when_asked(
    deaf: subprocess.Popen[bytes], world: World
) -> None:
    killed = world.monitor()["stages"]["track"]["pid"]
    os.kill(killed, signal.SIGKILL)  # the supervisor reports it, or tries to
    world.wait_for(lambda: world.monitor()["stages"]["track"]["restarts"] == 1, "restart")
    hung = world.monitor()["stages"]["render"]["pid"]
    os.kill(hung, signal.SIGSTOP)  # its stack is reported
    world.wait_for(lambda: world.monitor()["stages"]["render"]["restarts"] == 1, "restart")
    world.pictures(len(world.lines()) + 10)
    assert deaf.poll() is None
    pids = stages(world)
    assert world.run("ctl", "--session", world.name, "stop").returncode == 0
    assert deaf.wait(60) == 0
    assert not world.left() and not any(runs(pid) for pid in pids)


@pytest.mark.parametrize("signum", [signal.SIGHUP, signal.SIGINT])
def test_a_signal_while_the_stages_start_leaves_nothing(world: World, scene: Path, signum: int) -> None:
    process = world.up(scene, *SMALL, start_new_session=True)
    world.wait_for(lambda: list(world.run_dir.glob("*/session.json")), "session")
    os.killpg(process.pid, signum)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0 and "Traceback" not in err, err
    assert not world.left()
