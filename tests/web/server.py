"""`lfpipe monitor --web` as a process, and requests to it."""

import http.client
import json
import re
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import attrs

from tests.world import World


@attrs.frozen
class Server:
    """port and token: as printed. pid: of the process. log: the file with all that it writes, after the first line."""

    port: int
    token: str
    pid: int
    log: Path

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/?token={self.token}"

    def ask(self, method: str, path: str, body: Any = None, **headers: str) -> tuple[int, bytes]:
        """Status and body of an answer; with the token. A str or bytes is sent as it is, another body as JSON."""
        answer, data = self.answer(method, path, body, **{"Authorization": f"Bearer {self.token}", **headers})
        return answer.status, data

    def answer(self, method: str, path: str, body: Any = None, **headers: str) -> tuple[http.client.HTTPResponse, bytes]:
        """The same, with its headers and without the token."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        kind = {"Content-Type": "application/json"} if body is not None else {}
        data = body if body is None or isinstance(body, str | bytes) else json.dumps(body)
        connection.request(method, path, data, {**kind, **headers})
        answer = connection.getresponse()
        read = answer.read()
        connection.close()
        return answer, read

    def send(self, data: bytes) -> socket.socket:
        """A connection that has sent data."""
        made = socket.create_connection(("127.0.0.1", self.port), timeout=60)
        made.sendall(data)
        return made

    def threads(self) -> int:
        return len(list(Path(f"/proc/{self.pid}/task").iterdir()))

    def sockets(self) -> int:
        found = Path(f"/proc/{self.pid}/fd")
        return sum(1 for each in found.iterdir() if each.is_symlink() and str(each.readlink()).startswith("socket:"))


@contextmanager
def served(world: World, *args: str) -> Iterator[Server]:
    """Serves the page of the world's session. Fails where it wrote a traceback, or its token anywhere but at the start."""
    log = world.root / f"monitor-{time.monotonic_ns()}.log"
    with log.open("w") as output:
        words = ("monitor", "--session", world.name, "--web", *(args or (":0",)))
        process = world.start(*words, stdout=output, stderr=output)
    said = until(lambda: re.search(r"http://(\S+):(\d+)/\?token=(\S+)", log.read_text()), "address")
    yield Server(int(said[2]), said[3], process.pid, log)
    assert process.poll() is None, log.read_text()
    process.terminate()
    process.wait(60)
    text = log.read_text()
    assert "Traceback" not in text, text
    assert text.count(said[3]) == 1, text


def until(condition: Callable[[], Any], what: str, timeout_s: float = 20) -> Any:
    end = time.monotonic() + timeout_s
    while time.monotonic() < end:
        if found := condition():
            return found
        time.sleep(0.1)
    raise AssertionError(f"no {what} within {timeout_s} s")
