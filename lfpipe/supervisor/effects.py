"""The parts of a running session: each `Service` waits for something and yields effects, which
`LiveSession` applies.
"""

import enum
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import attrs

from lfpipe.supervisor.control_sockets import Request
from lfpipe.supervisor.metrics import SessionMetrics
from lfpipe.supervisor.requests import Reply
from lfpipe.supervisor.session_state import SessionState
from lfpipe.transport.clock import MS_NS
from lfpipe.transport.control import Message

# Heartbeats are due as often, also while stages are idle; a descriptor wakes the loop sooner.
TICK_NS, IDLE_TICK_NS = 100 * MS_NS, 500 * MS_NS


@attrs.frozen
class Change:
    """Stores another state."""

    change: Callable[[SessionState], SessionState]


@attrs.frozen
class Respond:
    """Executes the reply to a request. An exception of `reply` becomes the answer."""

    request: Request
    reply: Callable[[SessionState], Reply]


@attrs.frozen
class Answer:
    """Answers a request."""

    request: Request
    answer: Message


@attrs.frozen
class Publish:
    """Sends a message to every subscriber of the tap."""

    topic: str
    values: dict[str, Any]


@attrs.frozen
class Notify:
    """Notifies the user, and logs it. The text may quote anything."""

    text: str


class EndKind(enum.Enum):
    """The cause of a session's end."""

    SOURCE_ENDED = enum.auto()
    DURATION = enum.auto()
    REQUEST = enum.auto()
    SIGNAL = enum.auto()
    FAILURE = enum.auto()


@attrs.define(kw_only=True)
class Outcome:
    """The end of a session; as an effect, it ends the session."""

    kind: EndKind
    reason: str
    """In a few words."""
    signum: int = 0
    """The signal, if that is the cause."""
    failure: str | None = None
    """The message for the user; None for a normal end."""
    remedy: str = ""
    user_error: bool = False
    """Whether a restart cannot help until the user has changed something."""
    final: SessionMetrics | None = None
    """The state at the end."""


Effect = Change | Respond | Answer | Publish | Notify | Outcome


class Service:
    """A part of a running session."""

    guarded = False
    """Whether an error of `update` is only logged, because it handles messages from outside."""

    @property
    def fds(self) -> Sequence[int]:
        """Descriptors that wake the supervisor."""
        return ()

    def wait_ns(self, t_ns: int) -> int | None:
        """The time until `update` must be called, if it has a deadline. t_ns: now."""
        return None

    def update(self, state: SessionState, t_ns: int) -> Iterable[Effect]:
        """The effects since the last call. state: the current one. t_ns: now."""
        return ()
