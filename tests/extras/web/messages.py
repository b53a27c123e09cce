"""Refusals of the page."""

from lfpipe.extras.web.server import parse_address
from tests.test_messages import Cause

MESSAGES: dict[str, tuple[Cause, str]] = {
    "an address without a port": (
        lambda here: parse_address("host:"),
        "--web 'host:': not a port … --web :9108",
    ),
}
