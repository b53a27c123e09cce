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
from pathlib import Path
from typing import Any

import pytest

from lfpipe.sequence.folder import open_sequence
from tests.replay.test_record import frames
from tests.support.world import World, runs

LARGE = (
    "--set",
    "camera.width_px=1280",
    "--set",
    "camera.height_px=720",
    "--set",
    "camera.rate_hz=60",
)
SMALL = ("--set", "camera.width_px=160", "--set", "camera.height_px=120")


class Terminal:
    """A shell command as the session leader of a real terminal, until `close`."""

    def __init__(self, world: World, script: str) -> None:
        self._fd, inner = pty.openpty()

        def take_terminal() -> None:
            os.setsid()
            fcntl.ioctl(0, termios.TIOCSCTTY, 0)
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))

        pipes: dict[str, Any] = {"stdin": inner, "stdout": inner, "stderr": inner}
        self.shell = subprocess.Popen(
            ["sh", "-c", script], cwd=world.root, env=world.env, preexec_fn=take_terminal, **pipes
        )
        os.close(inner)

    def close(self) -> None:
        """Acts like closing the window: all its processes get SIGHUP, and writing fails."""
        os.close(self._fd)


def lfpipe(*words: str | Path) -> str:
    return shlex.join([sys.executable, "-m", "lfpipe", *map(str, words)])


@pytest.mark.parametrize("how", ["closed", "hung up", "quit"])
def test_record_ends_in_order_with_its_terminal(world: World, how: str) -> None:
    out = world.root / "rec"
    terminal = Terminal(world, f"exec {lfpipe('record', out, '--camera', 'demo', *LARGE)}")
    world.wait_for(lambda: frames(out) > 10, "frames")
    if how == "closed":
        terminal.close()
    else:
        # the shell passes SIGHUP on, and so does the kernel
        for _ in range(2 if how == "hung up" else 1):
            os.killpg(terminal.shell.pid, signal.SIGHUP if how == "hung up" else signal.SIGQUIT)
    terminal.shell.wait(120)
    # SIGQUIT: later
    world.wait_for(
        lambda: json.loads((out / "manifest.json").read_text())["complete"], "end of the recording"
    )
    world.wait_for(lambda: not world.left(), "clean end")
    assert (
        json.loads((out / "manifest.json").read_text())["frames"]
        == len(open_sequence(out).packets)
        > 10
    )
    if how != "closed":
        terminal.close()


@pytest.mark.parametrize("how", ["terminal", "closed"])
def test_session_without_a_terminal_goes_on(world: World, scene: Path, how: str) -> None:
    """It has no output, and ignores the end of its terminal."""
    shown = ("--camera", "demo", "--display", "none", "--trace", world.trace)
    command = lfpipe("up", scene, *shown, "--session", world.name, *SMALL)
    if how == "terminal":
        terminal = Terminal(world, f"trap '' HUP; exec {command}")
        deaf = terminal.shell
        world.pictures(5)
        terminal.close()
    else:
        deaf = subprocess.Popen(
            ["sh", "-c", f"exec {command} <&- >&- 2>&-"], cwd=world.root, env=world.env
        )
        world.pictures(5)
    # the supervisor reports both, or tries to
    for stage, signum in (("track", signal.SIGKILL), ("render", signal.SIGSTOP)):
        world.kill(stage, signum)
        world.wait_for(
            lambda stage=stage: world.monitor()["stages"][stage]["restarts"] == 1,
            f"restart of {stage}",
        )
    world.more_pictures(10)
    assert deaf.poll() is None
    pids = [stage["pid"] for stage in world.monitor()["stages"].values()]
    world.ctl("stop")
    assert deaf.wait(120) == 0
    assert not world.left() and not any(runs(pid) for pid in pids)


def test_sigint_while_the_stages_start_leaves_nothing(world: World, scene: Path) -> None:
    process = world.up(scene, *SMALL, start_new_session=True)
    world.wait_for(lambda: list(world.run_dir.glob("*/session.json")), "session")
    os.killpg(process.pid, signal.SIGINT)
    world.ended(process)
