"""Who may use the page: holders of its token, from the page itself. On a shared machine every user reaches 127.0.0.1."""

from __future__ import annotations

import functools
import hmac
import ipaddress
import secrets
import socket
from collections.abc import Iterable

from lfpipe.errors import UserError

LOOPBACK = "127.0.0.1"
NO_TOKEN = "the token is missing or wrong: open the address that `lfpipe monitor --web` printed, it ends in /?token=..."
NOT_OURS = "a request for this server's own address, from its own page, is expected"


def parse_address(text: str, option: str) -> tuple[str, int]:
    """`[HOST]:PORT` or PORT as (host, port), host 127.0.0.1 where none is named. Raises UserError, which names the option."""
    host, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdigit() and len(port) <= 5 and int(port) <= 65535):
        raise UserError(f"{option} {text!r}: no port from 0 to 65535", f"for example {option} :9108")
    return host.removeprefix("[").removesuffix("]") or LOOPBACK, int(port)


def url_of(host: str, port: int) -> str:
    """The address of a server, for a browser: a server on all interfaces goes by the name of the machine."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return f"http://{host}:{port}"
    if address.is_unspecified:
        return f"http://{socket.gethostname()}:{port}"
    return f"http://[{host}]:{port}" if address.version == 6 else f"http://{host}:{port}"


@functools.lru_cache(64)
def named(host_header: str, bound: str) -> bool:
    """Whether a Host header names a server bound to `bound` by an IP address, as localhost, or by its own name.

    Another name was pointed at this machine by a stranger, whose page could then read the answers (DNS rebinding).
    """
    name = host_header.rpartition(":")[0] if host_header.rpartition(":")[2].isdigit() else host_header
    name = name.lower()
    if name in ("localhost", bound.lower(), socket.gethostname().lower()):
        return True
    try:
        ipaddress.ip_address(name.removeprefix("[").removesuffix("]"))
    except ValueError:
        return False
    return True


def same_origin(origin: str | None, host_header: str) -> bool:
    """Whether the page that sent a request came from the server that receives it: cookies ignore ports."""
    return origin is None or origin == f"http://{host_header}"


class Access:
    """The token of one server, 256 random bits, and the cookie that keeps it.

    Browsers send a cookie to every port of a host, so also to servers of other users on this machine. Its path is therefore
    random, too: nobody else's page has an address below it.
    """

    def __init__(self) -> None:
        self.token = secrets.token_urlsafe(32)
        self.path = f"/{secrets.token_urlsafe(16)}/"

    def opens(self, offered: Iterable[str]) -> bool:
        """Whether one of the texts is the token; takes the same time for every wrong one."""
        wanted = self.token.encode()
        return any([hmac.compare_digest(one.encode(errors="replace"), wanted) for one in offered])
