"""Targets of a session's eyes: `opentrack:HOST:PORT`, `osc:HOST:PORT` or `lsl[:NAME]`, each with an
optional `?rate=HZ`.
"""

import contextlib
import importlib
import socket
import unicodedata
from collections.abc import Callable, Sequence

import attrs

from lfpipe.errors import UserError, quoted
from lfpipe.host.worker import install_command

FORMS = (
    "use opentrack:HOST:PORT, osc:HOST:PORT or lsl[:NAME], with ?rate=HZ for predicted eyes at that"
    " rate"
)
LIBRARIES = {"opentrack": "", "osc": "pythonosc", "lsl": "pylsl"}  # kind -> module that it needs
MAX_TARGETS = 8  # each costs time per frame
MAX_RATE_HZ = 1000.0  # the rate of a fast mouse; no screen is faster
MAX_NAME = 64  # characters
NAME = "lfpipe"  # of LSL's streams


@attrs.frozen(kw_only=True)
class Target:
    """Where eyes are sent."""

    kind: str
    """A key of LIBRARIES."""
    host: str = ""
    port: int = 0
    """Of UDP, as host; a numeric address once checked."""
    name: str = ""
    """Of LSL's streams."""
    rate_hz: float = 0.0
    """Of predicted eyes; 0 sends those of every camera frame."""

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        where = self.name if self.kind == "lsl" else f"{host}:{self.port}"
        return f"{self.kind}:{where}" + (f"?rate={self.rate_hz:g}" if self.rate_hz else "")


def _refusal(text: str, why: str, remedy: str = FORMS) -> UserError:
    return UserError(f"--share {quoted(text)}: {why}", remedy)


def parse_target(text: str) -> Target:
    """Parses a target without resolving its host. Raises UserError."""
    body, query, options = text.partition("?")
    kind, colon, rest = body.partition(":")
    if kind not in LIBRARIES:
        raise _refusal(text, "unknown kind")
    rate_hz = 0.0
    if query:
        with contextlib.suppress(ValueError):
            key, _, value = options.partition("=")
            rate_hz = float(value) if key == "rate" else 0.0
        if not 1 <= rate_hz <= MAX_RATE_HZ:
            raise _refusal(text, f"{quoted(options)} is not rate=HZ of 1 to {MAX_RATE_HZ:g}")
    if kind == "lsl":
        name = rest if colon else NAME
        if not 0 < len(name) <= MAX_NAME or any(
            unicodedata.category(c) in ("Cc", "Cs") for c in name
        ):
            raise _refusal(text, f"a stream's name has 1 to {MAX_NAME} characters")
        return Target(kind=kind, name=name, rate_hz=rate_hz)
    host, colon, port = rest.rpartition(":")
    host = host[1:-1] if host.startswith("[") and host.endswith("]") else host
    if not host or not colon:
        raise _refusal(text, "no HOST:PORT")
    if not (port.isascii() and port.isdigit() and len(port) <= 5 and 0 < int(port) < 65536):
        raise _refusal(text, f"{quoted(port)} is not a port, 1 to 65535")
    return Target(kind=kind, host=host, port=int(port), rate_hz=rate_hz)


def check_target(text: str) -> Target:
    """Parses a target and checks that its library is installed and its host resolves and has a
    route.

    Sends nothing, except to look up a name. Raises UserError.
    """
    target = parse_target(text)
    module = LIBRARIES[target.kind]
    try:
        if module:
            importlib.import_module(module)
    except ModuleNotFoundError:
        raise _refusal(
            text, f"{module} is not installed", install_command("python-osc", "pylsl")
        ) from None
    except (ImportError, OSError, RuntimeError) as error:
        why = (
            f"{module} does not find its library:"
            f" {(str(error) or type(error).__name__).splitlines()[0]}"
        )
        raise _refusal(
            text,
            why,
            "install liblsl (its releases, or conda-forge), and set PYLSL_LIB to its path",
        ) from None
    return target if target.kind == "lsl" else attrs.evolve(target, host=_resolved(text, target))


def new_targets(
    texts: Sequence[str],
    running: Sequence[str] = (),
    parse: Callable[[str], Target] = parse_target,
) -> tuple[str, ...]:
    """Targets to add to those running, in their exact form. parse: `check_target` in a program that
    may wait for a name server. Raises UserError.
    """
    targets = list(running)
    for text in texts:
        exact = str(parse(text))
        if exact.partition("?")[0] in {target.partition("?")[0] for target in targets}:
            raise UserError(f"--share {text}: is a target already", "list each target once")
        targets.append(exact)
    if len(targets) > MAX_TARGETS:
        raise UserError(
            f"--share: {len(targets)} targets are too many; at most {MAX_TARGETS} are allowed",
            "let one program forward them",
        )
    return tuple(targets[len(running) :])


def _resolved(text: str, target: Target) -> str:
    try:
        addresses = socket.getaddrinfo(target.host, target.port, type=socket.SOCK_DGRAM)
        # most receivers listen on IPv4 only, even if a name (localhost) has both
        family, kind, _, _, address = min(addresses, key=lambda entry: entry[0] != socket.AF_INET)
        with socket.socket(family, kind) as probe:
            probe.connect(address)  # looks up a route; a datagram socket sends nothing for this
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else "not a host name"
        remedy = "use the name or address of the receiver, 127.0.0.1 for this machine"
        raise _refusal(text, f"{quoted(target.host)}: {why}", remedy) from None
    host = str(address[0])
    if socket.inet_pton(family, host.partition("%")[0]).strip(b"\0") == b"":
        raise _refusal(text, f"{host} is not an address to send to")
    return host
