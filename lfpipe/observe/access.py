"""Access control of the page: requests need its token and must come from the page itself. Any local user reaches 127.0.0.1."""

import functools
import hmac
import ipaddress
import secrets
import socket
from collections.abc import Iterable

from lfpipe.errors import UserError

LOOPBACK = "127.0.0.1"
NO_TOKEN = "the token is missing or wrong: open the address that `lfpipe monitor --web` printed; it ends in /?token=..."
NOT_OURS = "requests must be for this server's own address and come from its own page"


def parse_address(text: str, option: str) -> tuple[str, int]:
    """`[HOST]:PORT` or PORT as (host, port); host defaults to 127.0.0.1. Raises UserError with the option's name."""
    host, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdigit() and len(port) <= 5 and int(port) <= 65535):
        raise UserError(f"{option} {text!r}: not a port from 0 to 65535", f"for example: {option} :9108")
    return host.removeprefix("[").removesuffix("]") or LOOPBACK, int(port)


def url_of(host: str, port: int) -> str:
    """The address of a server, for a browser; a server on all interfaces is named by the outgoing one, for phones."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return f"http://{host}:{port}"
    if address.is_unspecified:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.connect(("192.0.2.1", 9))  # a documentation address; connecting a datagram socket sends nothing
                return f"http://{probe.getsockname()[0]}:{port}"
            except OSError:  # no network
                return f"http://{socket.gethostname()}:{port}"
    return f"http://[{host}]:{port}" if address.version == 6 else f"http://{host}:{port}"


@functools.lru_cache(64)
def named(host_header: str, bound: str) -> bool:
    """Whether a Host header names a server bound to `bound` by an IP address, as localhost, or by its own name.

    Any other name may be an attacker's, pointed at this machine so that the attacker's page can read answers (DNS rebinding).
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
    """The token of one server, 256 random bits, and the cookie that stores it.

    Browsers send a cookie to every port of a host, so also to servers of other users on this machine. The path of the cookie
    is therefore random too: no other server has an address below it.
    """

    def __init__(self) -> None:
        self.token = secrets.token_urlsafe(32)
        self.path = f"/{secrets.token_urlsafe(16)}/"

    def opens(self, offered: Iterable[str]) -> bool:
        """Whether one of the texts is the token. The comparison takes constant time."""
        wanted = self.token.encode()
        return any([hmac.compare_digest(one.encode(errors="replace"), wanted) for one in offered])
