"""Access: requests without the token, with a wrong one, from other pages and under other names."""

import itertools
import json

import attrs
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.extras.web.page_feed import Feed
from lfpipe.extras.web.server import Site, named, parse_address, url_of
from tests.extras.web.server import Server
from tests.support.refusal import refusal
from tests.support.world import World

PATHS = ["/", "/page.js", "/index.html", "/events", "/ctl", "/nothing", "//", "/x/ctl"]
HARDENED = {
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Server": None,
    "Access-Control-Allow-Origin": None,
}
COMMAND = {"cmd": "pause"}


@pytest.mark.parametrize("method", ["GET", "POST"])
def test_page_serves_nothing_without_the_token(live_server: Server, method: str) -> None:
    wrong = live_server.token[:-1] + ("A" if live_server.token[-1] != "A" else "B")
    name = f"lfpipe-{live_server.port}"
    attempts: list[tuple[str, dict[str, str]]] = [
        ("", {}),
        (f"?token={wrong}", {}),
        ("?token=", {}),
        ("?token=%ff", {}),
        ("", {"Authorization": f"Bearer {wrong}"}),
        ("", {"Authorization": live_server.token}),
        ("", {"Authorization": "Bearer "}),
        ("", {"Cookie": f"{name}={wrong}"}),
        ("", {"Cookie": f"lfpipe-1={live_server.token}"}),
        ("", {"Cookie": f"{name}="}),
        ("", {"Cookie": f'{name}="'}),
    ]
    for path, (query, headers) in itertools.product(PATHS, attempts):
        answer, data = live_server.answer(
            method, path + query, COMMAND if method == "POST" else None, **headers
        )
        assert answer.status in (403, 400 if "%ff" in query else 403), (query, headers)
        assert {
            key: answer.getheader(key) for key in HARDENED
        } == HARDENED and "Set-Cookie" not in answer.headers
        assert "frame-ancestors 'none'" in answer.headers["Content-Security-Policy"]
        assert "%ff" in query or "/?token=" in json.loads(data)["error"]


def test_token_moves_into_a_cookie(live_server: Server) -> None:
    answer, page = live_server.answer("GET", f"/?token={live_server.token}")
    assert answer.status == 200 and live_server.token.encode() not in page
    cookie, *attributes = answer.headers["Set-Cookie"].split("; ")
    assert cookie == f"lfpipe-{live_server.port}={live_server.token}"
    path = next(one for one in attributes if one.startswith("Path=")).removeprefix("Path=")
    assert {"HttpOnly", "SameSite=Strict"} < set(attributes) and len(path) > 20, (
        "no other server of this host is sent it"
    )
    for name in ("", "page.js", "page.css", "uPlot.iife.min.js"):
        answer, _ = live_server.answer("GET", path + name, Cookie=cookie)
        assert answer.status == 200 and {key: answer.getheader(key) for key in HARDENED} == HARDENED
    assert live_server.ask("GET", "/nothing")[0] == live_server.ask("GET", "/../web.py")[0] == 404
    assert live_server.ask("PUT", "/ctl", COMMAND)[0] == live_server.ask("GET", "/ctl")[0] == 405


def test_watch_token_shows_no_camera_and_takes_no_commands(live_server: Server) -> None:
    token = live_server.watch_token
    answer, page = live_server.answer("GET", f"/?token={token}")
    assert answer.status == 200 and b'<body class="watch">' in page
    assert answer.headers["Set-Cookie"].startswith(f"lfpipe-{live_server.port}={token};")
    watching = {"Authorization": f"Bearer {token}"}
    assert live_server.answer("POST", "/ctl", COMMAND, **watching)[0].status == 403
    names = ["", "picture"]
    assert {name for name, _ in itertools.islice(live_server.events(), 30)} == {*names, "camera"}
    watcher = attrs.evolve(live_server, token=token)
    assert sorted({name for name, _ in itertools.islice(watcher.events(), 30)}) == names


def test_page_refuses_names_and_origins_of_others(live_server: Server) -> None:
    port = live_server.port
    for host in (
        "example.org",
        f"example.org:{port}",
        "127.0.0.1.example.org",
        "",
        f"x@127.0.0.1:{port}",
    ):
        assert live_server.ask("GET", "/", Host=host)[0] in (400, 403), host
    assert live_server.ask("GET", "/", Host="localhost:9")[0] == 200, "another port of a tunnel"
    for origin in (
        "http://example.org",
        "http://127.0.0.1:1",
        f"https://127.0.0.1:{port}",
        f"http://localhost:{port}",
        "null",
    ):
        assert live_server.ask("POST", "/ctl", COMMAND, Origin=origin)[0] == 403, origin
        assert live_server.ask("GET", "/events", Origin=origin)[0] == 403, origin
    assert (
        live_server.ask("POST", "/ctl", {"cmd": "resume"}, Origin=f"http://127.0.0.1:{port}")[0]
        == 200
    )


def test_page_passes_on_its_own_commands_alone(server: Server, world: World) -> None:
    bodies: list[object] = [
        {"cmd": "stop"},
        {"cmd": "load", "scene": "/"},
        [],
        "x",
        {"cmd": ["set"]},
        {"cmd": None},
        {},
    ]
    for body in bodies:
        assert server.ask("POST", "/ctl", body)[0] == 400
    assert server.ask("POST", "/ctl", {"cmd": "set", "x": "y" * 5000})[0] == 413
    assert server.ask("POST", "/ctl", COMMAND, **{"Content-Type": "text/plain"})[0] == 400
    answer = json.loads(server.ask("POST", "/ctl", COMMAND)[1])
    assert answer["ok"] is False and "no session" in answer["error"]
    assert json.loads(next(server.events())[1]) == {"alive": False}
    assert "another port" in world.refused("monitor", "--web", f":{server.port}")


@given(st.lists(st.text()))
def test_opened_by_takes_the_tokens_alone(texts: list[str]) -> None:
    site = Site(host="127.0.0.1", port=1, feed=Feed("x"))
    assert not site.opened_by(texts) and len(site.token) >= 43
    for token in (site.watch_token, site.token):
        texts = [*texts, token]
        assert site.opened_by(texts) == token


@given(
    st.from_regex(r"[a-z]([a-z0-9-]*[a-z0-9])?(\.[a-z]([a-z0-9-]*[a-z0-9])?)+", fullmatch=True),
    st.integers(0, 65535),
)
def test_named_knows_its_own_names(name: str, port: int) -> None:
    assert not named(name, "127.0.0.1") and not named(f"{name}:{port}", "127.0.0.1")
    assert named(f"{name}:{port}", name), "the name that was asked for"
    for own in ("127.0.0.1", "localhost", "LOCALHOST", "10.1.2.3", "[::1]"):
        assert named(own, "127.0.0.1") and named(f"{own}:{port}", "127.0.0.1")


def test_parse_address() -> None:
    assert parse_address(":1") == parse_address("1") == ("127.0.0.1", 1)
    assert parse_address("[::1]:2") == ("::1", 2) and url_of("::1", 2) == "http://[::1]:2"
    assert url_of("lab", 3) == "http://lab:3" and "0.0.0.0" not in url_of("0.0.0.0", 5)
    for text in ("", "x", ":x", ":70000", "host:", ":-1", ":٣", ":" + 9 * "0"):
        refusal(parse_address, text)
