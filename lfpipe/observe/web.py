"""The server of `lfpipe monitor --web`: one page with charts, pictures and controls, for this user on this machine."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import cv2

from lfpipe.errors import UserError
from lfpipe.observe.feed import Feed
from lfpipe.observe.guard import own_page, same_user

HOST = "127.0.0.1"
STATIC = Path(__file__).parent / "static"
KINDS = {".html": "text/html; charset=utf-8", ".js": "text/javascript; charset=utf-8", ".css": "text/css; charset=utf-8"}
COMMANDS = ("set", "pause", "resume", "recentre")
MOST_BYTES = 4096
HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data:",
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}


def _files() -> dict[str, tuple[bytes, str]]:
    found = {f"/{path.name}": (path.read_bytes(), KINDS[path.suffix]) for path in STATIC.iterdir() if path.suffix in KINDS}
    return {**found, "/": found["/index.html"]}


class Server(ThreadingHTTPServer):
    """Bound to 127.0.0.1. Raises OSError where the port is taken."""

    daemon_threads = True
    block_on_close = False  # a viewer that stays connected may not hold up the end

    def __init__(self, name: str, port: int) -> None:
        self.files, self.feed = _files(), Feed(name)
        super().__init__((HOST, port), Handler)  # where the port is taken this calls server_close

    def server_close(self) -> None:
        super().server_close()
        self.feed.end()


class Handler(BaseHTTPRequestHandler):
    """One connection."""

    server: Server
    protocol_version = "HTTP/1.1"
    _ours: bool | None = None
    timeout = 30  # s without a request, or with one that does not get on

    def log_message(self, format: str, *args: Any) -> None:
        """Says nothing: a page asks eight times a second."""

    def _send(self, status: HTTPStatus, body: bytes, kind: str) -> None:
        self.send_response(status)
        for name, value in {"Content-Type": kind, "Content-Length": str(len(body)), **HEADERS}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def _json(self, status: HTTPStatus, value: dict[str, Any]) -> None:
        self._send(status, json.dumps(value).encode(), "application/json")

    def _admitted(self) -> bool:
        if self._ours is None:  # once a connection: it cannot change hands
            self._ours = same_user((str(self.client_address[0]), int(self.client_address[1])))
        port = int(self.server.server_address[1])
        if self._ours and own_page(self.headers.get("Host", ""), self.headers.get("Origin"), port):
            return True
        self.close_connection = True
        self._json(HTTPStatus.FORBIDDEN, {"ok": False, "error": "for the user who started it, on its own address"})
        return False

    def do_GET(self) -> None:
        """The page, its files, the feed, the two pictures."""
        if not self._admitted():
            return
        path = self.path.partition("?")[0]
        if path in self.server.files:
            self._send(HTTPStatus.OK, *self.server.files[path])
        elif path == "/events":
            self._events()
        elif path in ("/camera.jpg", "/picture.jpg"):
            try:
                jpeg = self.server.feed.using(lambda held: held.camera() if path == "/camera.jpg" else held.picture())
            except (UserError, FileNotFoundError, ValueError):  # the session ended in this moment
                jpeg = None
            if jpeg is None:
                self._json(HTTPStatus.SERVICE_UNAVAILABLE, {"ok": False, "error": "no picture yet"})
            else:
                self._send(HTTPStatus.OK, jpeg, "image/jpeg")
        else:
            self._json(HTTPStatus.NOT_FOUND, {"ok": False, "error": "no such page"})

    def _events(self) -> None:
        self.send_response(HTTPStatus.OK)
        for name, value in {"Content-Type": "text/event-stream", **HEADERS}.items():
            self.send_header(name, value)
        self.end_headers()
        self.close_connection = True
        with contextlib.suppress(OSError):  # the viewer has left
            for text in self.server.feed.messages():
                self.wfile.write(f"data: {text}\n\n".encode())

    def do_POST(self) -> None:
        """A command, as JSON: a map with `cmd`, one of COMMANDS or "reset"."""
        if not self._admitted():
            return
        length = self.headers.get("Content-Length", "")
        if not length.isdigit() or int(length) > MOST_BYTES:
            self.close_connection = True
            self._json(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, {"ok": False, "error": f"at most {MOST_BYTES} bytes"})
            return
        try:
            message = json.loads(self.rfile.read(int(length)))
        except ValueError:
            message = None
        word = message.get("cmd") if isinstance(message, dict) else None
        as_json = self.headers.get("Content-Type") == "application/json"
        if self.path != "/ctl" or not as_json or word not in (*COMMANDS, "reset"):
            words = ", ".join((*COMMANDS, "reset"))
            self._json(HTTPStatus.BAD_REQUEST, {"ok": False, "error": f"a JSON map with cmd, one of {words}"})
            return
        try:
            if word == "reset":
                self.server.feed.using(lambda held: held.reset())
                answer: dict[str, Any] = {"ok": True}
            else:
                answer = self.server.feed.using(lambda held: held.command(message))
            self._json(HTTPStatus.OK, answer)
        except UserError as error:
            self._json(HTTPStatus.BAD_REQUEST, {"ok": False, "error": error.message, "remedy": error.remedy})


def serve(name: str, port: int, tell: Callable[[str], None]) -> None:
    """Serves the page of session `name` until Ctrl-C. Raises UserError where the port is taken."""
    try:
        server = Server(name, port)
    except OSError as error:
        raise UserError(f"--port {port}: {error.strerror}", "another --port, or 0 for a free one") from None
    cv2.setNumThreads(1)  # the session's stages need the cores
    tell(f"session {name!r} on http://{HOST}:{server.server_address[1]}/ (Ctrl-C ends)")
    try:
        server.serve_forever(0.2)
    except KeyboardInterrupt:
        pass
    finally:
        server.server_close()
