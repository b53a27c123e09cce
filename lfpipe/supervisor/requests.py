"""The requests of a session on ctl. Each handler is a pure function of state and request; it returns a reply or refuses.

Requests that name files come in two steps: `respond` asks for a check by a child process (`file_requests`), `respond_checked`
processes its result; for a scene, that child is the packer. A refusal is a BadMessage (not a request at all) or a UserError (with
a remedy); either changes nothing.
"""

from collections.abc import Callable
from typing import Any

import attrs

from lfpipe import config as config_module
from lfpipe.config import SceneSummary
from lfpipe.errors import UserError
from lfpipe.errors import shown as printable
from lfpipe.share.target import FORMS, MAX_TARGETS
from lfpipe.supervisor.session_state import SessionState
from lfpipe.transport.clock import SECOND_NS
from lfpipe.transport.control import BadMessage

# what is written while a session runs: request -> option with its path, in words, as a person types it
OUTPUTS = {
    "trace": ("timeline", "timeline", "lfpipe trace"),
    "record": ("record", "recording", "lfpipe ctl record"),
}
LEASE_S, MAX_LEASE_S = 5.0, 60.0  # of the ring of pictures


@attrs.frozen
class Reply:
    """answer: sent back. state: to apply; if it is a new revision, the answer waits until the stages have applied it. broadcast:
    a message for every stage. check: a request for `file_requests`, whose result gives the real reply. with_stages: the answer
    gets the figures of the stages. stop: the session ends.
    """

    answer: dict[str, Any] = attrs.field(factory=dict)
    state: SessionState | None = None
    broadcast: dict[str, Any] | None = None
    check: dict[str, Any] | None = None
    with_stages: bool = False
    stop: bool = False


Handler = Callable[[SessionState, dict[str, Any], int], Reply]


def respond(state: SessionState, message: dict[str, Any], t_ns: int) -> Reply:
    """The reply to a request. t_ns: now. Raises BadMessage, UserError."""
    command = message.get("cmd")
    if not isinstance(command, str) or command not in HANDLERS:
        raise BadMessage(f"unknown command {command!r:.100}; commands are {', '.join(HANDLERS)}")
    return HANDLERS[command](state, message, t_ns)


def _set(state: SessionState, message: dict[str, Any], _t_ns: int) -> Reply:
    sets = message.get("set")
    if not isinstance(sets, dict) or not sets:
        raise BadMessage("set needs a map of keys and values")
    config = config_module.updated(state.config, sets, live_only=True)
    return Reply({"set": sets}, state.changed(config))


def _pictures(state: SessionState, message: dict[str, Any], t_ns: int) -> Reply:
    """Leases the ring of pictures; a client that keeps reading must renew the lease in time."""
    lease_s = message.get("lease_s", LEASE_S)
    if (
        isinstance(lease_s, bool)
        or not isinstance(lease_s, int | float)
        or not 0 < lease_s <= MAX_LEASE_S
    ):
        raise BadMessage(
            f"pictures: lease_s {lease_s!r:.100} is not a time of up to {MAX_LEASE_S:g} s"
        )
    if state.options.scene is None:
        raise UserError("the session shows no pictures", "start one that does: `lfpipe up SCENE`")
    new = state.with_pictures(t_ns + int(lease_s * SECOND_NS))
    return Reply({"ring": new.options.pictures}, new)


def _load(state: SessionState, message: dict[str, Any], _t_ns: int) -> Reply:
    at = _place(state, message)
    scene = message.get("scene") if at is None or "scene" in message else state.options.playlist[at]
    if not isinstance(scene, str) or not _absolute(scene):
        raise BadMessage(
            "load needs the absolute path of a scene, or an index `at` or a `step` in the playlist"
        )
    if not state.options.show:
        raise UserError("the session shows no pictures", "start one that does: `lfpipe up SCENE`")
    how: dict[str, Any] = {key: message[key] for key in ("layout", "grid") if key in message}
    config_module.updated(
        state.config, {f"scene.{key}": value for key, value in how.items()}
    )  # only for its checks
    return Reply(check={"check": "scene", "path": scene, "settings": how})


def _place(state: SessionState, message: dict[str, Any]) -> int | None:
    """The playlist index of the scene that `load` requests: by path, `at` an index, or a `step` from the one shown; None
    if it is not in the playlist."""
    scenes, scene = state.options.playlist, message.get("scene")
    if scene is not None:
        return scenes.index(scene) if scene in scenes else None
    at, step = message.get("at"), message.get("step")
    number = at if step is None else step
    if isinstance(number, bool) or not isinstance(number, int) or (at is None) == (step is None):
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


def _output(state: SessionState, message: dict[str, Any], _t_ns: int) -> Reply:
    """Begins the file or folder `path`; an empty one ends what is running."""
    command, path = message["cmd"], message.get("path")
    option, what, typed = OUTPUTS[command]
    running = getattr(state.options, option)
    if not isinstance(path, str) or not (_absolute(path) or not path):
        raise BadMessage(f"{command} needs an absolute path, or an empty one to stop")
    if path and running:
        raise UserError(f"a {what} to {running} is already running", f"`{typed} stop` ends it")
    if not path and not running:
        raise UserError(f"no {what} is running", f"`{typed} start OUT` starts one")
    if not path:
        none: dict[str, Any] = {option: ""}
        return Reply({"path": running}, state.changed(**none))
    if command == "record" and not state.options.tracking and not state.options.mouse:
        raise UserError(
            "no camera is in use: the scene is a single view",
            "`lfpipe record OUT` records without a scene",
        )
    return Reply(
        check={
            "check": command,
            "path": path,
            "source": state.options.source,
            "record": state.options.record,
        }
    )


def _share(state: SessionState, message: dict[str, Any], _t_ns: int) -> Reply:
    """Adds the targets `start`, or removes the targets `stop` (all, if it is empty)."""
    start, stop, running = message.get("start"), message.get("stop"), state.options.share
    texts = stop if start is None else start
    if (
        (start is None) == (stop is None)
        or not isinstance(texts, list)
        or not all(isinstance(text, str) for text in texts)
    ):
        raise BadMessage("share needs a list of targets, either to start or to stop")
    if start is not None:
        if not start:
            raise UserError("no target given", FORMS)
        if len(start) > MAX_TARGETS:
            raise BadMessage(f"share: {len(start)} targets; at most {MAX_TARGETS} are allowed")
        if not state.options.tracking and not state.options.mouse:
            raise UserError(
                "no eyes are tracked: the scene is a single view",
                "use `lfpipe up --no-picture --share TARGET`",
            )
        return Reply(
            check={
                "check": "share",
                "path": ", ".join(start)[:200],
                "targets": start,
                "running": list(running),
            }
        )
    named = {
        text: [target for target in running if text in (target, target.partition("?")[0])]
        for text in texts
    }
    if missing := [text for text, targets in named.items() if not targets]:
        raise UserError(
            f"{printable(missing[0])}: not a current target",
            f"current targets: {', '.join(running) or 'none'}",
        )
    if not running:
        raise UserError("nothing is shared", "`lfpipe ctl share start TARGET` starts it")
    ended = [target for targets in named.values() for target in targets] or list(running)
    left = tuple(target for target in running if target not in ended)
    return Reply({"share": list(left)}, state.changed(share=left))


def respond_checked(
    state: SessionState, message: dict[str, Any], result: dict[str, Any], t_ns: int
) -> Reply:
    """The reply to a request after its files were checked. The state may have changed meanwhile. Raises like `respond`."""
    if message["cmd"] == "load":
        scene = SceneSummary(**result)
        at = _place(state, message)
        new = state.loaded(scene)
        if at is not None:
            new = attrs.evolve(new, options=attrs.evolve(new.options, playlist_at=at))
        return Reply({"pack": scene.pack}, new)
    respond(state, message, t_ns)  # another client may have started one
    if message["cmd"] == "share":
        share = tuple(dict.fromkeys((*state.options.share, *result["targets"])))
        return Reply({"share": list(share)}, state.changed(share=share))
    option, _, _ = OUTPUTS[message["cmd"]]
    return Reply({"path": message["path"]}, state.changed(**{option: message["path"]}))


def _absolute(path: str) -> bool:
    """Whether a path means the same for the supervisor as for its sender."""
    return path.startswith("/") and "\0" not in path


HANDLERS: dict[str, Handler] = {
    "hello": lambda state, _message, _t_ns: Reply(state.message()),
    "status": lambda state, _message, _t_ns: Reply(
        {"paused": state.paused, "config": config_module.to_dict(state.config)}, with_stages=True
    ),
    "set": _set,
    "pause": lambda state, _message, _t_ns: Reply({"paused": True}, state.changed(paused=True)),
    "resume": lambda state, _message, _t_ns: Reply({"paused": False}, state.changed(paused=False)),
    "recentre": lambda _state, _message, _t_ns: Reply(broadcast={"cmd": "recentre"}),
    "load": _load,
    "pictures": _pictures,
    "trace": _output,
    "record": _output,
    "share": _share,
    "stop": lambda _state, _message, _t_ns: Reply(stop=True),
}
