"""Refusals of targets."""

from lfpipe.config.session_options import NoViewer
from lfpipe.extras.share.target import FORMS, check_target, new_targets
from lfpipe.supervisor.requests import respond
from tests.supervisor.states import made_state
from tests.test_messages import Cause


def of(text: str) -> Cause:
    """Checks one target."""
    return lambda here: check_target(text)


MESSAGES: dict[str, tuple[Cause, str]] = {
    "no kind": (of(""), f"--share '': unknown kind … {FORMS}"),
    "no host": (
        of("opentrack:127.0.0.1"),
        f"--share 'opentrack:127.0.0.1': no HOST:PORT … {FORMS}",
    ),
    "port 0": (of("osc:127.0.0.1:0"), f"--share 'osc:127.0.0.1:0': '0' is not a port … {FORMS}"),
    "every address": (
        of("osc:[::]:9000"),
        f"--share 'osc:[::]:9000': :: is not an address to send to … {FORMS}",
    ),
    "broadcast": (
        of("osc:255.255.255.255:9000"),
        "--share 'osc:255.255.255.255:9000': … Permission denied … 127.0.0.1 for this",
    ),
    "no rate": (
        of("osc:127.0.0.1:9000?rate=nan"),
        f"--share 'osc:127.0.0.1:9000?rate=nan': … rate=HZ of 1 to 1000 … {FORMS}",
    ),
    "two lines": (
        of("lsl:a\nb"),
        f"--share 'lsl:a\\nb': a stream's name has 1 to 64 characters … {FORMS}",
    ),
    "twice": (
        lambda here: new_targets(["lsl", "lsl:lfpipe?rate=60"]),
        "--share lsl:lfpipe?rate=60: is a target already … once",
    ),
    "nothing to share": (
        lambda here: respond(made_state(viewer=NoViewer()), {"cmd": "share", "start": ["lsl"]}, 0),
        (
            "no eyes are tracked: the scene is a single view\n  remedy: use `lfpipe up --no-picture"
            " --share TARGET`"
        ),
    ),
    "nine": (
        lambda here: new_targets([f"osc:127.0.0.1:{9000 + k}" for k in range(9)]),
        "--share: 9 targets are too many; at most 8 … forward them",
    ),
}
