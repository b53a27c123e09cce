"""The command `share` as pure functions, and its check in a child process."""

from typing import Any

import attrs
import pytest

from lfpipe.config.modes import MouseViewer
from lfpipe.extras.share.requests import check
from lfpipe.supervisor.file_checks import FileCheck
from lfpipe.supervisor.requests import Reply, respond, respond_checked
from tests.supervisor.states import VIEWER, made_state
from tests.supervisor.test_requests import reply_to

Message = dict[str, Any]
TARGETS = ("osc:127.0.0.1:9000?rate=60", "lsl:lab")


@pytest.mark.parametrize(
    ("targets", "words", "wrong"),
    [
        ((), "list of targets", [{"start": ["lsl"], "stop": []}]),
        ((), "list of targets", [{"start": "lsl"}, {"stop": [5]}]),
        ((), "no target given", [{"start": []}]),
        ((), "nothing is shared", [{"stop": []}]),
        ((), "9 targets", [{"start": ["lsl"] * 9}]),
        (TARGETS, "osc:127.0.0.1:1", [{"stop": ["osc:127.0.0.1:1"]}]),
    ],
)
def test_share_refusals_are_short(
    targets: tuple[str, ...], words: str, wrong: list[Message]
) -> None:
    for sent in wrong:
        refusal = reply_to(made_state(extras={"share": targets}), {"cmd": "share", **sent})
        assert isinstance(refusal, str) and words in refusal and len(refusal) < 4000, sent


def test_share_without_targets_lists_them() -> None:
    reply = respond(made_state(extras={"share": TARGETS}), {"cmd": "share"}, 0)
    assert reply == Reply(answer={"share": list(TARGETS)})


def test_share_has_targets_checked_by_a_child() -> None:
    for viewer in (VIEWER, MouseViewer()):
        state = made_state(viewer=viewer)
        reply = respond(state, {"cmd": "share", "start": ["/x", "/y"]}, 0)
        asked = FileCheck(
            check="share", path="/x, /y", values={"targets": ("/x", "/y"), "running": ()}
        )
        assert reply == Reply(check=asked)
    asked = attrs.evolve(asked, values={"targets": ("osc:localhost:9",), "running": TARGETS})
    assert check(asked) == {"targets": ["osc:127.0.0.1:9"]}


@pytest.mark.parametrize(
    ("message", "result", "left"),
    [
        (
            {"start": ["opentrack:h:1"]},
            {"targets": ["opentrack:10.0.0.1:1"]},
            (*TARGETS, "opentrack:10.0.0.1:1"),
        ),
        ({"stop": ["osc:127.0.0.1:9000"]}, None, ("lsl:lab",)),
        ({"stop": []}, None, ()),
    ],
)
def test_share_changes_the_targets_and_nothing_else(
    message: Message, result: Message | None, left: tuple[str, ...]
) -> None:
    state = made_state(extras={"share": TARGETS, "other": ("x",)})
    asked = {"cmd": "share", **message}
    reply = respond(state, asked, 0) if result is None else respond_checked(state, asked, result, 0)
    assert reply.answer == {"share": list(left)} and reply.state is not None
    after, before = attrs.asdict(reply.state.options), attrs.asdict(state.options)
    assert after["extras"] == {"share": left, "other": ("x",)}
    assert {key for key in after if after[key] != before[key]} <= {
        "extras",
        "packets",
        "asked_for",
    }


def test_ring_of_shown_pictures_exists_while_a_stream_has_pictures() -> None:
    def names(*targets: str) -> set[str]:
        return set(made_state(extras={"share": targets}).rings())

    assert names("lsl:lab") == {"shown"}
    assert names() == names("osc:127.0.0.1:9000") == set()
