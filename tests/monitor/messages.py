"""Refusals of monitors, and timelines."""

from lfpipe.monitor.monitor import convert
from lfpipe.monitor.session_reader import Watch
from lfpipe.transport.control import Session
from tests.test_messages import Cause

MESSAGES: dict[str, tuple[Cause, str]] = {
    "a session that is starting": (
        lambda here: Watch(Session("nobody")),
        "session 'nobody' is starting or ending … try again",
    ),
    "a trace that is gone": (
        lambda here: convert(here / "gone", here / "out.json"),
        "/here/gone: cannot be read: No such file … `lfpipe up --trace`",
    ),
}
