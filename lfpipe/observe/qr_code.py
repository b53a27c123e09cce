"""The address of a page as a QR code in the terminal, for the phones in a class-room."""

from __future__ import annotations

import io
import ipaddress
import socket

import segno

from lfpipe.observe.access import url_of


def is_reachable(host: str) -> bool:
    """Whether a server bound to host answers other machines."""
    try:
        return not ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host != "localhost"


def phone_url(host: str, port: int) -> str:
    """The address of a server for a phone, which does not know this machine's name: one on all interfaces goes by the address of
    the interface that leads out."""
    try:
        unspecified = ipaddress.ip_address(host).is_unspecified
    except ValueError:
        unspecified = False
    if not unspecified:
        return url_of(host, port)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # of the addresses for documentation; a datagram socket sends nothing yet
            return url_of(str(probe.getsockname()[0]), port)
        except OSError:  # no network
            return url_of(host, port)


def qr_lines(text: str) -> str:
    """text as a QR code of half blocks, two rows of modules a line, dark on light where the terminal is dark."""
    out = io.StringIO()
    segno.make(text, error="l", micro=False).terminal(out, border=2, compact=True)
    return out.getvalue().rstrip("\n")
