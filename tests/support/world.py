"""Real sessions in a private world: run directory, cache and settings under tmp_path."""

import json
import os
import secrets
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, ClassVar, Self

import cv2
import msgpack
import numpy as np
import psutil
import pytest
import zmq

from lfpipe.scene.pack import DEMOS, demo_scene
from lfpipe.transport import control
from lfpipe.transport.control import PREFIX, base_dir
from tests.support.processes import PATIENCE_S

LARGE = (  # a camera whose frames keep a recorder busy
    "--set=camera.width_px=1280",
    "--set=camera.height_px=720",
    "--set=camera.rate_hz=60",
)


def write_scene(
    folder: Path, rows: int = 3, cols: int = 3, size: tuple[int, int] = (48, 64)
) -> Path:
    """Views that tell themselves: red holds 10 * row + col, green the column, blue the row, each
    times 8, everywhere.
    """
    folder.mkdir(parents=True)
    for row in range(rows):
        for col in range(cols):
            view = np.zeros((*size, 3), np.uint8)
            view[:] = (8 * row + 5, 8 * col + 5, 8 * (3 * row + col) + 5)
            cv2.imwrite(str(folder / f"view_{row:02d}_{col:02d}.png"), view)
    return folder


def write_package(folder: Path, entry_points: str, name: str, version: str = "1.0") -> None:
    """Writes to a folder of modules what makes them an installed package of that name."""
    about = folder / f"{name}-{version}.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    (about / "entry_points.txt").write_text(entry_points)


def runs(pid: int) -> bool:
    """Whether a process exists and has not ended: one whose parent was killed may wait long for
    init to read its exit code.
    """
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def until(
    condition: Callable[..., Any],
    what: str,
    timeout_s: float = 120,
    about: Callable[[], str] = lambda: "",
) -> Any:
    """Waits until condition returns something that is true, and returns it.

    about: what else to say when it does not.
    """
    end = time.monotonic() + timeout_s
    while time.monotonic() < end:
        if found := condition():
            return found
        time.sleep(0.02)
    raise AssertionError(f"no {what} within {timeout_s} s{about()}")


def stays(condition: Callable[[], Any], seconds: float, what: str = "that") -> None:
    """Fails if condition is false at any time during seconds."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        assert condition(), f"{what} has ended within {seconds} s"
        time.sleep(0.02)


def written(process: subprocess.Popen[str]) -> tuple[str, str]:
    """What a process that has ended wrote on stdout and stderr. Raises TimeoutExpired where one
    that it started keeps them open.
    """
    return process.communicate(timeout=PATIENCE_S)


@contextmanager
def connected(
    run_dir: Path, kind: int = zmq.DEALER, place: str = "ctl"
) -> Iterator[zmq.Socket[bytes]]:
    """A client of a session's control socket, or of another one of its."""
    with control.context() as ctx, ctx.socket(kind) as socket:
        socket.set_hwm(0)  # what arrives waits until the test reads it, however long that takes
        control.connect(socket, run_dir, place)
        yield socket


def answer_of(socket: zmq.Socket[bytes], message: dict[str, Any]) -> dict[str, Any]:
    """The answer to a message of any shape."""
    socket.send(msgpack.packb(message, unicode_errors="surrogatepass"))
    assert socket.poll(60_000), f"no answer to {message!r:.200}"
    data = socket.recv()
    assert len(data) <= control.MAX_BYTES
    return control.decode(data)


class World:
    """Starts `lfpipe` commands; `shows` waits until a session shows pictures. A context: what runs
    in it ends with it, also where its set-up fails.
    """

    packs: ClassVar[Path | None] = None  # a cache: what is packed there, every world has already

    def __init__(self, root: Path) -> None:
        self.root = root
        if self.packs is not None:
            shutil.copytree(self.packs, root / "cache")
        self.python = sys.executable
        self.module = "lfpipe"  # another one runs it with a part replaced
        self.run_dir = Path(tempfile.mkdtemp(prefix="lfp", dir=base_dir()))
        clean = {
            key: value
            for key, value in os.environ.items()
            if key not in ("DISPLAY", "WAYLAND_DISPLAY", "LFPIPE_SESSION")
        }
        names = {
            "XDG_CACHE_HOME": "cache",
            "XDG_CONFIG_HOME": "settings",
            "XDG_STATE_HOME": "state",
            "XDG_PICTURES_DIR": "pictures",
            "XDG_VIDEOS_DIR": "videos",
        }
        own = {key: str(root / name) for key, name in names.items()} | {
            "LFPIPE_RUN_DIR": str(self.run_dir)
        }
        own["PYTHONPATH"] = str(Path(__file__).parents[2])
        self.env = {**clean, **own}
        self.name = f"t{secrets.token_hex(4)}"
        self.trace = root / "trace.jsonl"
        self._first = b""  # line of the trace that was read
        self._lines: list[dict[str, Any]] = []
        self._read_bytes = 0
        self.running: list[subprocess.Popen[str]] = []

    def make_demos_small(self) -> None:
        """Demo scenes of 96 instead of 768 px, which are packed as quickly as others."""
        cache = self.root / "cache" / "lfpipe"
        for name in DEMOS:
            small = demo_scene(cache, name, 96)
            small.rename(small.with_name(name))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def start(self, *args: object, **more: Any) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", self.module, *map(str, args)]
        pipes = {
            "stdout": subprocess.PIPE,
            "stderr": subprocess.PIPE,
            "text": True,
            "cwd": self.root,
            "env": self.env,
        }
        process = subprocess.Popen(command, **{**pipes, **more})
        self.running.append(process)
        return process

    def run(
        self, *args: object, timeout_s: float = 120, **more: Any
    ) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "lfpipe", *map(str, args)]
        usual = {"capture_output": True, "text": True, "cwd": self.root, "env": self.env}
        return subprocess.run(command, timeout=timeout_s, **{**usual, **more})

    def done(self, *args: object) -> subprocess.CompletedProcess[str]:
        """A command that succeeds."""
        ended = self.run(*args)
        assert ended.returncode == 0, ended.stdout + ended.stderr
        return ended

    def refused(self, *args: object) -> str:
        """What a command says that is refused."""
        ended = self.run(*args)
        assert ended.returncode == 2 and "Traceback" not in ended.stderr, ended.stderr
        return ended.stderr

    def ctl(self, *words: str | Path) -> str:
        """What `lfpipe ctl` prints of this world's session."""
        return self.done("ctl", "--session", self.name, *words).stdout

    def up(
        self,
        scene: Path,
        *args: object,
        camera: str = "demo",
        display: str = "none",
        **more: Any,
    ) -> subprocess.Popen[str]:
        fixed = (
            "--camera",
            camera,
            "--display",
            display,
            "--trace",
            self.trace,
            "--session",
            self.name,
        )
        return self.start("up", scene, *fixed, *args, **more)

    def shows(
        self, scene: Path, *args: object, pictures: int = 5, **more: Any
    ) -> subprocess.Popen[str]:
        """A session, once it has shown more than so many pictures."""
        process = self.up(scene, *args, **more)
        self.pictures(pictures)
        return process

    def kill(self, stage: str, signum: int = signal.SIGKILL) -> int:
        """Sends a signal to a stage; its pid."""
        pid = int(self.monitor()["stages"][stage]["pid"])
        os.kill(pid, signum)
        return pid

    def xdotool(self, *words: object) -> None:
        """Keys, text and the mouse, on the screen of the session."""
        subprocess.run(["xdotool", *map(str, words)], check=True, env=self.env)

    def ended(self, process: subprocess.Popen[str], signum: int = 0, code: int = 0) -> str:
        """What a session wrote on stderr until its end, which a signal may ask for.

        Nothing is left of it.
        """
        if signum:
            process.send_signal(signum)
        _, err = process.communicate(timeout=120)
        assert process.returncode == code and "Traceback" not in err, err
        assert not self.left(), "something is left"
        return err

    def lines(self) -> list[dict[str, Any]]:
        """The trace so far, without a line that is just being written."""
        if not self.trace.exists():
            return []
        with self.trace.open("rb") as file:  # waits ask often: only what is new is read
            first = file.readline()
            if first != self._first:
                self._first, self._lines, self._read_bytes = first, [], 0
            file.seek(self._read_bytes)
            whole = file.read().rpartition(b"\n")[0]
        self._read_bytes += len(whole) + bool(whole)
        self._lines += map(json.loads, whole.splitlines())
        return [*self._lines]

    def wait_for(self, condition: Callable[..., Any], what: str, timeout_s: float = 120) -> Any:
        return until(condition, what, timeout_s, self._about_ended)

    def _about_ended(self) -> str:
        ended = [process for process in self.running if process.poll() is not None]
        try:
            return f"; ended processes: {[(one.returncode, *written(one)) for one in ended]}"
        except subprocess.TimeoutExpired as error:
            return f"; ended with its output open in another process: {error.cmd}"

    def pictures(self, more_than: int = 0) -> list[dict[str, Any]]:
        lines: list[dict[str, Any]] = self.wait_for(
            lambda: lines if len(lines := self.lines()) > more_than else None,
            f"picture {more_than + 1}",
        )
        return lines

    def more_pictures(self, count: int) -> list[dict[str, Any]]:
        """The trace once it has more than so many new lines."""
        return self.pictures(len(self.lines()) + count)

    @contextmanager
    def entered(self) -> Iterator[None]:
        """This process finds the sessions of this world."""
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("LFPIPE_RUN_DIR", str(self.run_dir))
            yield

    @contextmanager
    def tap(self) -> Iterator[Callable[[str], list[dict[str, Any]]]]:
        """What the session publishes from now on, by topic."""
        messages: list[dict[str, Any]] = []
        with (
            connected(self.session_dir, zmq.SUB, "tap") as tap,
            connected(self.session_dir, zmq.PUSH, "bus") as bus,
        ):
            tap.subscribe(b"")

            def heard(topic: str) -> list[dict[str, Any]]:
                while tap.poll(0):
                    messages.append(control.decode(tap.recv()))
                return [message for message in messages if message["topic"] == topic]

            def echo() -> object:
                bus.send(control.encode({"topic": "echo"}), zmq.NOBLOCK)
                return tap.poll(20)

            self.wait_for(echo, "subscription")
            yield heard

    @property
    def session_dir(self) -> Path:
        return self.run_dir / f"{PREFIX}{self.name}"

    def ask(self, **message: Any) -> dict[str, Any]:
        """The answer to a command. Raises UserError if it is refused."""
        return control.request(self.session_dir, message, 120)

    def monitor(self) -> dict[str, Any]:
        """The figures that `lfpipe monitor --once --json` prints, without a process for them."""
        return self.ask(cmd="status")

    def left(self) -> list[str]:
        """What the sessions of this world have left."""
        # walk passes over what is removed meanwhile
        return [
            f"{folder}/{name}"
            for folder, folders, files in os.walk(self.run_dir)
            for name in (*folders, *files)
        ]

    def segments(self, part: str = "") -> list[str]:
        """Names of the shared memory of this world's sessions; of one kind, where part names
        it.
        """
        names = (path.name for path in self.run_dir.glob("*/*") if path.suffix == ".ring")
        tables = (path.name for path in self.run_dir.glob("*/status"))
        return sorted(name for name in (*names, *tables) if name.startswith(part))

    def end(self) -> None:
        """Kills what is left in this world, also what lost its parent or is stopped: its output
        would stay open for ever.
        """
        for process in self.running:
            process.kill()
        for child in psutil.process_iter(["environ"]):
            if (child.info["environ"] or {}).get("LFPIPE_RUN_DIR") == str(self.run_dir):
                with suppress(psutil.NoSuchProcess):
                    child.kill()
        for process in self.running:
            written(process)
        shutil.rmtree(self.run_dir, ignore_errors=True)


@contextmanager
def private_world() -> Iterator[World]:
    """A world for a script: what it leaves goes, and what this process looks for is there."""
    with (
        tempfile.TemporaryDirectory(prefix="lfworld") as folder,
        World(Path(folder)) as world,
        world.entered(),
    ):
        yield world
