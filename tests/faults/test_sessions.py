"""Unexpected ends of sessions and of their terminals, lost output, and sessions side by side."""

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
from pathlib import Path
from typing import Any

import pytest

from lfpipe.sequence.folder import open_sequence
from lfpipe.supervisor.stage_process import STOP_S, TERM_S
from tests.replay.test_record import frames
from tests.support.world import LARGE, World, runs

SMALL = tuple(
    f"--set={key}"
    for key in (
        "camera.width_px=160",
        "camera.height_px=120",
        "render.clock=camera",
        "render.method=nearest",
    )
)
OTHER = ("--camera", "demo", "--display", "none", "--session", "other", "--duration", "0.2", *SMALL)


def _gone(pids: list[int]) -> bool:
    return not any(runs(pid) for pid in pids)


@pytest.mark.parametrize("stopped", [1, 3])
def test_stages_do_not_outlive_a_killed_supervisor(world: World, scene: Path, stopped: int) -> None:
    """A stopped process does not handle the SIGTERM that the kernel sends when the supervisor dies.
    A sweep resumes it: by the first stage to end, or, if all are stopped, by the next session.
    """
    process = world.shows(scene, *SMALL, start_new_session=True)
    pids = [stage["pid"] for stage in world.monitor()["stages"].values()]
    for pid in pids[1:2] if stopped == 1 else pids:
        os.kill(pid, signal.SIGSTOP)
    process.kill()
    process.wait(60)
    if stopped == 3:
        assert world.left() and not _gone(pids), "nobody to wake: this test shows nothing"
        world.done("up", scene, *OTHER)
    world.wait_for(lambda: _gone(pids), "end of all")
    world.wait_for(lambda: not world.left(), "clean end")


BEGIN_AND_END = """
import os, sys
from lfpipe import config
from lfpipe.supervisor import rundir
from lfpipe.supervisor.session_state import SessionState
from lfpipe.supervisor.session_state import SessionStore
from lfpipe.host.files import Segment
from lfpipe.transport.control import Session
session = Session(sys.argv[1])
for _ in range(12):
    rundir.sweep()
    lock = rundir.acquire(session)
    small = config.Config(camera=config.Camera(width_px=160, height_px=120))
    memory = SessionStore(session, SessionState.first(small, config.SessionOptions()))
    assert lock.in_place() and session.name in rundir.running()
    memory.table.rows["render"]["pid"] = os.getpid()
    again = Segment(session.segment("status"))
    assert os.getpid().to_bytes(4, "little") in bytes(again.buf), "the memory is another session's"
    again.close()
    memory.close()
    rundir.remove(session.run_dir, lock)
"""


def test_sweep_spares_sessions_that_begin_at_once(world: World) -> None:
    """A directory that is created but not yet locked looks like a dead session's to a concurrent
    sweep. Half of them have the names of the others, under another runtime directory.
    """
    other = world.run_dir / "other"  # a short path: it holds sockets
    other.mkdir()
    processes = []
    for k in range(6):
        command = [sys.executable, "-c", BEGIN_AND_END, f"{world.name}.{k % 3}"]
        env = {**world.env, "LFPIPE_RUN_DIR": str(world.run_dir if k < 3 else other)}
        processes.append(
            subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env
            )
        )
    outputs = [process.communicate(timeout=100) for process in processes]
    assert [process.returncode for process in processes] == [0] * 6, outputs
    assert not world.segments() and not list(other.iterdir())


def test_a_second_interrupt_ends_a_stage_that_does_not_stop(world: World, scene: Path) -> None:
    """Else it has STOP_S + TERM_S to end."""
    process = world.shows(scene, *SMALL)
    other = world.monitor()["stages"]["capture"]["pid"]
    world.kill("render", signal.SIGSTOP)
    process.send_signal(signal.SIGINT)
    world.wait_for(lambda: not runs(other), "end of the other stages")
    again_s = time.monotonic()
    world.ended(process, signal.SIGINT)
    assert time.monotonic() - again_s < (STOP_S + TERM_S) / 2


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


@pytest.mark.parametrize("how", ["closed", "hung up"])
def test_record_ends_in_order_with_its_terminal(world: World, how: str) -> None:
    out = world.root / "rec"
    terminal = Terminal(world, f"exec {lfpipe('record', out, '--camera', 'demo', *LARGE)}")
    world.wait_for(lambda: frames(out) > 10, "frames")
    if how == "closed":
        terminal.close()
    else:
        for _ in range(2):  # the shell passes it on, and so does the kernel
            os.killpg(terminal.shell.pid, signal.SIGHUP)
    terminal.shell.wait(120)
    assert json.loads((out / "manifest.json").read_text())["complete"]
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
