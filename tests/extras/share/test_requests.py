"""The command `share` as pure functions."""

from typing import Any

import attrs
import pytest

from lfpipe.supervisor.requests import respond
from tests.supervisor.states import made_state

Message = dict[str, Any]
TARGETS = ("osc:127.0.0.1:9000?rate=60", "lsl:lab")


@pytest.mark.parametrize(
    ("message", "left"),
    [
        ({"start": ["opentrack:10.0.0.1:1"]}, (*TARGETS, "opentrack:10.0.0.1:1")),
        ({"stop": ["osc:127.0.0.1:9000"]}, ("lsl:lab",)),
        ({"stop": []}, ()),
    ],
)
def test_share_changes_the_targets_and_nothing_else(
    message: Message, left: tuple[str, ...]
) -> None:
    state = made_state(extras={"share": TARGETS, "other": ("x",)})
    reply = respond(state, {"cmd": "share", **message}, 0)
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
