"""Requests as pure functions: each shape that a message can carry gives a reply or a refusal, and never another exception."""

from typing import Any

import attrs
import pytest
from hypothesis import given, settings

from lfpipe.config import Config, SessionOptions
from lfpipe.errors import UserError
from lfpipe.supervisor.requests import Reply, respond, respond_checked
from lfpipe.supervisor.session_state import SessionState
from lfpipe.transport import control
from lfpipe.transport.control import BadMessage
from tests.supervisor.states import SCENE, made_state, messages


def reply_to(state: SessionState, message: dict[str, Any]) -> Reply | str:
    """The reply, or the text of the refusal."""
    try:
        return respond(state, message, 0)
    except BadMessage as error:
        return str(error)
    except UserError as error:
        return f"{error.message} ({error.remedy})"


@settings(max_examples=800)
@given(messages)
def test_every_shape_of_request_is_answered_or_refused(message: dict[str, Any]) -> None:
    state = made_state(record="/running")
    reply = reply_to(state, message)
    if isinstance(reply, str):
        assert reply
        return
    control.encode({"ok": True, **reply.answer})
    if reply.state is not None:
        assert control.decode(control.encode(reply.state.message()))["rev"] == reply.state.rev
        changing = ("set", "pause", "resume", "record", "trace", "pictures", "share")
        assert reply.state.rev == state.rev or message["cmd"] in changing


@pytest.mark.parametrize(
    "sets",
    [
        {"render": {}},
        {"render": {"alpha_px": 5}},
        {"render": 5},
        {"render.alpha_px": {}},
        {"render.alpha_px": float("nan")},
        {"render.alpha_px": 2**64 - 1},
        {"": 1},
        {"render.method": "warp", "camera.width_px": 320},
        {f"render.x{i}": 1 for i in range(3626)},
    ],
)
def test_a_set_that_is_wrong_is_refused_with_a_short_answer(sets: dict[str, Any]) -> None:
    state = made_state()
    refusal = reply_to(state, {"cmd": "set", "set": sets})
    assert isinstance(refusal, str) and len(refusal) < 4000, refusal[:200]


def test_files_are_looked_at_by_a_child_and_never_here() -> None:
    state = made_state()
    for message in (
        {"cmd": "load", "scene": "/nowhere"},
        {"cmd": "trace", "path": "/nowhere/x.json"},
        {"cmd": "record", "path": "/nowhere"},
        {"cmd": "share", "start": ["/nowhere"]},
    ):
        reply = respond(state, message, 0)
        assert reply.check is not None and reply.state is None and reply.check["path"].startswith("/nowhere")


def test_what_another_client_did_meanwhile_is_respected() -> None:
    message = {"cmd": "record", "path": "/mine"}
    started = respond_checked(made_state(), message, {}, 0)
    assert started.state is not None and started.state.options.record == "/mine"
    with pytest.raises(UserError, match="a recording to /theirs is already running"):
        respond_checked(made_state(record="/theirs"), message, {}, 0)


def test_targets_are_shared_with_until_they_are_stopped() -> None:
    running = ("osc:127.0.0.1:9000?rate=60", "lsl:lab")
    for message in ({"start": []}, {"stop": []}):
        with pytest.raises(UserError):
            respond(made_state(), {"cmd": "share", **message}, 0)
    with pytest.raises(BadMessage, match="9 targets"):
        respond(made_state(), {"cmd": "share", "start": ["lsl"] * 9}, 0)
    state = made_state(share=running)
    with pytest.raises(UserError, match=r"osc:127\.0\.0\.1:1"):
        respond(state, {"cmd": "share", "stop": ["osc:127.0.0.1:1"]}, 0)
    one, all_of_them = ({"cmd": "share", "stop": texts} for texts in (["osc:127.0.0.1:9000"], []))
    assert (new := respond(state, one, 0).state) is not None and new.options.share == ("lsl:lab",)
    assert (new := respond(state, all_of_them, 0).state) is not None and new.options.share == ()
    started = respond_checked(state, {"cmd": "share", "start": ["opentrack:h:1"]}, {"targets": ["opentrack:10.0.0.1:1"]}, 0)
    assert started.state is not None and started.state.options.share == (*running, "opentrack:10.0.0.1:1")


def test_each_request_changes_what_it_names_and_nothing_else() -> None:
    state = made_state()
    for cmd, paused in (("pause", True), ("resume", False)):
        reply = respond(state.changed(paused=not paused), {"cmd": cmd}, 0)
        assert reply.answer == {"paused": paused} and reply.state is not None and reply.state.paused is paused
    reply = respond(state, {"cmd": "set", "set": {"render.alpha_px": 20.0}}, 0)
    assert (
        reply.state is not None
        and reply.state.config.render.alpha_px == 20.0
        and reply.answer == {"set": {"render.alpha_px": 20.0}}
    )
    assert respond(state, {"cmd": "hello"}, 0) == Reply(state.message())
    status = respond(state, {"cmd": "status"}, 0)
    assert status.with_stages and not status.stop and status.answer["paused"] is False
    assert respond(state, {"cmd": "recentre"}, 0) == Reply(broadcast={"cmd": "recentre"})
    assert respond(state, {"cmd": "stop"}, 0) == Reply(stop=True) and not Reply().with_stages
    for wrong in ({}, {"set": {}}, {"set": []}):
        with pytest.raises(BadMessage, match="set"):
            respond(state, {"cmd": "set", **wrong}, 0)


def test_a_lease_of_pictures_lasts_as_asked_and_five_seconds_without() -> None:
    for lease_s, until_ns in ((None, 5 * 10**9 + 7), (0.5, 5 * 10**8 + 7), (60, 60 * 10**9 + 7), (60.0, 60 * 10**9 + 7)):
        reply = respond(made_state(), {"cmd": "pictures"} | ({} if lease_s is None else {"lease_s": lease_s}), 7)
        assert reply.state is not None and reply.state.pictures_until_ns == until_ns and reply.answer == {"ring": "pictures.1"}
    for lease in (0, -1, 60.001, True, "5", None, [5]):
        with pytest.raises(BadMessage, match="lease_s"):
            respond(made_state(), {"cmd": "pictures", "lease_s": lease}, 0)
    with pytest.raises(UserError, match="no pictures"):
        respond(SessionState.first(Config(), SessionOptions(show=False)), {"cmd": "pictures"}, 0)


def test_a_scene_is_loaded_by_path_by_number_or_by_step() -> None:
    state = made_state(playlist=("/a", "/b", "/c"), playlist_at=2)
    cases: list[tuple[dict[str, Any], str]] = [
        ({"scene": "/x"}, "/x"), ({"scene": "/b"}, "/b"), ({"at": 0}, "/a"), ({"at": 2}, "/c"), ({"step": 1}, "/a"),
        ({"step": -1}, "/b"), ({"step": -3}, "/c"), ({"scene": "/x", "at": 1}, "/x"),
    ]  # fmt: skip
    for words, path in cases:
        check = {"check": "scene", "path": path, "settings": {}}
        assert respond(state, {"cmd": "load", **words}, 0).check == check, words
    layout = {"layout": "quilt", "grid": "4x8"}
    reply = respond(state, {"cmd": "load", "scene": "/x", **layout}, 0)
    assert reply.check is not None and reply.check["settings"] == layout
    for words in (
        {},
        {"scene": "x"},
        {"scene": "/x\0"},
        {"scene": 5},
        {"at": 1, "step": 1},
        {"at": True},
        {"step": 1.0},
        {"at": "1"},
    ):
        with pytest.raises(BadMessage, match="absolute path"):
            respond(state, {"cmd": "load", **words}, 0)
    for at in (3, -1):
        with pytest.raises(UserError, match=f"no scene {at}"):
            respond(state, {"cmd": "load", "at": at}, 0)
    with pytest.raises(UserError, match="no playlist"):
        respond(made_state(), {"cmd": "load", "at": 0}, 0)
    with pytest.raises(UserError, match="no pictures"):
        respond(made_state(show=False), {"cmd": "load", "scene": "/x"}, 0)
    for words, at in (({"scene": "/b"}, 1), ({"step": 1}, 0), ({"scene": "/x"}, 2)):
        loaded = respond_checked(state, {"cmd": "load", **words}, attrs.asdict(SCENE), 0)
        assert loaded.answer == {"pack": SCENE.pack} and loaded.state is not None and loaded.state.options.playlist_at == at


def test_what_needs_eyes_takes_those_of_a_camera_or_a_mouse() -> None:
    record, share = {"cmd": "record", "path": "/r"}, {"cmd": "share", "start": ["lsl"] * 8}
    for eyes in ({}, {"tracking": False, "mouse": True}):
        for message in (record, share):
            assert respond(made_state(**eyes), message, 0).check is not None
    reply = respond(made_state(timeline="/t"), {"cmd": "trace", "path": ""}, 0)
    assert reply.answer == {"path": "/t"} and reply.state is not None and not reply.state.options.timeline
    for message in ({"cmd": "record", "path": "r"}, {"cmd": "record", "path": 5},
                    {"cmd": "trace", "path": "t"}, {"cmd": "trace"}):  # fmt: skip
        with pytest.raises(BadMessage, match="absolute path"):
            respond(made_state(), message, 0)
    for message in (
        {"cmd": "share"},
        {"cmd": "share", "start": ["lsl"], "stop": []},
        {"cmd": "share", "start": "lsl"},
        {"cmd": "share", "stop": [5]},
    ):
        with pytest.raises(BadMessage, match="list of targets"):
            respond(made_state(), message, 0)
    started = respond_checked(made_state(), {"cmd": "trace", "path": "/t"}, {}, 0)
    assert started.answer == {"path": "/t"} and started.state is not None and started.state.options.timeline == "/t"
    without = respond_checked(made_state(), {"cmd": "record", "path": "/r"}, {}, 0)
    assert without.state is not None and without.state.options.record == "/r"
