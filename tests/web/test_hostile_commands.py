"""Invalid commands: for any bytes the answer is JSON with the reason, and the session and the page continue."""

import json
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.web.server import Server

KEYS = ("render.alpha_px", "render.anaglyph", "render.zero_plane_px", "render.ghost_compensation", "track.filter", "nothing", "")
ODD = [2**63, 2**64, -(2**70), 1e308, -0.0, float("nan"), float("inf"), "\ud800", "\udfff\ud800", "\0", "\x7f\u202e"]
PLAIN = st.sampled_from(ODD) | st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20)
ANY = st.recursive(PLAIN, lambda of: st.lists(of, max_size=3) | st.dictionaries(st.text(max_size=9), of), max_leaves=12)
WORDS = st.sampled_from(["set", "pause", "resume", "recentre", "reset", "stop", "load"]) | ANY
SETS = st.dictionaries(st.sampled_from(KEYS), ANY, max_size=3)
COMMANDS = st.fixed_dictionaries({"cmd": WORDS}, optional={"set": SETS | ANY, "v": ANY, "at": ANY})
DEEP = st.sampled_from([7, 8, 9, 31, 33, 500, 1900]).flatmap(
    lambda depth: st.sampled_from([depth * "[" + depth * "]", depth * '{"a":' + "1" + depth * "}"])
)
BODIES = st.one_of(
    (COMMANDS | ANY).map(lambda value: json.dumps(value).encode()),
    st.tuples(COMMANDS, DEEP).map(lambda both: (json.dumps(both[0])[:-1] + f',"set":{both[1]}}}').encode()),
    COMMANDS.map(lambda value: json.dumps(value).encode("utf-16")),
    st.sampled_from([b'{"cmd":"set","set":{"render.alpha_px":%s}}' % number for number in (b"1e999", b"1e-400", b"9" * 3900)]),
    st.binary(max_size=100),
)


@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(BODIES)
def test_a_hostile_command_is_answered_and_the_page_goes_on(live_server: Server, body: bytes) -> None:
    status, data = live_server.ask("POST", "/ctl", body)
    assert status in (200, 400, 413), (status, data)
    answer: Any = json.loads(data, parse_constant=pytest.fail)
    assert answer["ok"] is (status == 200) and (status == 200 or answer["error"]) and "Traceback" not in data.decode()


def test_afterwards_page_and_session_go_on(live_server: Server) -> None:
    answer = json.loads(live_server.ask("POST", "/ctl", {"cmd": "set", "set": {"render.alpha_px": 12.0}})[1])
    assert answer["ok"] is True and live_server.ask("POST", "/ctl", {"cmd": "resume"})[0] == 200
    assert live_server.jpeg("picture")
