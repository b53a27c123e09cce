"""The page of `lfpipe monitor --web`: charts, pictures and controls, for holders of the token."""

from collections.abc import Callable
from contextlib import aclosing
from http import HTTPStatus
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

import attrs
import cv2
from tornado.web import Application, HTTPError

from lfpipe.errors import UserError
from lfpipe.files.untrusted import json_fields
from lfpipe.observe.page_feed import PICTURES, Feed
from lfpipe.observe.server import (
    NO_TOKEN,
    NOT_OURS,
    Access,
    Handler,
    Missing,
    listen,
    named,
    parse_address,
    run,
    same_origin,
    url_of,
)

STATIC = Path(__file__).parent / "static"
KINDS = {".html": "text/html; charset=utf-8", ".js": "text/javascript; charset=utf-8", ".css": "text/css; charset=utf-8"}
COMMANDS = ("set", "pause", "resume", "recentre", "load", "reset")
MAX_COMMAND_BYTES = 4096
MAX_STREAMS = 32
REFUSED = (
    "<!doctype html><html lang=en><meta charset=utf-8><title>lfpipe monitor</title><h1>403: token required</h1><p>{}.</p>"
    "<p>The address changes each time the monitor starts. After you open it once, this browser keeps the token in a cookie.</p>"
)


@attrs.frozen
class Site:
    """State shared by all handlers. host, port: where the server is bound. files: name -> (bytes, media type)."""

    host: str
    port: int
    feed: Feed
    access: Access
    files: dict[str, tuple[bytes, str]]

    @property
    def cookie(self) -> str:
        """Name of the cookie: two servers on one host each have their own."""
        return f"lfpipe-{self.port}"


class Guarded(Handler):
    """A request to the site. The token is in the cookie, in `Authorization: Bearer TOKEN` or in `?token=TOKEN`."""

    @property
    def site(self) -> Site:
        """The site."""
        site: Site = self.settings["site"]
        return site

    def refusal(self) -> str:
        """The reason for refusing this request, or ""."""
        headers, host = self.request.headers, self.request.headers.get("Host", "")
        if not named(host, self.site.host) or not same_origin(headers.get("Origin"), host):
            return NOT_OURS
        scheme, _, bearer = headers.get("Authorization", "").partition(" ")
        offered = [self.get_cookie(self.site.cookie) or "", *self.get_query_arguments("token")]
        return "" if self.site.access.opens([*offered, bearer if scheme.lower() == "bearer" else ""]) else NO_TOKEN


class Unknown(Missing, Guarded):
    """An unknown address: 403 without the token, else 404."""


class File(Guarded):
    """A file of the page, from memory."""

    async def get(self, name: str) -> None:
        """Sends it, or 404."""
        if name not in self.site.files:
            raise HTTPError(HTTPStatus.NOT_FOUND, "no such page")
        await self.answer(*self.site.files[name])


class Page(Guarded):
    """The page itself."""

    async def get(self) -> None:
        """Sends the page. If the address contains the token, also sets the cookie; the page then hides the token.

        This is not a redirect: browsers do not send a SameSite=Strict cookie on a redirect that began at a link elsewhere.
        """
        if self.get_query_arguments("token"):
            access = self.site.access
            self.set_cookie(self.site.cookie, access.token, path=access.path, httponly=True, samesite="Strict")
        await self.answer(*self.site.files["index.html"])

    def write_error(self, status_code: int, **kwargs: Any) -> None:
        """Explains to a person how to get access."""
        if status_code != HTTPStatus.FORBIDDEN:
            super().write_error(status_code, **kwargs)
            return
        self.set_header("Content-Type", KINDS[".html"])
        self.write(REFUSED.format(kwargs["exc_info"][1].log_message))


class Picture(Guarded):
    """The newest camera picture, or picture on the screen, as JPEG."""

    async def get(self, which: str) -> None:
        """Sends it, or 503 if there is none yet. which: one of PICTURES."""
        jpeg = await self.site.feed.picture(which)
        if jpeg is None:
            raise HTTPError(HTTPStatus.SERVICE_UNAVAILABLE, "no picture yet")
        await self.answer(jpeg, "image/jpeg")


class Events(Guarded):
    """The figures as server-sent events; with `?pictures` also both pictures."""

    async def get(self) -> None:
        """Sends the newest until the viewer leaves or reads too slowly."""
        if self.site.feed.viewers >= MAX_STREAMS:
            raise HTTPError(HTTPStatus.SERVICE_UNAVAILABLE, f"the limit of {MAX_STREAMS} viewers is reached")
        self.set_header("Content-Type", "text/event-stream")
        pictures = "pictures" in parse_qs(self.request.query, keep_blank_values=True)
        async with aclosing(self.site.feed.events(pictures)) as events:
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
            await self.answer_json(await self._done())
        except UserError as error:
            refused = {"ok": False, "error": error.message, "remedy": error.remedy}
            await self.answer_json(refused, HTTPStatus.BAD_REQUEST)

    async def _done(self) -> dict[str, Any]:
        expected = f"a JSON map with cmd, one of {', '.join(COMMANDS)}"
        if self.request.headers.get("Content-Type", "").partition(";")[0].strip() != "application/json":
            raise UserError("the command was not sent as application/json", expected)
        message = dict(json_fields(self.request.body, "the command", expected).values)
        if message.get("cmd") not in COMMANDS:
            raise UserError("not a command of the page", expected)
        if message["cmd"] == "load" and set(message) != {"cmd", "at"}:
            raise UserError("the page loads only scenes of the playlist", "`lfpipe ctl load SCENE` loads any other")
        if message["cmd"] == "reset":
            self.site.feed.reset()
            return {"ok": True}
        return await self.site.feed.command(message)


def application(site: Site) -> Application:
    """All addresses of the page, at the root and below the path of the cookie."""
    root = f"(?:{site.access.path}|/)"
    routes = [("", Page), ("events", Events), ("ctl", Commands), (rf"({'|'.join(PICTURES)})\.jpg", Picture), (r"([\w.]+)", File)]
    return Application([(root + path, handler) for path, handler in routes], default_handler_class=Unknown, site=site)


def _files(base: str) -> dict[str, tuple[bytes, str]]:
    found = {path.name: (path.read_bytes(), KINDS[path.suffix]) for path in STATIC.iterdir() if path.suffix in KINDS}
    page, kind = found["index.html"]
    return {**found, "index.html": (page.replace(b'<base href="/">', f'<base href="{base}">'.encode()), kind)}


def serve(name: str, address: str, tell: Callable[[str], None]) -> None:
    """Serves the page of session `name` on `[HOST]:PORT` until Ctrl-C. Raises UserError if the port is in use."""
    host, port = parse_address(address, "--web")
    sockets, access = listen(host, port, "--web"), Access()
    site = Site(host, int(sockets[0].getsockname()[1]), Feed(name), access, _files(access.path))
    cv2.setNumThreads(1)  # the session's stages need the cores
    tell(f"session {name!r} on {url_of(site.host, site.port)}/?token={access.token} (Ctrl-C ends)")
    run(application(site), sockets, site.feed.end)
