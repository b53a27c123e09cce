"""Hostile HTTP to the page of `lfpipe monitor --web`, with and without its token, beside a live session."""

from __future__ import annotations

import contextlib
import json
import random
import re
import socket
import time
from pathlib import Path
from typing import Any

import attrs

from profiling.attack import mutations
from profiling.attack.book import Book
from profiling.attack.case import Outcome, rng_of
from profiling.attack.live import Dead, Live

BATCH = 100
PATHS = (
    "/", "/events", "/ctl", "/camera.jpg", "/picture.jpg", "/page.js", "/page.css", "/index.html", "/uPlot.LICENSE",
    "/../web.py", "/..%2f..%2fetc/passwd", "//", "/%00", "/%ff%fe", "/" + "a" * 9000, "*", "http://x/", "/ctl/", "/ctl?",
    "/?token=", "/?token=a&token=b", "/.", "/static/page.js", "/\x7f", "/é", "x",
)  # fmt: skip
METHODS = ("GET", "POST", "HEAD", "PUT", "DELETE", "OPTIONS", "TRACE", "CONNECT", "PATCH", "get", "G" * 5000, "", "GET\0", "PRI")
HEADERS = (
    "Content-Length: -1", "Content-Length: 99999999999999999999", "Content-Length: ٣",
    "Content-Length: 3\r\nContent-Length: 4", "Transfer-Encoding: chunked", "Transfer-Encoding: chunked\r\nContent-Length: 5",
    "Expect: 100-continue", "Content-Encoding: gzip", "Host: evil.example", "Host:", "Origin: http://evil.example",
    "Origin: null", "Cookie: " + "a=b; " * 900, "Cookie: \xff\xfe=\x01", "X: " + "y" * 70_000, "X\r\nY: z", " folded: x",
    "Range: bytes=0-1,5-9", "Upgrade: websocket\r\nConnection: Upgrade", "Authorization: Basic !!!", "Authorization: Bearer",
    "Authorization: Bearer " + "x" * 3000, "Connection: keep-alive", "Accept: " + "*/*," * 2000, "If-None-Match: *", "\0: \0",
    "Content-Type: multipart/form-data; boundary=x", "Content-Type: application/x-www-form-urlencoded",
    "Content-Type: text/plain", "Sec-Fetch-Site: cross-site",
)  # fmt: skip
COMMANDS = (
    "set", "pause", "resume", "recentre", "reset", "hello", "status", "load", "stop", "record", "trace", "", None, 5, ["set"],
)  # fmt: skip
OPEN = {"/page.js", "/page.css", "/index.html", "/", "/uPlot.LICENSE"}  # without a token in the program's address all is open


@attrs.frozen
class Server:
    """Where the page is, and what opens it; token "" where there is none."""

    host: str
    port: int
    token: str

    @classmethod
    def of(cls, said: str) -> Server | None:
        """As the program printed it."""
        found = re.search(r"http://([\d.]+|localhost):(\d+)/(?:\S*?token=([\w.~-]+))?", said)
        return cls(found[1], int(found[2]), found[3] or "") if found else None


def _body(rng: random.Random) -> bytes:
    """A body for /ctl."""
    match rng.randrange(5):
        case 0:
            return rng.randbytes(rng.choice((0, 1, 100, 5000)))
        case 1:
            return rng.choice(
                (
                    b"[" * 2000,
                    b'{"cmd":' * 500,
                    b"null",
                    b"5",
                    b'"set"',
                    b"{}",
                    b'{"cmd":"set","cmd":"pause"}',
                    b'{"cmd":"set","set":{"render.alpha_px":1e999}}',
                    b"\xef\xbb\xbf{}",
                    b"9" * 4000,
                )
            )  # fmt: skip
        case 2:
            return mutations.changed_json(rng, b'{"cmd":"set","set":{"render.alpha_px":"x","render":{}}}')[:9000]
        case 3:
            message: dict[str, Any] = {
                "cmd": rng.choice(COMMANDS),
                rng.choice(("set", "lease_s", "path", "scene", "v", "stage")): rng.choice(
                    (*mutations.VALUES[: -len(mutations.WORDS)], "x")
                ),
            }
        case _:
            message = {
                "cmd": "set",
                "set": {
                    rng.choice(("render", "render.alpha_px", "render.x", "", "camera.width_px", "a.b.c")): rng.choice(
                        mutations.VALUES[7 : -len(mutations.WORDS)]
                    )
                },
            }
    return json.dumps(message, default=str).encode("utf-8", "surrogatepass")


def request(rng: random.Random, server: Server) -> tuple[str, bytes, bool]:
    """(kind, bytes of a request, whether it shows the token)."""
    known = bool(server.token) and rng.random() < 0.6
    address = f"{server.host}:{server.port}"
    way = rng.choice(("path", "method", "header", "body", "body", "body", "bytes", "cut short"))
    method, path, body = "GET", rng.choice(PATHS), b""
    heads = [f"Host: {address}"]
    if way == "method":
        method = rng.choice(METHODS)
    elif way == "body":
        method, path, body = "POST", "/ctl" if rng.random() < 0.9 else path, _body(rng)
        heads += ["Content-Type: application/json", f"Content-Length: {len(body)}"]
    elif way == "header":
        method = rng.choice(("GET", "POST"))
        heads += [rng.choice(HEADERS) for _ in range(rng.choice((1, 1, 3)))]
        heads += [f"X-{n}: y" for n in range(rng.choice((0, 0, 0, 3000)))]
        body = rng.choice((b"", b"5\r\nhello\r\n0\r\n\r\n", b"ffffffffffffffff\r\n", b"{}"))
    if known:
        where = rng.randrange(3)
        if where == 0:
            path += ("&" if "?" in path else "?") + f"token={server.token}"
        else:
            heads.append(
                f"Authorization: Bearer {server.token}" if where == 1 else f"Cookie: lfpipe-{server.port}={server.token}"
            )
    elif server.token and rng.random() < 0.5:
        wrong = rng.choice((server.token[:-1], server.token + "x", server.token.upper(), "", "é", "x" * 5000))
        heads.append(f"Authorization: Bearer {wrong}" if rng.random() < 0.5 else f"Cookie: lfpipe-{server.port}={wrong}")
    version = "HTTP/1.1" if rng.random() < 0.9 else rng.choice(("HTTP/1.0", "HTTP/9.9", "HTTP/1.1.1", "", "FTP/1.1"))
    data = (
        "\r\n".join([f"{method} {path} {version}", *heads, "Connection: close", "", ""]).encode("utf-8", "surrogatepass") + body
    )
    if way == "bytes":
        data = mutations.changed_bytes(rng, data)
        known = bool(server.token)  # the token in it may be whole
    elif way == "cut short":
        data = data[: rng.randrange(len(data))]
    return way, data, known


def exchange(server: Server, data: bytes, limit_s: float, ends: bool = True) -> bytes | None:
    """What the server answers, up to 64 KiB of it; None where it says nothing for limit_s. ends: data is the last of ours."""
    answer = b""
    with socket.create_connection((server.host, server.port), timeout=limit_s) as made:
        with contextlib.suppress(OSError):  # it may have said no, and gone, before it heard all
            made.sendall(data)
            if ends:
                made.shutdown(socket.SHUT_WR)
        try:
            while len(answer) < 65_536 and (part := made.recv(65_536)):
                answer += part
                made.settimeout(0.2)  # a stream goes on for ever
        except TimeoutError:
            return answer or None
        except ConnectionError:
            return answer
    return answer


class Campaign:
    """Requests, and looks in between."""

    def __init__(self, book: Book, work: Path) -> None:
        self.book, self.work = book, work
        self.live = Live(work)
        self.log = work / "page.log"
        self.start()

    def start(self) -> None:
        """Starts the page's server."""
        with self.log.open("w") as log:
            self.process = self.live.world.start(
                "monitor", "--web", *self._address(), "--session", self.live.world.name, stdout=log, stderr=log
            )
        found = self.live.world.wait_for(lambda: Server.of(self.log.read_text()) or self.process.poll() is not None, "page", 60)
        assert isinstance(found, Server), self.log.read_text()
        self.server = found

    def _address(self) -> list[str]:
        """A free port, in the way that this program takes it."""
        said = self.live.world.run("monitor", "--help").stdout
        return ["--port", "0"] if "--port" in said else ["127.0.0.1:0"] if "--web [" in said else []

    def fail(self, kind: str, outcome: str, group: str, detail: str, data: bytes, number: int) -> None:
        found, repeat = Outcome(f"page: {kind}", outcome, group, detail), ""
        if self.book.wants(found):
            target = self.book.failures / f"page-{number}"
            target.mkdir(parents=True, exist_ok=True)
            (target / "request.bin").write_bytes(data)
            (target / "REPEAT.txt").write_text(
                f"{outcome}: {group}\n{detail}\n\nnc HOST PORT < request.bin (token then: {self.server.token})\n"
            )
            repeat = str(target)
        self.book.add("page", found, number, repeat)

    def one(self, number: int) -> None:
        """One request and its answer."""
        kind, data, known = request(rng_of(self.book.seed, "page", number), self.server)
        try:
            whole = kind in ("path", "method", "body")  # who hangs up early is not answered
            answer = exchange(self.server, data, 10.0, ends=not whole)
        except OSError as error:
            self.fail(kind, "ended", f"no connection: {error}", self.log.read_text()[-2000:], data, number)
            self.process.kill()
            self.start()
            return
        status = int(found[1]) if answer and (found := re.match(rb"HTTP/1\.[01] (\d{3})", answer)) else 0
        if answer is None and kind not in ("bytes", "cut short", "header"):
            self.fail(kind, "hang", "no answer for 10 s", "", data, number)
        elif status >= 500 and status not in (501, 503, 505):
            self.fail(
                kind,
                "traceback",
                f"status {status}",
                (answer or b"")[:1000].decode("latin-1") + self.log.read_text()[-2000:],
                data,
                number,
            )
        elif status == 200 and self.server.token and not known:
            self.fail(kind, "half-applied", "served without the token", data[:300].decode("latin-1"), data, number)
        else:
            self.book.add("page", Outcome(f"page: {kind}", "accepted" if 100 <= status < 300 else "refused"))

    def look(self, number: int) -> None:
        """Whether server, session and configuration are what they were."""
        token = f"?token={self.server.token}" if self.server.token else ""
        hello = f"GET /{token} HTTP/1.1\r\nHost: {self.server.host}:{self.server.port}\r\nConnection: close\r\n\r\n".encode()
        answer = exchange(self.server, hello, 10.0, ends=False) or b""
        if not answer.startswith(b"HTTP/1.1 200"):
            self.fail("look", "hang", "the page is not served any more", answer[:500].decode("latin-1"), hello, number)
        said = self.log.read_text()
        if "Traceback" in said:
            self.fail("look", "traceback", said.strip().splitlines()[-1][:100], said[-3000:], b"", number)
            self.log.write_text("")
        told = self.live.hello()
        for tree in (told["config"], self.live.told["config"]):
            tree["render"]["alpha_px"] = 0  # requests may set it
        if told["config"] != self.live.told["config"] or told["options"] != self.live.told["options"]:
            self.fail("look", "half-applied", "the page changed the session", f"{self.live.told} {told}", b"", number)
            self.live.told = told

    def half_open(self, count: int) -> None:
        """Connections that begin and do not go on."""
        held = []
        for number in range(count):
            made = socket.create_connection((self.server.host, self.server.port), timeout=5)
            made.sendall(
                (b"", b"G", b"GET / HTTP/1.1\r\nHost: ", b"POST /ctl HTTP/1.1\r\nContent-Length: 4000\r\n\r\n{")[number % 4]
            )
            held.append(made)
        self.book.add("page", Outcome("page: half open", "refused"), times=count)
        time.sleep(0.5)
        self.look(count)
        for made in held:
            made.close()


def run(book: Book, count: int, work: Path) -> None:
    """count requests, in order; those that go on for ever in between."""
    campaign = Campaign(book, work)
    try:
        for number in range(count):
            campaign.one(number)
            if number % BATCH == BATCH - 1 or number == count - 1:
                campaign.look(number)
        campaign.half_open(100)
    except Dead as error:
        campaign.fail("session", "ended", "the session ended", str(error), b"", -1)
    finally:
        campaign.process.kill()
        campaign.live.end()
