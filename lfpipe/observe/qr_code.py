"""The address of a page as a QR code in the terminal, for phones in the room."""

import io
import ipaddress
import socket

import segno

from lfpipe.observe.access import url_of


def is_reachable(host: str) -> bool:
    """Whether other machines can reach a server bound to host."""
    try:
        return not ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host != "localhost"


def phone_url(host: str, port: int) -> str:
    """The address of a server for a phone, which cannot resolve this machine's name. For a server on all interfaces, it is the
    address of the outgoing interface."""
    try:
        unspecified = ipaddress.ip_address(host).is_unspecified
    except ValueError:
        unspecified = False
    if not unspecified:
        return url_of(host, port)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # a documentation address; connecting a datagram socket sends nothing
            return url_of(str(probe.getsockname()[0]), port)
        except OSError:  # no network
            return url_of(host, port)


def qr_lines(text: str) -> str:
    """text as a QR code of half-block characters, two rows of modules per line, for a dark terminal."""
    out = io.StringIO()
    segno.make(text, error="l", micro=False).terminal(out, border=2, compact=True)
    return out.getvalue().rstrip("\n")
