"""An HTTP server that clients cannot exhaust: Tornado, with limits on time, sizes and connections. One thread, no log."""

import asyncio
import contextlib
import ipaddress
import logging
import socket
from collections.abc import Awaitable, Callable
from http import HTTPStatus
from typing import Any

from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPConnection, HTTPMessageDelegate
from tornado.iostream import StreamClosedError
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler

from lfpipe.errors import UserError

READ_TIMEOUT_S = 10.0  # for the headers of a request, for its body, and between two requests
WRITE_TIMEOUT_S = 10.0  # for an answer, or a piece of a stream
MAX_HEADER_BYTES = 16 * 1024
MAX_BODY_BYTES = 64 * 1024
SEND_BUFFER_BYTES = 64 * 1024  # of the kernel; small, so that a slow reader of a stream skips to the newest data
MAX_STRANGERS = 64  # connections not yet admitted; one more closes the oldest of them
POLICY = "frame-ancestors 'none'; default-src 'self'; img-src 'self' data:; base-uri 'self'; form-action 'none'"
HEADERS = {
    "Content-Security-Policy": POLICY,
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}
log = logging.getLogger(__name__)


def parse_address(text: str, option: str) -> tuple[str, int]:
    """`[HOST]:PORT` or PORT as (host, port); host defaults to 127.0.0.1. Raises UserError with the option's name."""
    host, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdigit() and len(port) <= 5 and int(port) <= 65535):
        raise UserError(f"{option} {text!r}: not a port from 0 to 65535", f"for example: {option} :9108")
    return host.removeprefix("[").removesuffix("]") or "127.0.0.1", int(port)


def url_of(host: str, port: int) -> str:
    """The address of a server, for a browser; a server on all interfaces is named by the outgoing one, for phones."""
    if host in ("0.0.0.0", "::"):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.connect(("192.0.2.1", 9))  # a documentation address; connecting a datagram socket sends nothing
                host = probe.getsockname()[0]
            except OSError:  # no network
                host = socket.gethostname()
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def named(host_header: str, bound: str) -> bool:
    """Whether a Host header names a server bound to `bound` by an IP address, as localhost, or by its own name.

    Any other name may be an attacker's, pointed at this machine so that the attacker's page can read answers (DNS rebinding).
    """
    name, _, port = host_header.lower().rpartition(":")
    name = name if port.isdigit() else host_header.lower()
    if name in ("localhost", bound.lower(), socket.gethostname().lower()):
        return True
    try:
        ipaddress.ip_address(name.removeprefix("[").removesuffix("]"))
    except ValueError:
        return False
    return True


class Server(HTTPServer):
    """Tornado's server with limits. Must be created inside a running event loop."""

    def initialize(self, app: Application) -> None:  # type: ignore[override]
        """Tornado's replacement for __init__."""
        self._strangers: dict[Any, None] = {}  # streams in order of arrival
        self._admitted: set[Any] = set()
        app.settings.update(admit=self.admit, log_function=lambda handler: None)
        super().initialize(app, idle_connection_timeout=READ_TIMEOUT_S, body_timeout=READ_TIMEOUT_S,
                           max_header_size=MAX_HEADER_BYTES, max_body_size=MAX_BODY_BYTES)  # fmt: skip

    def admit(self, stream: Any) -> None:
        """The connection is no longer a stranger's."""
        self._strangers.pop(stream, None)
        self._admitted.add(stream)

    def start_request(self, server_conn: Any, request_conn: HTTPConnection) -> HTTPMessageDelegate:
        """Called by Tornado when a connection starts to wait for a request."""
        if server_conn.stream not in self._admitted:
            self._strangers.setdefault(server_conn.stream)
            if len(self._strangers) > MAX_STRANGERS:
                oldest = next(iter(self._strangers))
                del self._strangers[oldest]
                oldest.close()
        return super().start_request(server_conn, request_conn)

    def on_close(self, server_conn: Any) -> None:
        """Called by Tornado when a connection has ended."""
        self._strangers.pop(server_conn.stream, None)
        self._admitted.discard(server_conn.stream)
        super().on_close(server_conn)


class Handler(RequestHandler):
    """One request. Every answer carries HEADERS; errors are JSON; nothing sent by a client reaches a log."""

    def set_default_headers(self) -> None:
        """Called by Tornado for every answer, errors included."""
        self.clear_header("Server")
        for name, value in HEADERS.items():
            self.set_header(name, value)

    def compute_etag(self) -> None:
        """Returns None: nothing is cached."""

    def write_error(self, status_code: int, **kwargs: Any) -> None:
        """{"ok": false, "error": why}."""
        error = kwargs.get("exc_info", (None, None, None))[1]
        why = error.log_message if isinstance(error, HTTPError) else None
        self.finish({"ok": False, "error": why or HTTPStatus(status_code).phrase.lower()})

    def log_exception(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        """Logs defects of this program, without the query of the address, which may contain the token."""
        if not isinstance(error, HTTPError | StreamClosedError):
            log.error("%s %s", self.request.method, self.request.path, exc_info=error)

    async def answer(self, body: bytes | dict[str, Any], kind: str = "") -> None:
        """Sends a whole answer, a map as JSON."""
        if kind:
            self.set_header("Content-Type", kind)
        await self._sent(self.finish(body))

    async def piece(self, data: bytes) -> bool:
        """Sends a piece of a stream. False if the client no longer reads it."""
        self.write(data)
        return await self._sent(self.flush())

    async def _sent(self, sent: Awaitable[None]) -> bool:
        """Closes the connection of a client that does not read."""
        try:
            async with asyncio.timeout(WRITE_TIMEOUT_S):
                await sent
        except (TimeoutError, StreamClosedError):
            self.stream().close()
            return False
        return True

    def stream(self) -> Any:
        """The connection."""
        return self.request.connection.stream  # type: ignore[union-attr]


def listen(host: str, port: int, option: str) -> list[socket.socket]:
    """Bound sockets, one for each address of host. Raises UserError with the option's name."""
    try:
        bound = bind_sockets(port, host)
    except OSError as error:
        why = f"{option} {host}:{port}: {error.strerror or error}"
        raise UserError(why, "use another port, or 0 for a free one") from None
    for sock in bound:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
    return bound


def run(app: Application, bound: list[socket.socket], end: Callable[[], Awaitable[None]]) -> None:
    """Serves app until Ctrl-C; `end` is awaited before the connections are closed."""

    async def serve() -> None:
        server = Server(app)
        server.add_sockets(bound)
        try:
            await asyncio.Event().wait()
        finally:
            server.stop()
            await end()
            await server.close_all_connections()

    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(serve())
