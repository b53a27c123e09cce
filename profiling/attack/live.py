"""A session under attack: started, asked, and looked at from outside."""

import resource
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

import zmq

from lfpipe.transport import control
from profiling.attack.messages import Message
from tests.world import World, write_scene

ANSWER_S = 15.0  # on a machine that others use, too
SETS = (
    "governor.quality=fixed",
    "camera.width_px=320",
    "camera.height_px=240",
    "render.method=nearest",
    "camera.rate_hz=15",
    "render.clock=camera",
)
NOT_OURS = ("pictures", "packets", "level", "leased")  # options that the session changes itself


class Dead(Exception):
    """The session has ended, or does not answer."""


class Live:
    """From the constructor to `end`."""

    def __init__(self, work: Path) -> None:
        self.root = Path(tempfile.mkdtemp(prefix="live", dir=work))
        self.world = World(self.root)
        options = [word for text in SETS for word in ("--set", text)]
        self.log = self.root / "session.log"
        with self.log.open("w") as log:
            self.process = self.world.up(write_scene(self.root / "scene"), *options, stdout=log, stderr=log)
        self.world.wait_for(lambda: len(self.world.lines()) > 3 or self.process.poll() is not None, "pictures", 90)
        self.run_dir = next(self.world.run_dir.glob(f"lfpipe-*{self.world.name}"))
        self.context = control.context()
        self.sockets = {name: self.socket(name) for name in ("ctl", "bus", "tap")}
        self.private = self.socket("ctl")
        self.told = self.hello()
        self.stages = self.state()

    def socket(self, name: str) -> zmq.Socket[bytes]:
        """A new connection to one of the session's sockets."""
        made = self.context.socket({"ctl": zmq.DEALER, "bus": zmq.PUSH, "tap": zmq.XSUB}[name])
        made.setsockopt(zmq.SNDTIMEO, int(ANSWER_S * 1000))
        control.connect(made, self.run_dir, name)
        return made

    def ask(self, message: dict[str, Any], timeout_s: float = ANSWER_S) -> dict[str, Any]:
        """One request of ours and its answer, whatever it is. Raises Dead."""
        while self.private.poll(0):
            self.private.recv()
        self.private.send(control.encode(message))
        end = time.monotonic() + timeout_s
        while time.monotonic() < end:
            if self.private.poll(100):
                return dict(control.decode(self.private.recv()))
            if self.process.poll() is not None:
                raise Dead(f"the session ended with {self.process.returncode}: {self.said()[-1500:]}")
        raise Dead(f"no answer to {message} within {timeout_s:g} s: {self.said()[-1500:]}")

    def said(self) -> str:
        """What the session printed."""
        return self.log.read_text(errors="replace")

    def hello(self) -> dict[str, Any]:
        """Configuration, options and revision; without the options that the session changes itself."""
        found = self.ask({"cmd": "hello"})
        options = {name: content for name, content in found["options"].items() if not name.startswith(NOT_OURS)}
        return {
            "config": found["config"],
            "paused": found["paused"],
            "rev": found["rev"],
            "options": options,
            "all": found["options"],
        }

    def state(self) -> dict[str, Any]:
        """Of the stages."""
        return dict(self.ask({"cmd": "status"})["stages"])

    def send(self, name: str, message: Message) -> None:
        """Sends a message. Raises Dead where nobody takes it."""
        try:
            self.sockets[name].send_multipart(message.frames)
        except zmq.Again:
            raise Dead(f"{name} takes no more: {self.said()[-1500:]}") from None

    def answers(self, wanted: int, limit_s: float = ANSWER_S) -> list[bytes]:
        """So many answers on ctl, or fewer where there are none for limit_s. Raises Dead where the session ended."""
        found: list[bytes] = []
        end = time.monotonic() + limit_s
        while len(found) < wanted and time.monotonic() < end:
            if self.sockets["ctl"].poll(100):
                found.append(b"".join(self.sockets["ctl"].recv_multipart()))
                end = time.monotonic() + limit_s
            elif self.process.poll() is not None:
                raise Dead(f"the session ended with {self.process.returncode}: {self.said()[-1500:]}")
        return found

    def resources(self) -> tuple[float, int]:
        """(memory in MB, open files) of the supervisor."""
        proc = Path(f"/proc/{self.process.pid}")
        pages = int((proc / "statm").read_text().split()[1])
        return pages * resource.getpagesize() / 1e6, len(list((proc / "fd").iterdir()))

    def end(self) -> None:
        """Ends the session, however it is."""
        for socket in (*self.sockets.values(), self.private):
            socket.close()
        self.context.term()
        self.process.terminate()
        try:
            self.process.wait(5)
        except Exception:  # it hangs: that was noted before
            self.process.kill()
        self.world.end()
        shutil.rmtree(self.root, ignore_errors=True)
