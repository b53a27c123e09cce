"""The control command `share`; the protocol is `supervisor.requests.RequestPlugin`."""

from lfpipe.errors import UserError, quoted
from lfpipe.extras.share.target import FORMS, MAX_TARGETS, new_targets
from lfpipe.supervisor.requests import Reply, has_eyes
from lfpipe.supervisor.session_state import SessionState
from lfpipe.transport.control import BadMessage, Message

NAME = "share"


def _with(state: SessionState, targets: tuple[str, ...]) -> SessionState:
    return state.changed(extras={**state.options.extras, NAME: targets})


def respond(state: SessionState, message: Message, _t_ns: int) -> Reply:
    """Adds the targets `start`, or removes the targets `stop` (all, if it is empty); with neither,
    only answers.
    """
    start = message.get("start")
    stop = message.get("stop")
    running = state.options.extra(NAME)
    if start is None and stop is None:
        return Reply(answer={"share": list(running)})
    texts = stop if start is None else start
    if (
        None not in (start, stop)
        or not isinstance(texts, list)
        or not all(isinstance(text, str) for text in texts)
    ):
        raise BadMessage("share needs a list of targets, either to start or to stop")
    if start is not None:
        if not start:
            raise UserError("no target given", FORMS)
        if len(start) > MAX_TARGETS:
            raise BadMessage(f"share: {len(start)} targets; at most {MAX_TARGETS} are allowed")
        if not has_eyes(state):
            raise UserError(
                "no eyes are tracked: the scene is a single view",
                "use `lfpipe up --no-picture --share TARGET`",
            )
        share = (*running, *new_targets(start, running))
        return Reply(answer={"share": list(share)}, state=_with(state, share))
    if not running:
        raise UserError("nothing is shared", "start it with `lfpipe ctl share start TARGET`")
    named = {target: {target, target.partition("?")[0]} for target in running}
    if unknown := [text for text in texts if not any(text in one for one in named.values())]:
        raise UserError(
            f"{quoted(unknown[0])} is not a current target", f"use one of {', '.join(running)}"
        )
    left = tuple(target for target in running if texts and named[target].isdisjoint(texts))
    return Reply(answer={"share": list(left)}, state=_with(state, left))
