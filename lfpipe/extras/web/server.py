"""The page of `lfpipe monitor --web`: charts, pictures and controls for holders of the token.
Holders of the other token have view-only access, without the camera's picture.

Its requests need a token and must come from its own page: any local user reaches 127.0.0.1.
Tornado serves them in one thread, with limits on time, sizes and connections, so that clients
cannot exhaust it.
"""

import asyncio
import contextlib
import hmac
import io
import ipaddress
import logging
import secrets
import socket
import sys
from collections import Counter
from collections.abc import Awaitable, Callable, Iterable
from contextlib import aclosing
from functools import partial
from http import HTTPStatus
from pathlib import Path
from typing import Any, cast

import attrs
import cv2
import segno
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPConnection, HTTPMessageDelegate
from tornado.ioloop import IOLoop
from tornado.iostream import StreamClosedError
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler

from lfpipe.errors import UserError
from lfpipe.extras.web.page_feed import Feed
from lfpipe.files.safe_files import json_fields
from lfpipe.host.files import allow_files, free_files
from lfpipe.transport.control import Message

STATIC = Path(__file__).parent / "static"
KINDS = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
}
COMMANDS = ("set", "pause", "resume", "recentre", "look", "action", "load", "reset")
PORTS = range(8765, 8785)  # where a browser finds the page again; one for each of some sessions
COMMAND_FORM = f"send a JSON map with cmd, one of {', '.join(COMMANDS)}"
# Limits: far above the needs of a classroom of browsers, far below a load that disturbs a session.
# for the headers of a request, for its body, between two requests, and to receive an answer or a
# part of a stream
TIMEOUT_S = 10.0
MAX_COMMAND_BYTES = 4 << 10
MAX_STREAMS, MAX_WATCHERS = 32, 30  # two streams are reserved for a teacher
# connections that are not admitted: a class opens the page with six each. One more closes the
# oldest one of the address that has most
MAX_STRANGERS = 192
ACCEPTS = 8  # at a time: each is answered before more are accepted
WAITING = 4096  # connections to accept, Linux's limit: those above it wait for a second or more
BACK_OFF_S = 0.1  # until the next try where no descriptor is free
END_S = 1.0  # for answers that are being sent at the end
NO_TOKEN = (
    "the token is missing or wrong: open the address that `lfpipe monitor --web` printed; it ends"
    " in /?token=..."
)
NOT_OURS = "requests must be for this server's own address and come from its own page"
POLICY = (
    "frame-ancestors 'none'; default-src 'self'; img-src 'self' data:; base-uri 'self'; form-action"
    " 'none'"
)
FOR_OTHERS = "for other devices, with a QR code: lfpipe monitor --web 0.0.0.0:8765"
WATCH_BODY = b"<body>", b'<body class="watch">'
HEADERS = {
    "Content-Security-Policy": POLICY,
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}
OWN_NAME = socket.gethostname().lower()
log = logging.getLogger(__name__)


def parse_address(text: str) -> tuple[str, int]:
    """`[HOST]:PORT` or PORT as (host, port); host defaults to 127.0.0.1. Raises UserError."""
    host, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdigit() and len(port) <= 5 and int(port) <= 65535):
        raise UserError(
            f"--web {text!r}: not a port from 0 to 65535", "use for example --web :9108"
        )
    return host.removeprefix("[").removesuffix("]") or "127.0.0.1", int(port)


def url_of(host: str, port: int) -> str:
    """The address of a server, for a browser; a server on all interfaces is named by the outgoing
    one, for phones.
    """
    if host in ("0.0.0.0", "::"):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                # a documentation address; connecting a datagram socket sends nothing
                probe.connect(("192.0.2.1", 9))
                host = probe.getsockname()[0]
            except OSError:  # no network
                host = socket.gethostname()
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def local(host: str) -> bool:
    """Whether an address reaches this machine alone."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def drawn(code: segno.QRCode) -> list[str]:
    """A QR code in half blocks, the lines of a terminal."""
    text = io.StringIO()
    code.terminal(text, border=2, compact=True)
    return text.getvalue().splitlines()


def named(host_header: str, bound: str) -> bool:
    """Whether a Host header names a server bound to `bound` by an IP address, as localhost, or by
    its own name.

    Any other name may be an attacker's, pointed at this machine so that the attacker's page can
    read answers (DNS rebinding).
    """
    name, _, port = host_header.lower().rpartition(":")
    name = name if port.isdigit() else host_header.lower()
    if name in ("localhost", bound.lower(), OWN_NAME):
        return True
    try:
        ipaddress.ip_address(name.removeprefix("[").removesuffix("]"))
    except ValueError:
        return False
    return True


@attrs.frozen(kw_only=True)
class Site:
    """The common data of all handlers."""

    host: str
    """Address that the server is bound to."""
    port: int
    feed: Feed
    token: str = attrs.field(factory=lambda: secrets.token_urlsafe(32))
    """256 random bits."""
    watch_token: str = attrs.field(factory=lambda: secrets.token_urlsafe(32))
    """256 random bits, for view-only access."""
    path: str = attrs.field(factory=lambda: f"/{secrets.token_urlsafe(16)}/")
    """Path of the cookie that stores the token. Browsers send a cookie to every port of a host, so
    also to servers of other users on this machine; the path is random, and no other server has an
    address below it."""

    @property
    def cookie(self) -> str:
        """Name of the cookie, different for each server on one host."""
        return f"lfpipe-{self.port}"

    def opened_by(self, offered: Iterable[str]) -> str:
        """The token among the texts, the one with more rights first; empty if there is none. The
        comparison takes constant time.
        """
        texts = [text.encode(errors="replace") for text in offered]
        for token in (self.token, self.watch_token):
            if any([hmac.compare_digest(text, token.encode()) for text in texts]):
                return token
        return ""


class Server(HTTPServer):
    """Tornado's server with limits. Must be created inside a running event loop.

    A connection ends with its answer, so that nobody holds one for nothing, except for streams and
    holders of the token, who are admitted.
    """

    def initialize(self, app: Application) -> None:  # type: ignore[override]
        """Tornado's replacement for __init__."""
        self._strangers: dict[Any, str] = {}  # streams in order of arrival, and their addresses
        self._told = False
        self._most = min(MAX_STRANGERS, free_files() // 2)
        app.settings.update(admit=self.admit, log_function=lambda handler: None)
        super().initialize(
            app,
            no_keep_alive=True,
            idle_connection_timeout=TIMEOUT_S,
            body_timeout=TIMEOUT_S,
            max_header_size=16 << 10,
            max_body_size=64 << 10,
        )

    def add_sockets(self, sockets: Iterable[socket.socket]) -> None:
        """As Tornado's, which would try again at once when no descriptor is free."""
        loop = IOLoop.current()
        for sock in sockets:
            self._sockets[sock.fileno()] = sock
            self._handlers[sock.fileno()] = partial(loop.remove_handler, sock)
            loop.add_handler(sock, self._accept, IOLoop.READ)

    def _accept(self, sock: socket.socket, _events: int) -> None:
        for _ in range(ACCEPTS):
            try:
                connection, address = sock.accept()
            except (BlockingIOError, ConnectionAbortedError):
                return
            except OSError as error:
                if not self._told:
                    log.warning("connections wait for a while: %s", error.strerror)
                self._told = True
                self._close_oldest()
                loop = IOLoop.current()
                loop.update_handler(sock, 0)
                loop.call_later(BACK_OFF_S, self._accept_again, sock)
                return
            self._handle_connection(connection, address)

    def _accept_again(self, sock: socket.socket) -> None:
        if sock.fileno() in self._handlers:  # else the server has stopped
            IOLoop.current().update_handler(sock, IOLoop.READ)

    def _close_oldest(self) -> None:
        """Closes the oldest connection of the address that has most."""
        for busiest, _ in Counter(self._strangers.values()).most_common(1):
            oldest = next(one for one, address in self._strangers.items() if address == busiest)
            self.admit(oldest)
            oldest.close()

    def admit(self, stream: Any) -> None:
        """Takes a connection out of those that may be closed to make room."""
        self._strangers.pop(stream, None)

    def start_request(self, server_conn: Any, request_conn: HTTPConnection) -> HTTPMessageDelegate:
        """Called by Tornado when a connection starts to wait for a request."""
        if server_conn.stream.closed():  # requests sent with its first one; Tornado answers all
            raise asyncio.CancelledError
        self._strangers[server_conn.stream] = str(server_conn.context.remote_ip)
        if len(self._strangers) > self._most:
            self._close_oldest()
        return super().start_request(server_conn, request_conn)

    def on_close(self, server_conn: Any) -> None:
        """Called by Tornado when a connection has ended."""
        self.admit(server_conn.stream)
        super().on_close(server_conn)


class Handler(RequestHandler):
    """One request, with the token in the cookie, in `Authorization: Bearer TOKEN` or in
    `?token=TOKEN`.

    Every answer carries HEADERS; errors are JSON; nothing sent by a client reaches a log.
    """

    def set_default_headers(self) -> None:
        """Called by Tornado for every answer, errors included."""
        self.clear_header("Server")
        for name, value in HEADERS.items():
            self.set_header(name, value)

    @property
    def site(self) -> Site:
        """The site."""
        return cast(Site, self.settings["site"])

    @property
    def stream(self) -> Any:
        """The connection."""
        return self.request.connection.stream  # type: ignore[union-attr]

    def prepare(self) -> None:
        """Admits the request or raises HTTPError."""
        headers = self.request.headers
        host = headers.get("Host", "")
        if (
            not named(host, self.site.host)
            or headers.get("Origin", f"http://{host}") != f"http://{host}"
        ):
            raise HTTPError(HTTPStatus.FORBIDDEN, NOT_OURS)
        scheme, _, bearer = headers.get("Authorization", "").partition(" ")
        offered = [self.get_cookie(self.site.cookie) or "", *self.get_query_arguments("token")]
        offered.append(bearer if scheme.lower() == "bearer" else "")
        self.token = self.site.opened_by(offered)
        if not self.token:
            raise HTTPError(HTTPStatus.FORBIDDEN, NO_TOKEN)
        self.only_watches = self.token == self.site.watch_token
        if not self.only_watches:
            self.settings["admit"](self.stream)

    def write_error(self, status_code: int, **kwargs: Any) -> None:
        """Answers with {"ok": false, "error": reason}."""
        error = kwargs.get("exc_info", (None, None, None))[1]
        why = error.log_message if isinstance(error, HTTPError) else None
        self.finish({"ok": False, "error": why or HTTPStatus(status_code).phrase.lower()})

    def log_exception(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        """Logs defects of this program, without the query of the address, which may contain the
        token.
        """
        if not isinstance(error, HTTPError | StreamClosedError):
            log.error("%s %s", self.request.method, self.request.path, exc_info=error)

    async def sent(self, sending: Awaitable[None]) -> bool:
        """Waits until the client has received the data.

        Closes the connection of a client that does not, and returns False.
        """
        try:
            await asyncio.wait_for(sending, TIMEOUT_S)
        except (TimeoutError, StreamClosedError):
            self.stream.close()
            return False
        return True


class Unknown(Handler):
    """An unknown address: 403 without the token, else 404."""

    def prepare(self) -> None:
        super().prepare()
        raise HTTPError(HTTPStatus.NOT_FOUND, "no such page")


class File(Handler):
    """A file of the page, from memory; without a name, the page itself."""

    async def get(self, name: str = "index.html") -> None:
        """Sends the file. If the address contains the token, also sets the cookie; the page then
        hides the token.

        This is not a redirect: browsers do not send a SameSite=Strict cookie on a redirect that
        started from a link on another site.
        """
        if name not in self.settings["files"]:
            raise HTTPError(HTTPStatus.NOT_FOUND, "no such page")
        if self.get_query_arguments("token"):
            self.set_cookie(
                self.site.cookie,
                self.token,
                path=self.site.path,
                httponly=True,
                samesite="Strict",
            )
        self.set_header("Content-Type", KINDS[Path(name).suffix])
        page = self.settings["files"][name]
        await self.sent(self.finish(page.replace(*WATCH_BODY) if self.only_watches else page))


class Events(Handler):
    """Metrics and pictures as server-sent events."""

    async def get(self) -> None:
        """Sends the newest until the viewer leaves or reads too slowly."""
        limit = MAX_WATCHERS if self.only_watches else MAX_STREAMS
        if self.site.feed.viewers >= limit:
            raise HTTPError(
                HTTPStatus.SERVICE_UNAVAILABLE, f"the limit of {limit} viewers is reached"
            )
        self.settings["admit"](self.stream)
        self.set_header("Content-Type", "text/event-stream")
        async with aclosing(self.site.feed.events(with_camera=not self.only_watches)) as events:
            async for event in events:
                self.write(event)
                if not await self.sent(self.flush()):
                    return


class Commands(Handler):
    """Commands to the session, as JSON: a map with `cmd`, one of COMMANDS."""

    async def post(self) -> None:
        """Passes a command on and sends the session's answer."""
        if self.only_watches:
            raise HTTPError(HTTPStatus.FORBIDDEN, "this address is view-only")
        if len(self.request.body) > MAX_COMMAND_BYTES:
            raise HTTPError(
                HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"at most {MAX_COMMAND_BYTES} bytes"
            )
        try:
            answer = await self.site.feed.command(self._command())
        except UserError as error:
            self.set_status(HTTPStatus.BAD_REQUEST)
            answer = {"ok": False, "error": error.message, "remedy": error.remedy}
        await self.sent(self.finish(answer))

    def _command(self) -> Message:
        if (
            self.request.headers.get("Content-Type", "").partition(";")[0].strip()
            != "application/json"
        ):
            raise UserError("the command was not sent as application/json", COMMAND_FORM)
        message = dict(json_fields(self.request.body, "the command", COMMAND_FORM).values)
        if message.get("cmd") not in COMMANDS:
            raise UserError("the page has no such command", COMMAND_FORM)
        if message["cmd"] == "load" and set(message) != {"cmd", "at"}:
            raise UserError(
                "the page loads only scenes of the playlist",
                "load any other with `lfpipe ctl load SCENE`",
            )
        return message


def _bound(host: str, ports: Iterable[int]) -> list[socket.socket]:
    """Sockets of the first free one of the ports. Raises UserError."""
    for port in ports:
        try:
            return bind_sockets(port, host, backlog=WAITING)
        except OSError as error:
            why = f"--web {host}:{port}: {error.strerror or error}"
    raise UserError(why, "use another port, 0 for a free one, or an address of this machine")


def serve(name: str, address: str, tell: Callable[[str], None]) -> None:
    """Serves the page of session `name` on `[HOST]:PORT` until Ctrl-C; without an address, on the
    next free port of this machine.

    Raises UserError if the port is in use.
    """
    host, port = parse_address(address or f":{PORTS.start}")
    allow_files()
    sockets = _bound(host, (port,) if address else (*PORTS, 0))
    for sock in sockets:
        # small, so that a slow reader of a stream skips to the newest data
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 64 << 10)
    site = Site(host=host, port=int(sockets[0].getsockname()[1]), feed=Feed(name))
    files = {path.name: path.read_bytes() for path in STATIC.iterdir() if path.suffix in KINDS}
    url = url_of(site.host, site.port)
    watch_url = f"{url}/?token={site.watch_token}"
    code = None if local(host) else segno.make(watch_url, error="l", micro=False)
    picture = code.svg_data_uri(scale=4, border=4, light="white") if code else ""
    for mark, text in (('<base href="/">', f'<base href="{site.path}">'), ("@CODE@", picture)):
        files["index.html"] = files["index.html"].replace(mark.encode(), text.encode())
    routes = [("", File), ("events", Events), ("ctl", Commands), (r"([\w.]+)", File)]
    # at the root and below the cookie's path
    handlers = [(f"(?:{site.path}|/){path}", handler) for path, handler in routes]
    app = Application(handlers, default_handler_class=Unknown, site=site, files=files)
    cv2.setNumThreads(1)  # the session's stages need the cores

    async def serving() -> None:
        server = Server(app)
        server.add_sockets(sockets)
        try:
            # not before Ctrl-C ends this coroutine
            tell(f"session {name!r} on {url}/?token={site.token} (Ctrl-C ends)")
            tell(f"view-only, without the camera's picture: {watch_url}")
            if sys.stdout.isatty():
                for line in drawn(code) if code else (FOR_OTHERS,):
                    tell(line)
            await asyncio.Event().wait()
        finally:
            server.stop()
            await site.feed.end()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(server.close_all_connections(), END_S)

    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(serving())
