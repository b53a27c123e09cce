"""Requests as pure functions: each shape that a message can carry gives a reply or a refusal, and never another exception."""

from typing import Any

import pytest
from hypothesis import given, settings

from lfpipe.errors import UserError
from lfpipe.supervisor.requests import Reply, respond, respond_checked
from lfpipe.supervisor.session_state import SessionState
from lfpipe.transport import control
from lfpipe.transport.control import BadMessage
from tests.supervisor.states import made_state, messages


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
    message = {"cmd": "record", "path": "/mine", "eyes": True}
    started = respond_checked(made_state(), message, {}, 0)
    assert started.state is not None and started.state.options.record == "/mine" and started.state.options.record_eyes
    with pytest.raises(UserError, match="a recording to /theirs is already running"):
        respond_checked(made_state(record="/theirs"), message, {}, 0)


def test_recordings_and_traces_stop_only_where_one_runs() -> None:
    with pytest.raises(UserError, match="no recording"):
        respond(made_state(), {"cmd": "record", "path": ""}, 0)
    reply = respond(made_state(timeline="/t"), {"cmd": "trace", "path": ""}, 0)
    assert reply.answer == {"path": "/t"} and reply.state is not None and not reply.state.options.timeline


def test_targets_are_shared_with_until_they_are_stopped() -> None:
    running = ("osc:127.0.0.1:9000?rate=60", "lsl:lab")
    with pytest.raises(UserError, match="no target given"):
        respond(made_state(), {"cmd": "share", "start": []}, 0)
    with pytest.raises(UserError, match="nothing is shared"):
        respond(made_state(), {"cmd": "share", "stop": []}, 0)
    with pytest.raises(BadMessage, match="9 targets"):
        respond(made_state(), {"cmd": "share", "start": ["lsl"] * 9}, 0)
    with pytest.raises(UserError, match="no eyes are tracked"):
        respond(made_state(tracking=False), {"cmd": "share", "start": ["lsl"]}, 0)
    state = made_state(share=running)
    with pytest.raises(UserError, match=r"osc:127\.0\.0\.1:1"):
        respond(state, {"cmd": "share", "stop": ["osc:127.0.0.1:1"]}, 0)
    one, all_of_them = ({"cmd": "share", "stop": texts} for texts in (["osc:127.0.0.1:9000"], []))
    assert (new := respond(state, one, 0).state) is not None and new.options.share == ("lsl:lab",)
    assert (new := respond(state, all_of_them, 0).state) is not None and new.options.share == ()
    started = respond_checked(state, {"cmd": "share", "start": ["opentrack:h:1"]}, {"targets": ["opentrack:10.0.0.1:1"]}, 0)
    assert started.state is not None and started.state.options.share == (*running, "opentrack:10.0.0.1:1")
