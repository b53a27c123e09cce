"""`lfpipe monitor --web` as a process, and requests to it."""

import base64
import http.client
import json
import re
import signal
import socket
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

import attrs
import cv2
import numpy as np
import psutil

from tests.support.world import World, until


@attrs.frozen
class Server:
    """port and tokens: as printed. pid: of the process."""

    port: int
    token: str
    watch_token: str
    pid: int

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/?token={self.token}"

    @property
    def bearer(self) -> dict[str, str]:
        return {"Authorization": f"Bearer {self.token}"}

    def ask(self, method: str, path: str, body: Any = None, **headers: str) -> tuple[int, bytes]:
        """Status and body of an answer; with the token.

        Bytes are sent as they are, another body as JSON.
        """
        answer, data = self.answer(method, path, body, **{**self.bearer, **headers})
        return answer.status, data

    def answer(
        self, method: str, path: str, body: Any = None, **headers: str
    ) -> tuple[http.client.HTTPResponse, bytes]:
        """The same, with its headers and without the token."""
        kind = {"Content-Type": "application/json"} if body is not None else {}
        data = body if body is None or isinstance(body, bytes) else json.dumps(body)
        with closing(http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)) as connection:
            connection.request(method, path, data, {**kind, **headers})
            answer = connection.getresponse()
            return answer, answer.read()

    def viewer(self) -> tuple[http.client.HTTPConnection, http.client.HTTPResponse]:
        """An open stream of events."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        connection.request("GET", "/events", headers=self.bearer)
        return connection, connection.getresponse()

    def events(self) -> Iterator[tuple[str, bytes]]:
        """(name, data) of the events of one viewer."""
        connection, answer = self.viewer()
        name = ""
        with closing(connection):
            for line in answer:
                word, _, value = line.rstrip(b"\n").partition(b": ")
                if word == b"data":
                    yield name, value
                name = value.decode() if word == b"event" else ""

    def jpeg(self, which: str) -> bytes:
        """The next picture of that name."""
        return next(base64.b64decode(data) for name, data in self.events() if name == which)

    def picture(self, which: str = "picture") -> np.ndarray:
        picture = cv2.imdecode(np.frombuffer(self.jpeg(which), np.uint8), cv2.IMREAD_COLOR)
        assert picture is not None
        return picture

    def send(self, data: bytes) -> socket.socket:
        """A connection that has sent data."""
        connection = socket.create_connection(("127.0.0.1", self.port), timeout=60)
        connection.sendall(data)
        return connection

    def threads(self) -> int:
        return int(psutil.Process(self.pid).num_threads())

    def sockets(self) -> int:
        return len(psutil.Process(self.pid).net_connections())


@contextmanager
def served(world: World, *args: str, **more: Any) -> Iterator[Server]:
    """Serves the page of the world's session until Ctrl-C. more: of the process.

    Fails where it wrote more than its addresses.
    """
    log = world.root / f"monitor-{time.monotonic_ns()}.log"
    with log.open("w") as output:
        words = ("monitor", "--session", world.name, "--web", *(args or (":0",)))
        process = world.start(*words, stdout=output, stderr=output, **more)
    addresses = r"http://\S+:(\d+)/\?token=(\S+)[^?]*\?token=(\S+)\n"
    port, token, watch_token = until(lambda: re.findall(addresses, log.read_text()), "addresses")[0]
    yield Server(int(port), token, watch_token, process.pid)
    assert process.poll() is None, log.read_text()
    process.send_signal(signal.SIGINT)
    code = process.wait(60)
    text = log.read_text()
    once = text.count(token) == text.count(watch_token) == 1
    assert code == 0 and len(text.splitlines()) == 2 and once, text
