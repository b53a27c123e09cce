"""Requests as pure functions: each shape that a message can carry gives a reply or a refusal, and
never another exception.
"""

from pathlib import Path
from typing import Any

import attrs
import pytest
from hypothesis import given

from lfpipe.config import Config, Scene, updated
from lfpipe.config.session_options import CameraViewer, MouseViewer, NoViewer, Window
from lfpipe.errors import UserError
from lfpipe.scene.pack import PackerRequest
from lfpipe.supervisor.process_table import SCORER
from lfpipe.supervisor.requests import (
    REMOTE_ACTIONS,
    Reply,
    on_complete,
    on_load,
    respond,
)
from lfpipe.supervisor.session_state import SessionState
from lfpipe.transport import control
from lfpipe.transport.control import BadMessage
from tests.supervisor.states import SCENE, made_state, messages
from tests.support.examples import examples

ROOT = Path(__file__).parents[2]
Message = dict[str, Any]
PACKED = {"pack": SCENE.pack, "name": SCENE.name}
LIST: Message = {"playlist": ("/a", "/b", "/c"), "playlist_at": 2}


def reply_to(state: SessionState, message: Message) -> Reply | str:
    """The reply, or the text of the refusal."""
    try:
        return respond(state, message, 7)
    except BadMessage as error:
        return str(error)
    except UserError as error:
        return f"{error.message} ({error.remedy})"


@examples(300)
@given(messages)
def test_respond_answers_or_refuses_every_shape_of_request(message: Message) -> None:
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


PLACE: Message = {"x": 0.25, "y": 1}
BY_MOUSE: Message = {"viewer": MouseViewer()}
PRESSED: list[Message] = [
    {"name": "calibrate", "value": 560.0},
    *({"name": name} for name in REMOTE_ACTIONS),
]
LOCKED: Message = {"display": Window(lock_code="code")}
# options of the session, what is sent, what is answered
ANSWERED: list[tuple[Message, Message, Reply]] = [
    ({}, {"cmd": "hello"}, Reply(answer=made_state().message())),
    ({}, {"cmd": "recentre"}, Reply(executed_by=("track", "render"))),
    (BY_MOUSE, {"cmd": "recentre"}, Reply(executed_by=("render",))),
    ({}, {"cmd": "stop"}, Reply(stop=True)),
    (
        BY_MOUSE,
        {"cmd": "look", **PLACE, "more": "not passed on"},
        Reply(executed_by=("render",), payload=PLACE),
    ),
    *(({}, {"cmd": "action", **at}, Reply(executed_by=("render",), payload=at)) for at in PRESSED),
]


@pytest.mark.parametrize(("options", "message", "reply"), ANSWERED)
def test_respond_answers(options: Message, message: Message, reply: Reply) -> None:
    assert respond(made_state(**options), message, 0) == reply


# what is sent, what is answered, and what of the state is then so
CHANGED: list[tuple[Message, Message, Message]] = [
    ({"cmd": "pause"}, {"paused": True}, {"paused": True}),
    ({"cmd": "resume"}, {"paused": False}, {"paused": False}),
    (
        {"cmd": "set", "set": {"render.alpha_px": 20.0}},
        {"set": {"render.alpha_px": 20.0}},
        {"config": updated(Config(), {"render.alpha_px": 20.0})},
    ),
    *(
        (
            {"cmd": "pictures", **lease},
            {"ring": "pictures.lent"},
            {"pictures_until_ns": lasts_s * 10**9},
        )
        for lease, lasts_s in (({}, 5.0), ({"lease_s": 0.5}, 0.5), ({"lease_s": 60}, 60))
    ),
]


@pytest.mark.parametrize(("message", "answer", "state"), CHANGED)
def test_respond_changes_the_state(
    monkeypatch: pytest.MonkeyPatch, message: Message, answer: Message, state: Message
) -> None:
    monkeypatch.setattr("secrets.token_hex", lambda _: "lent")
    reply = respond(made_state(), message, 0)
    assert reply.answer == answer and reply.state is not None
    assert {name: getattr(reply.state, name) for name in state} == state


# command, options of the session, words of the refusal, what is sent
REFUSED: list[tuple[str, Message, str, list[Message]]] = [
    ("set", {}, "set needs", [{}, {"set": {}}, {"set": []}]),
    (
        "set",
        {},
        "render: a section",
        [{"set": {"render": {}}}, {"set": {"render": {"alpha_px": 5}}}, {"set": {"render": 5}}],
    ),
    (
        "set",
        {},
        "render.alpha_px: ",
        [
            {"set": {"render.alpha_px": {}}},
            {"set": {"render.alpha_px": float("nan")}},
            {"set": {"render.alpha_px": 2**64 - 1}},
        ],
    ),
    (
        "set",
        {},
        "unknown key",
        [{"set": {"": 1}}, {"set": {f"render.x{i}": 1 for i in range(3626)}}],
    ),
    (
        "set",
        {},
        "fixed while a session runs",
        [{"set": {"render.method": "warp", "camera.width_px": 320}}],
    ),
    (
        "pictures",
        {},
        "lease_s",
        [{"lease_s": wrong} for wrong in (0, -1, 60.001, True, "5", None, [5])],
    ),
    ("pictures", {"scene": None}, "no pictures", [{}]),
    ("load", LIST, "absolute path", [{}, {"scene": "x"}, {"scene": "/x\0"}, {"scene": 5}]),
    (
        "load",
        LIST,
        "absolute path",
        [{"at": 1, "step": 1}, {"at": True}, {"step": 1.0}, {"at": "1"}],
    ),
    ("load", LIST, "no scene", [{"at": 3}, {"at": -1}]),
    ("load", {}, "no playlist", [{"at": 0}]),
    ("load", {"show": False}, "no pictures", [{"scene": "/x"}]),
    ("record", {}, "absolute path", [{"path": "r"}, {"path": 5}]),
    ("record", {"viewer": NoViewer()}, "single view", [{"path": "/r"}]),
    ("trace", {}, "absolute path", [{"path": "t"}, {}]),
    ("trace", {"show": False}, "no pictures", [{"path": "/t"}]),
    ("viewer", {"record": "/r"}, "being recorded", [{"source": "mouse"}]),
    ("viewer", {"viewer": NoViewer()}, "single view", [{"source": "mouse"}]),
    ("viewer", LOCKED, "no mouse", [{"source": "mouse"}]),
    ("recentre", {"viewer": NoViewer(), "show": False}, "no viewer", [{}]),
    ("look", {}, "`lfpipe ctl viewer mouse`", [PLACE]),
    (
        "look",
        BY_MOUSE,
        "look: x",
        [{**PLACE, "x": wrong} for wrong in (None, "0", True, -0.1, 1.1, float("nan"))],
    ),
    ("action", {"show": False}, "nobody looks", [{"name": name} for name in REMOTE_ACTIONS]),
    ("action", {"viewer": NoViewer()}, "single view", [{"name": "record"}]),
    ("action", LOCKED, "locked", [{"name": "glasses"}, {"name": "calibrate"}]),
    ("action", BY_MOUSE, "no camera", [{"name": "calibrate"}]),
    (
        "action",
        {},
        "action: value",
        [{"name": "calibrate", "value": wrong} for wrong in ("560", -1, True, None)],
    ),
    ("action", {}, "action: name", [{"name": wrong} for wrong in ("quit", ["record"], None)]),
]


@pytest.mark.parametrize(("command", "options", "words", "wrong"), REFUSED)
def test_respond_refusals_are_short(
    command: str, options: Message, words: str, wrong: list[Message]
) -> None:
    for sent in wrong:
        refusal = reply_to(made_state(**options), {"cmd": command, **sent})
        assert isinstance(refusal, str) and words in refusal and len(refusal) < 4000, sent


@pytest.mark.parametrize(
    ("words", "paths"),
    [
        ({"scene": "/x"}, ["/x"]),
        ({"scene": "/b"}, ["/b"]),
        ({"at": 0}, ["/a"]),
        ({"at": 2}, ["/c"]),
        ({"step": 1}, ["/a", "/b", "/c"]),
        ({"step": -1}, ["/b", "/a", "/c"]),
        ({"step": -3}, ["/c", "/b", "/a"]),
        ({"scene": "/x", "at": 1}, ["/x"]),
    ],
)
def test_respond_load_takes_a_path_a_number_or_a_step(words: Message, paths: list[str]) -> None:
    cases: tuple[dict[str, Any], ...] = ({}, {"layout": "quilt", "grid": "4x8"})
    for settings_ in cases:
        reply = respond(made_state(**LIST), {"cmd": "load", **words, **settings_}, 0)
        settings = Scene(**settings_)
        asked = PackerRequest(
            scenes=paths, settings=settings, expand=paths == ["/x"], remember=True, scorer=SCORER
        )
        assert reply == Reply(load=asked)


def test_a_step_leaves_out_what_cannot_be_opened_and_a_path_tries_it_again() -> None:
    state = made_state(**LIST, unusable={"/a": "empty"})
    reply = respond(state, {"cmd": "load", "step": 1}, 0)
    assert reply.load is not None and reply.load.scenes == ("/b", "/c")
    opened = on_load(state, SCENE, ["/b", "/c"], {"/d": "damaged"}).state
    assert opened is not None and opened.options.playlist_at == 1
    assert opened.options.unusable == {"/a": "empty", "/d": "damaged"}
    again = respond(opened, {"cmd": "load", "scene": "/a"}, 0)
    assert again.load is not None and again.load.scenes == ("/a",)
    repaired = on_load(opened, SCENE, ["/a"], {}).state
    assert repaired is not None and repaired.options.unusable == {"/d": "damaged"}


def test_the_stage_that_opens_a_file_executes_the_request() -> None:
    for viewer, inputs in ((CameraViewer(source="file:/v.mp4"), ["/v.mp4"]), (MouseViewer(), [])):
        state = made_state(viewer=viewer)
        trace = respond(state, {"cmd": "trace", "path": "/t"}, 0)
        assert (trace.executed_by, trace.state) == (("render",), None)
        assert trace.payload == {"path": "/t", "inputs": inputs} and trace.then is not None
        then = trace.then(state, {})
        assert then.answer == {"path": "/t"} and then.state == state.changed(trace="/t")
        record = respond(state, {"cmd": "record", "path": "/r"}, 0)
        by = "render" if isinstance(viewer, MouseViewer) else "capture"
        assert (record.executed_by, record.state, record.payload) == ((by,), None, {"path": "/r"})
        assert record.then is not None
        then = record.then(state, {})
        assert then.answer == {"path": "/r"} and then.state == state.changed(record="/r")
        assert then.state is not None
        ended = respond(then.state, {"cmd": "record", "path": ""}, 0)
        assert ended.executed_by == (by,) and ended.then is not None
        after = ended.then(then.state, {})
        assert after.answer == {"path": "/r"} and after.state is not None
        assert not after.state.options.record


@pytest.mark.parametrize(
    ("options", "message", "result", "answer", "changed"),  # result: of the packer
    [
        (
            LIST,
            {"cmd": "load", "scene": "/b"},
            ["/b"],
            PACKED,
            {"playlist_at": 1},
        ),
        (
            LIST,
            {"cmd": "load", "step": 1},
            ["/a", "/b"],
            PACKED,
            {"playlist_at": 0},
        ),
        (
            LIST,
            {"cmd": "load", "scene": "/x"},
            ["/x"],
            PACKED,
            {"playlist": ("/x", *LIST["playlist"]), "playlist_at": 0},
        ),
        ({"trace": "/t"}, {"cmd": "trace", "path": ""}, None, {"path": "/t"}, {"trace": ""}),
    ],
)
def test_respond_changes_the_option_that_is_named(
    options: Message,
    message: Message,
    result: list[str] | None,
    answer: Message,
    changed: Message,
) -> None:
    state = made_state(**options)
    reply = respond(state, message, 0) if result is None else on_load(state, SCENE, result, {})
    assert reply.answer == answer and reply.state is not None
    after, before = attrs.asdict(reply.state.options), attrs.asdict(state.options)
    assert {key: after[key] for key in changed} == changed
    assert {key for key in after if after[key] != before[key]} <= {*changed, "packets"}, (
        "and nothing else"
    )


def test_only_the_window_applies_a_measured_focal_length() -> None:
    message = {"cmd": "keep", "focal_px": 612.5}
    for sender in ("", "track", "monitor"):
        with pytest.raises(BadMessage, match="only the window"):
            respond(made_state(), message, 0, sender)
    reply = respond(made_state(), message, 0, "render")
    assert reply.answer == {"set": {"camera.focal_px": 612.5}} and reply.state is not None
    assert reply.state.config.camera.focal_px == 612.5


def test_on_load_takes_the_scenes_of_a_folder_as_the_playlist() -> None:
    state = made_state(playlist=("/a", "/b", "/c"), playlist_at=2)
    reply = on_load(state, SCENE, ["/d/one", "/d/two"], {})
    assert reply.state is not None
    assert reply.state.options.playlist == ("/d/one", "/d/two")
    assert reply.state.options.playlist_at == 0
    back = reply.state.rolled_back().options
    assert (back.playlist, back.playlist_at) == (("/a", "/b", "/c"), 2)


def test_paused_session_refuses_a_recording_that_would_stay_empty() -> None:
    paused = made_state().changed(paused=True)
    with pytest.raises(UserError, match="nothing would be recorded"):
        respond(paused, {"cmd": "record", "path": "/r"}, 0)


def test_viewer_is_exchanged_by_the_mouse_and_by_a_camera_that_capture_opens() -> None:
    state = made_state(display=Window())
    by_mouse = respond(state, {"cmd": "viewer", "source": "mouse"}, 0).state
    assert by_mouse is not None and by_mouse.options.viewer == MouseViewer()
    for same in (state, by_mouse):
        source = same.options.viewer.source
        reply = respond(same, {"cmd": "viewer", "source": source}, 0)
        assert reply == Reply(answer={"source": source})
    reply = respond(by_mouse, {"cmd": "viewer", "source": "camera:0"}, 0)
    assert reply.executed_by == ("capture",) and reply.then is not None and reply.state is not None
    assert reply.state.options.viewer == CameraViewer(source="camera:0")
    assert reply.state.rolled_back().options.viewer == state.options.viewer
    found = CameraViewer(source="camera:/dev/video0", rate_hz=30.0, jpeg_px=(640, 480), name="C9")
    answers = {"capture": control.decode(control.encode(attrs.asdict(found)))}
    then = reply.then(reply.state, answers)
    assert then.answer == {"source": "camera:/dev/video0"} and then.state is not None
    assert then.state.options.viewer == found
    with pytest.raises(UserError, match="meanwhile"):
        reply.then(by_mouse, answers)


def test_on_complete_of_a_scene_no_longer_shown_changes_nothing() -> None:
    state = made_state(scene=attrs.evolve(SCENE, complete=False))
    after = on_complete(state, SCENE)
    assert after.options.complete and after.rev == state.rev + 1
    assert on_complete(state, attrs.evolve(SCENE, pack="/packs/other")) is state
