"""The requests of a session on ctl. Each handler is a pure function of state and request; it
returns a reply or refuses.

A request that names a file or a camera is executed by the stage that opens it, which answers or
refuses; a scene is packed first, then `on_load` shows it. A refusal is a BadMessage (not a request
at all) or a UserError (with a remedy); either changes nothing.
"""

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Protocol

import attrs

from lfpipe import config as config_module
from lfpipe.capture.spec import source_file
from lfpipe.config import DrawingCosts, SceneSummary, converter
from lfpipe.config.session_options import (
    CameraViewer,
    Lossless,
    MouseViewer,
    RecordedEyes,
    is_measurable,
)
from lfpipe.errors import UserError
from lfpipe.plugins import REQUESTS, blaming, load, plugins
from lfpipe.scene.pack import PackerRequest
from lfpipe.supervisor.process_table import (
    SCORER,
    SHOWN_BY,
    SOURCE,
    STAGES,
    TRACKED_BY,
)
from lfpipe.supervisor.session_state import SessionState
from lfpipe.transport.control import BadMessage, Message
from lfpipe.transport.ring import SECOND_NS

# outputs that can start and stop while a session runs:
# request, and option with its path -> its name, the command line
OUTPUTS = {
    "trace": ("trace", "lfpipe trace"),
    "record": ("recording", "lfpipe ctl record"),
}
# requests that only the stage that shows pictures may send
OF_THE_WINDOW = ("keep", "costs")
# what a client may do as if it had pressed the key in the window: actions of `lfpipe.render.ui`
REMOTE_ACTIONS = ("record", "screenshot", "glasses", "calibrate")
LEASE_S, MAX_LEASE_S = 5.0, 60.0  # of the ring of pictures


Then = Callable[[SessionState, Mapping[str, Message]], "Reply"]


@attrs.frozen(kw_only=True)
class Reply:
    """The result of a request. Without `load` and `executed_by`, it is answered as soon as the
    stages have applied `state`.
    """

    answer: Message = attrs.field(factory=dict)
    state: SessionState | None = None
    """To store; a new revision goes to the stages."""
    load: PackerRequest | None = None
    """The real reply comes from `on_load`."""
    executed_by: tuple[str, ...] = ()
    """The stages that execute the command, and then answer; those that start with `state`, as soon
    as they work."""
    payload: Message = attrs.field(factory=dict)
    """Passed to them with the command."""
    then: Then | None = None
    """The reply once they have executed it, from the state then and their answers by name."""
    with_stages: bool = False
    """The answer includes the metrics of the session."""
    stop: bool = False
    """Whether to end the session."""


Handler = Callable[[SessionState, Message, int], Reply]


def respond(state: SessionState, message: Message, t_ns: int, sender: str = "") -> Reply:
    """The reply to a request. t_ns: now. sender: the stage that sent it, or another client. Raises
    BadMessage, UserError.
    """
    command = message.get("cmd")
    if not isinstance(command, str) or command not in commands():
        raise BadMessage(f"unknown command {command!r:.100}; commands are {', '.join(commands())}")
    if command in OF_THE_WINDOW and sender != SHOWN_BY:
        raise BadMessage(f"{command}: only the window of the session may send it")
    if command in HANDLERS:
        return HANDLERS[command](state, message, t_ns)
    plugin: RequestPlugin = load(REQUESTS, command)
    with blaming([(REQUESTS, command)]):
        return plugin.respond(state, message, t_ns)


class RequestPlugin(Protocol):
    """A control command of another package: an entry point of `lfpipe.requests` of its name."""

    def respond(self, state: SessionState, message: Message, t_ns: int) -> Reply:
        """As `respond`."""


def commands() -> list[str]:
    """The control commands, built-in ones first."""
    return list(dict.fromkeys((*HANDLERS, *plugins(REQUESTS))))


def _set(state: SessionState, message: Message, _t_ns: int) -> Reply:
    sets = message.get("set")
    if not isinstance(sets, dict) or not sets:
        raise BadMessage("set needs a map of keys and values")
    new = state.changed(config_module.updated(state.config, sets, live_only=True))
    return Reply(answer={"set": sets}, state=new)


def _pictures(state: SessionState, message: Message, t_ns: int) -> Reply:
    """Leases the ring of pictures; a client that keeps reading must renew the lease in time."""
    lease_s = message.get("lease_s", LEASE_S)
    if not _is_positive(lease_s) or lease_s > MAX_LEASE_S:
        raise BadMessage(
            f"pictures: lease_s {lease_s!r:.100} is not a time of up to {MAX_LEASE_S:g} s"
        )
    if state.options.scene is None:
        raise UserError("the session shows no pictures", "start one that does: `lfpipe up SCENE`")
    new = state.with_pictures(t_ns + int(lease_s * SECOND_NS))
    return Reply(answer={"ring": new.options.pictures}, state=new)


def _load(state: SessionState, message: Message, _t_ns: int) -> Reply:
    index = _playlist_index(state, message)
    playlist = state.options.playlist
    scene = message.get("scene") if index is None or "scene" in message else playlist[index]
    if not isinstance(scene, str) or not _is_absolute(scene):
        raise BadMessage(
            "load needs the absolute path of a scene, or an index `at` or a `step` in the playlist"
        )
    if not state.options.show:
        raise UserError("the session shows no pictures", "start one that does: `lfpipe up SCENE`")
    scenes = [scene]
    if index is not None and (step := message.get("step")):  # on to the next one that can be opened
        order = (
            playlist[index:] + playlist[:index]
            if step > 0
            else playlist[index::-1] + playlist[:index:-1]
        )
        scenes = [path for path in order if path not in state.options.unusable] or [scene]
    how = {f"scene.{key}": message[key] for key in ("layout", "grid") if key in message}
    settings = config_module.updated(state.config, how).scene
    return Reply(
        load=PackerRequest(
            scenes=scenes, settings=settings, expand=index is None, remember=True, scorer=SCORER
        )
    )


def _playlist_index(state: SessionState, message: Message) -> int | None:
    """The playlist index of the scene that `load` requests: by path, `at` an index, or a `step`
    from the one shown; None if it is not in the playlist.
    """
    scenes = state.options.playlist
    scene = message.get("scene")
    if scene is not None:
        return scenes.index(scene) if scene in scenes else None
    index, step = message.get("at"), message.get("step")
    number = index if step is None else step
    if isinstance(number, bool) or not isinstance(number, int) or (index is None) == (step is None):
        return None
    if not scenes:
        raise UserError(
            "the session has no playlist",
            "start one with `lfpipe up SCENE SCENE ...`, or with a folder of scenes",
        )
    if step is not None:
        return (state.options.playlist_at + number) % len(scenes)
    if not 0 <= number < len(scenes):
        raise UserError(f"no scene {number} in the playlist", f"choose 0 to {len(scenes) - 1}")
    return number


def _output(state: SessionState, message: Message, _t_ns: int) -> Reply:
    """Starts writing the file or folder `path`; an empty path ends the current one."""
    command = message["cmd"]
    path = message.get("path")
    noun, words = OUTPUTS[command]
    running = getattr(state.options, command)
    if not isinstance(path, str) or not (_is_absolute(path) or not path):
        raise BadMessage(f"{command} needs an absolute path, or an empty one to stop")
    if path and running:
        raise UserError(f"a {noun} to {running} is already running", f"end it with `{words} stop`")
    if not path and not running:
        raise UserError(f"no {noun} is running", f"start one with `{words} start OUT`")
    if command == "record":
        return _record(state, path)
    if path:
        return _trace(state, path)
    return Reply(answer={"path": running}, state=state.changed(trace=""))


def _record(state: SessionState, path: str) -> Reply:
    """The stage that makes frames, or the eyes of the mouse, records them."""
    viewer = state.options.viewer
    if path:
        _check_eyes(state)
        if isinstance(viewer, RecordedEyes):
            raise UserError(f"{viewer.source} is a recording already", "copy its folder")
        if state.paused:
            raise UserError(
                "the session is paused: nothing would be recorded",
                "resume it: `lfpipe ctl resume`, or p in the window",
            )
    return Reply(
        executed_by=(SHOWN_BY if isinstance(viewer, MouseViewer) else SOURCE,),
        payload={"path": path},
        then=lambda now, _: Reply(
            answer={"path": path or state.options.record}, state=now.changed(record=path)
        ),
    )


def _trace(state: SessionState, path: str) -> Reply:
    if not state.options.show:
        raise UserError("the session shows no pictures", "start one that does: `lfpipe up SCENE`")
    source, record = source_file(state.options.viewer.source), state.options.record
    inputs = [str(one) for one in (source, record) if one]  # which it must not replace
    return Reply(
        executed_by=(SHOWN_BY,),
        payload={"path": path, "inputs": inputs},
        then=lambda now, _: Reply(answer={"path": path}, state=now.changed(trace=path)),
    )


def _viewer(state: SessionState, message: Message, _t_ns: int) -> Reply:
    """Exchanges the viewer for `source`: as for --camera; empty for the first camera."""
    source = message.get("source")
    options = state.options
    if not isinstance(source, str):
        raise BadMessage("viewer needs `source`: a camera or file, `mouse`, or empty")
    if options.record:
        raise UserError(f"the viewer is being recorded to {options.record}", "end the recording")
    if state.config.render.clock == "camera" or isinstance(options.clock, Lossless):
        raise UserError(
            "each picture of this session belongs to a frame of its camera",
            "start a session with render.clock=display",
        )
    if not has_eyes(state):
        raise UserError("no eyes are in use: the scene is a single view", "load another scene")
    if source == options.viewer.source:
        return Reply(answer={"source": source})  # no stage would start for it
    if source != MouseViewer.source:
        new = state.changed(viewer=CameraViewer(source=source))
        return Reply(state=new, executed_by=(SOURCE,), then=partial(_use_source, source))
    if options.lock_code:
        raise UserError("this session has no mouse", "choose a camera, or demo")
    return Reply(answer={"source": source}, state=state.changed(viewer=MouseViewer()))


def _use_source(source: str, state: SessionState, answers: Mapping[str, Message]) -> Reply:
    """The reply once a source works, with what it is."""
    if state.options.viewer.source != source:
        raise UserError("another viewer was chosen meanwhile", "choose again")
    viewer = converter().structure(answers[SOURCE], CameraViewer)
    return Reply(answer={"source": viewer.source}, state=state.changed(viewer=viewer))


def _check_eyes(state: SessionState) -> None:
    """Raises UserError if there is nothing to record."""
    if not has_eyes(state):
        raise UserError(
            "no camera is in use: the scene is a single view",
            "record without a scene: `lfpipe record OUT`",
        )


def has_eyes(state: SessionState) -> bool:
    """Whether the current scene needs eyes, and the session tracks them."""
    return state.options.viewer.tracked or isinstance(state.options.viewer, MouseViewer)


def on_load(
    state: SessionState,
    scene: SceneSummary,
    scenes: Sequence[str],
    unusable: Mapping[str, str],
) -> Reply:
    """The reply to a request for a scene that can be shown now, the first of scenes: a folder of
    light fields is the new playlist; another scene that is not in the playlist begins it. unusable:
    those that cannot be opened, and why.
    """
    playlist = state.options.playlist
    if not set(scenes) <= {*playlist}:
        playlist = tuple(scenes) if len(scenes) > 1 else (scenes[0], *playlist)
    new = state.loaded(scene, playlist.index(scenes[0]), playlist)
    return Reply(
        answer={"pack": scene.pack, "name": scene.name}, state=new.without(unusable, scenes[0])
    )


def on_complete(state: SessionState, scene: SceneSummary) -> SessionState:
    """The state once a scene has its disparity; unchanged if another scene is shown by then."""
    shown = state.options.scene
    if shown is None or shown.pack != scene.pack:
        return state
    logging.getLogger(__name__).info(
        "%s: disparity is complete, method %s", scene.name, scene.method
    )
    return state.loaded(scene)


def _recentre(state: SessionState, _message: Message, _t_ns: int) -> Reply:
    stages = tuple(
        stage.name
        for stage in STAGES
        if stage.name in (SHOWN_BY, TRACKED_BY) and stage.needed(state.options)
    )
    if not stages:
        raise UserError("the session has no viewer to recentre", "start one with a camera")
    return Reply(executed_by=stages)


def _is_positive(value: Any) -> bool:
    """Whether a value is a positive number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < math.inf


def _look(state: SessionState, message: Message, _t_ns: int) -> Reply:
    """Moves the mouse that is the viewer to `x`, `y`, shares of the picture."""
    position = {axis: message.get(axis) for axis in ("x", "y")}
    for axis, share in position.items():
        if isinstance(share, bool) or not isinstance(share, int | float) or not 0 <= share <= 1:
            raise BadMessage(f"look: {axis} {share!r:.100} is not a share from 0 to 1")
    if not isinstance(state.options.viewer, MouseViewer):
        raise UserError("the viewer is not the mouse", "exchange it: `lfpipe ctl viewer mouse`")
    return Reply(executed_by=(SHOWN_BY,), payload=position)


def _action(state: SessionState, message: Message, _t_ns: int) -> Reply:
    """Does what the key of an action does in the window."""
    name = message.get("name")
    if name not in REMOTE_ACTIONS:
        raise BadMessage(f"action: name {name!r:.100} is not one of {', '.join(REMOTE_ACTIONS)}")
    if not state.options.show or isinstance(state.options.clock, Lossless):
        raise UserError("nobody looks at this session", "start one that shows: `lfpipe up SCENE`")
    if name == "record":
        _check_eyes(state)
    if name == "calibrate" and not is_measurable(state.options.viewer):
        raise UserError("no camera is in use", "choose one: `lfpipe ctl viewer camera:0`")
    if name in ("glasses", "calibrate") and state.options.lock_code:
        raise UserError("the window is locked", "open that page before `--kiosk`")
    sent: Message = {key: message[key] for key in ("name", "value") if key in message}
    if not _is_positive(sent.get("value", 1.0)):
        raise BadMessage(f"action: value {sent['value']!r:.100} is not a positive number")
    return Reply(executed_by=(SHOWN_BY,), payload=sent)


def _is_absolute(path: str) -> bool:
    """Whether a path means the same for the supervisor as for its sender."""
    return path.startswith("/") and "\0" not in path


HANDLERS: dict[str, Handler] = {
    "hello": lambda state, _message, _t_ns: Reply(answer=state.message()),
    "status": lambda state, _message, _t_ns: Reply(
        answer={"paused": state.paused, "config": converter().unstructure(state.config)},
        with_stages=True,
    ),
    "set": _set,
    "pause": lambda state, _message, _t_ns: Reply(
        answer={"paused": True}, state=state.changed(paused=True)
    ),
    "resume": lambda state, _message, _t_ns: Reply(
        answer={"paused": False}, state=state.changed(paused=False)
    ),
    "recentre": _recentre,
    "look": _look,
    "action": _action,
    "load": _load,
    "pictures": _pictures,
    "trace": _output,
    "record": _output,
    "viewer": _viewer,
    # the focal length of the camera, which the window has measured and saved
    "keep": lambda state, message, t_ns: _set(
        state, {"set": {"camera.focal_px": message.get("focal_px")}}, t_ns
    ),
    "costs": lambda state, message, _t_ns: Reply(
        state=state.with_costs(converter().structure(message, DrawingCosts))
    ),
    "stop": lambda _state, _message, _t_ns: Reply(stop=True),
}
