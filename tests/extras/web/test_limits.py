"""Limits on clients: partial, large and many requests, unread answers, and commands of any
bytes.
"""

import json
import resource
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any

import psutil
import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from lfpipe.extras.web.server import MAX_STREAMS
from tests.extras.web.server import Server, served
from tests.supervisor.states import messages, values
from tests.support.examples import examples
from tests.support.world import World, until

LARGE = 10_000_000
OWN_THREADS = 4  # that the page starts with its first sample and command, not with a request


def test_page_refuses_large_requests(live_server: Server) -> None:
    threads = live_server.threads()
    for head in (f"Content-Length: {LARGE}", "Transfer-Encoding: chunked", f"X: {'y' * LARGE}"):
        start = (
            "POST /ctl HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer"
            f" {live_server.token}\r\n{head}\r\n\r\n".encode()
        )
        piece = b"8000\r\n" + 0x8000 * b" " + b"\r\n" if "chunked" in head else 0x8000 * b" "
        answer = b""
        with socket.create_connection(("127.0.0.1", live_server.port), timeout=60) as connection:
            try:
                connection.sendall(start)
                for _ in range(LARGE // len(piece)):
                    connection.sendall(piece)
                while got := connection.recv(65536):
                    answer += got
            except (BrokenPipeError, ConnectionResetError):
                pass  # closed while it was sent
            else:
                assert answer.startswith(b"HTTP/1.1 4"), answer[:100]
    assert live_server.ask("POST", "/ctl", b" " * 60_000)[0] == 413
    assert live_server.ask("GET", "/page.js")[0] == 200
    assert live_server.threads() <= threads + OWN_THREADS


def test_page_limits_its_viewers(live_server: Server) -> None:
    live_server.jpeg("picture")
    threads = live_server.threads()
    viewers = [live_server.viewer() for _ in range(2 * MAX_STREAMS)]
    statuses = [answer.status for _, answer in viewers]
    assert statuses.count(200) == statuses.count(503) == MAX_STREAMS
    for _, answer in viewers[:MAX_STREAMS]:
        assert answer.readline().startswith(b"data: ")
    assert live_server.threads() <= threads + OWN_THREADS
    for connection, _ in viewers:
        connection.close()

    def served_again() -> bool:
        connection, answer = live_server.viewer()
        connection.close()
        return answer.status == 200

    until(served_again, "place for a new viewer")


def test_holders_of_the_view_only_token_do_not_lock_others_out(live: World) -> None:
    """A whole class has it: neither connections that wait nor many requests on one use up the
    descriptors, and nothing is written about them.
    """
    files = 128
    with served(
        live, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (files, files))
    ) as server:
        get = (
            "GET /uPlot.iife.min.js HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer"
            f" {server.watch_token}\r\n\r\n"
        ).encode()
        rss = psutil.Process(server.pid).memory_info().rss
        events = get.replace(b"/uPlot.iife.min.js", b"/events")
        for sent in (b"", get[:50], get, events, 200 * get):
            with ExitStack() as held:
                for _ in range(3 * files):
                    held.enter_context(held_open(server, sent))
                assert server.ask("POST", "/ctl", {"cmd": "resume"})[0] == 200
                assert server.jpeg("picture")
        assert psutil.Process(server.pid).memory_info().rss < rss + 30e6


@contextmanager
def held_open(server: Server, sent: bytes) -> Iterator[None]:
    """A connection that has sent data, unless it was ended meanwhile, and stays open here."""
    with socket.create_connection(("127.0.0.1", server.port), timeout=60) as connection:
        with suppress(ConnectionResetError, BrokenPipeError):
            connection.sendall(sent)
        yield


DEEP = st.sampled_from([7, 8, 9, 31, 33, 500, 1900]).flatmap(
    lambda depth: st.sampled_from([depth * "[" + depth * "]", depth * '{"a":' + "1" + depth * "}"])
)
BODIES = st.one_of(
    (messages | values).map(lambda value: json.dumps(value).encode()),
    st.tuples(messages, DEEP).map(
        lambda both: (json.dumps(both[0])[:-1] + f',"set":{both[1]}}}').encode()
    ),
    messages.map(lambda value: json.dumps(value).encode("utf-16")),
    st.sampled_from(
        [
            b'{"cmd":"set","set":{"render.alpha_px":%s}}' % number
            for number in (b"1e999", b"1e-400", b"9" * 3900)
        ]
    ),
    st.binary(max_size=100),
)


def test_ctl_of_the_page_answers_any_body_and_goes_on(live_server: Server) -> None:
    @examples(200, suppress_health_check=list(HealthCheck))
    @given(BODIES)
    def attack(body: bytes) -> None:
        status, data = live_server.ask("POST", "/ctl", body)
        assert status in (200, 400, 413), (status, data)
        answer: Any = json.loads(data, parse_constant=pytest.fail)
        assert answer["ok"] is (status == 200) and (status == 200 or answer["error"])
        assert "Traceback" not in data.decode()

    attack()
    command = {"cmd": "set", "set": {"render.alpha_px": 12.0}}
    assert json.loads(live_server.ask("POST", "/ctl", command)[1])["ok"] is True
    assert live_server.ask("POST", "/ctl", {"cmd": "resume"})[0] == 200
    assert live_server.jpeg("picture")
