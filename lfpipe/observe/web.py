"""The page of `lfpipe monitor --web`: charts, pictures and controls, for holders of the token.

Its requests need the token and must come from its own page: any local user reaches 127.0.0.1.
"""

import hmac
import secrets
from collections.abc import Callable, Iterable
from contextlib import aclosing
from http import HTTPStatus
from pathlib import Path
from typing import Any

import attrs
import cv2
from tornado.web import Application, HTTPError

from lfpipe.errors import UserError
from lfpipe.files.untrusted import json_fields
from lfpipe.observe.page_feed import Feed
from lfpipe.observe.server import Handler, listen, named, parse_address, run, url_of

STATIC = Path(__file__).parent / "static"
KINDS = {".html": "text/html; charset=utf-8", ".js": "text/javascript; charset=utf-8", ".css": "text/css; charset=utf-8"}
COMMANDS = ("set", "pause", "resume", "recentre", "load", "reset")
COMMAND_FORM = f"a JSON map with cmd, one of {', '.join(COMMANDS)}"
MAX_COMMAND_BYTES = 4096
MAX_STREAMS = 32
NO_TOKEN = "the token is missing or wrong: open the address that `lfpipe monitor --web` printed; it ends in /?token=..."
NOT_OURS = "requests must be for this server's own address and come from its own page"


@attrs.frozen
class Site:
    """What all handlers share. host, port: where the server is bound. token: 256 random bits.

    path: of the cookie that keeps the token. Browsers send a cookie to every port of a host, so also to servers of other users on
    this machine; the path is random, and no other server has an address below it.
    """

    host: str
    port: int
    feed: Feed
    token: str = attrs.field(factory=lambda: secrets.token_urlsafe(32))
    path: str = attrs.field(factory=lambda: f"/{secrets.token_urlsafe(16)}/")

    @property
    def cookie(self) -> str:
        """Name of the cookie: two servers on one host each have their own."""
        return f"lfpipe-{self.port}"

    def opens(self, offered: Iterable[str]) -> bool:
        """Whether one of the texts is the token. The comparison takes constant time."""
        return any([hmac.compare_digest(text.encode(errors="replace"), self.token.encode()) for text in offered])


class Guarded(Handler):
    """A request to the site. The token is in the cookie, in `Authorization: Bearer TOKEN` or in `?token=TOKEN`."""

    @property
    def site(self) -> Site:
        """The site."""
        site: Site = self.settings["site"]
        return site

    def prepare(self) -> None:
        """Admits the request or raises HTTPError."""
        headers, host = self.request.headers, self.request.headers.get("Host", "")
        if not named(host, self.site.host) or headers.get("Origin", f"http://{host}") != f"http://{host}":
            raise HTTPError(HTTPStatus.FORBIDDEN, NOT_OURS)
        scheme, _, bearer = headers.get("Authorization", "").partition(" ")
        offered = [self.get_cookie(self.site.cookie) or "", *self.get_query_arguments("token")]
        if not self.site.opens([*offered, bearer if scheme.lower() == "bearer" else ""]):
            raise HTTPError(HTTPStatus.FORBIDDEN, NO_TOKEN)
        self.settings["admit"](self.stream())


class Unknown(Guarded):
    """An unknown address: 403 without the token, else 404."""

    def prepare(self) -> None:
        super().prepare()
        raise HTTPError(HTTPStatus.NOT_FOUND, "no such page")


class File(Guarded):
    """A file of the page, from memory; without a name the page itself."""

    async def get(self, name: str = "index.html") -> None:
        """Sends it. If the address contains the token, also sets the cookie; the page then hides the token.

        This is not a redirect: browsers do not send a SameSite=Strict cookie on a redirect that began at a link elsewhere.
        """
        if name not in self.settings["files"]:
            raise HTTPError(HTTPStatus.NOT_FOUND, "no such page")
        if self.get_query_arguments("token"):
            self.set_cookie(self.site.cookie, self.site.token, path=self.site.path, httponly=True, samesite="Strict")
        await self.answer(*self.settings["files"][name])


class Events(Guarded):
    """Figures and pictures as server-sent events."""

    async def get(self) -> None:
        """Sends the newest until the viewer leaves or reads too slowly."""
        if self.site.feed.viewers >= MAX_STREAMS:
            raise HTTPError(HTTPStatus.SERVICE_UNAVAILABLE, f"the limit of {MAX_STREAMS} viewers is reached")
        self.set_header("Content-Type", "text/event-stream")
        async with aclosing(self.site.feed.events()) as events:
            async for event in events:
                if not await self.piece(event):
                    return


class Commands(Guarded):
    """Commands to the session, as JSON: a map with `cmd`, one of COMMANDS."""

    async def post(self) -> None:
        """Passes a command on and sends the session's answer."""
        if len(self.request.body) > MAX_COMMAND_BYTES:
            raise HTTPError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"at most {MAX_COMMAND_BYTES} bytes")
        try:
            await self.answer(await self._done())
        except UserError as error:
            self.set_status(HTTPStatus.BAD_REQUEST)
            await self.answer({"ok": False, "error": error.message, "remedy": error.remedy})

    async def _done(self) -> dict[str, Any]:
        if self.request.headers.get("Content-Type", "").partition(";")[0].strip() != "application/json":
            raise UserError("the command was not sent as application/json", COMMAND_FORM)
        message = dict(json_fields(self.request.body, "the command", COMMAND_FORM).values)
        if message.get("cmd") not in COMMANDS:
            raise UserError("not a command of the page", COMMAND_FORM)
        if message["cmd"] == "load" and set(message) != {"cmd", "at"}:
            raise UserError("the page loads only scenes of the playlist", "`lfpipe ctl load SCENE` loads any other")
        return await self.site.feed.command(message)


def application(site: Site) -> Application:
    """All addresses of the page, at the root and below the path of the cookie."""
    root = f"(?:{site.path}|/)"
    routes = [("", File), ("events", Events), ("ctl", Commands), (r"([\w.]+)", File)]
    files = {path.name: (path.read_bytes(), KINDS[path.suffix]) for path in STATIC.iterdir() if path.suffix in KINDS}
    page, kind = files["index.html"]
    files["index.html"] = page.replace(b'<base href="/">', f'<base href="{site.path}">'.encode()), kind
    handlers = [(root + path, handler) for path, handler in routes]
    return Application(handlers, default_handler_class=Unknown, site=site, files=files)


def serve(name: str, address: str, tell: Callable[[str], None]) -> None:
    """Serves the page of session `name` on `[HOST]:PORT` until Ctrl-C. Raises UserError if the port is in use."""
    host, port = parse_address(address, "--web")
    sockets = listen(host, port, "--web")
    site = Site(host, int(sockets[0].getsockname()[1]), Feed(name))
    cv2.setNumThreads(1)  # the session's stages need the cores
    tell(f"session {name!r} on {url_of(site.host, site.port)}/?token={site.token} (Ctrl-C ends)")
    run(application(site), sockets, site.feed.end)
