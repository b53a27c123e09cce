"""Invalid commands: for any bytes the answer is JSON with the reason, and the session and the page continue."""

import json
from typing import Any

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.web.server import Server

KEYS = ("render.alpha_px", "render.anaglyph", "render.zero_plane_px", "render.ghost_compensation", "track.filter", "nothing", "")
LARGE = [str(2**63), str(2**64), str(-(2**70)), 5000 * "9"]
NUMBERS = st.sampled_from(["NaN", "-Infinity", "1e999", "-1e999", "1e308", "1e-400", "-0", *LARGE])
CHARACTERS = ['"\\ud800"', '"\\udfff\\ud800"', '"\\u0000"', '"\x7f\\u202e"']
TEXTS = st.one_of(st.text(max_size=20).map(json.dumps), st.sampled_from(CHARACTERS))
PLAIN = st.one_of(NUMBERS, TEXTS, st.sampled_from(["true", "false", "null"]))


def lists(of: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    return st.lists(of, max_size=3).map(lambda items: f"[{','.join(items)}]")


def maps(of: st.SearchStrategy[str], keys: st.SearchStrategy[str] = TEXTS) -> st.SearchStrategy[str]:
    pairs = st.lists(st.tuples(keys, of), max_size=3)
    return pairs.map(lambda items: "{" + ",".join(f"{key}:{value}" for key, value in items) + "}")


ANY = st.recursive(PLAIN, lambda of: lists(of) | maps(of), max_leaves=12)
DEEP = st.sampled_from([7, 8, 9, 31, 33, 500, 1900]).flatmap(
    lambda depth: st.sampled_from([depth * "[" + depth * "]", depth * '{"a":' + "1" + depth * "}"])
)
SETS = maps(ANY | DEEP, st.sampled_from([json.dumps(key) for key in KEYS]))
WORDS = st.sampled_from(["set", "pause", "resume", "recentre", "reset", "stop", "load"])
COMMANDS = st.tuples(WORDS, SETS | ANY | DEEP, ANY).map(lambda parts: f'{{"cmd":"{parts[0]}","set":{parts[1]},"v":{parts[2]}}}')
UNVERSIONED = st.tuples(st.sampled_from(["set", "pause", "recentre"]), SETS | ANY | DEEP).map(
    lambda parts: f'{{"cmd":"{parts[0]}","set":{parts[1]}}}'
)
BODIES = st.one_of(
    COMMANDS.map(str.encode), UNVERSIONED.map(str.encode), UNVERSIONED.map(str.encode), (ANY | DEEP).map(str.encode),
    st.binary(max_size=100), UNVERSIONED.map(lambda text: text.encode("utf-16")),
)  # fmt: skip


def refuse_constant(text: str) -> Any:
    raise AssertionError(f"{text} is no JSON")


@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(BODIES)
def test_a_hostile_command_is_answered(live_server: Server, body: bytes) -> None:
    status, data = live_server.ask("POST", "/ctl", body)
    assert status in (200, 400, 413), (status, data)
    answer = json.loads(data, parse_constant=refuse_constant)
    assert answer["ok"] is (status == 200) and (status == 200 or answer["error"])
    assert "Traceback" not in data.decode()


def test_afterwards_page_and_session_go_on(live_server: Server) -> None:
    answer = json.loads(live_server.ask("POST", "/ctl", {"cmd": "set", "set": {"render.alpha_px": 12.0}})[1])
    assert answer["ok"] is True and live_server.ask("POST", "/ctl", {"cmd": "resume"})[0] == 200
    assert live_server.jpeg("picture")
