"""Who may talk to the page's server: this user on this machine, from the page itself and no other."""

from __future__ import annotations

import os
from pathlib import Path

TCP = Path("/proc/net/tcp")


def owner(address: tuple[str, int], table: str | None = None) -> int | None:
    """User id of who has the IPv4 socket at address (host, port) on this machine; None where the kernel knows none."""
    quads = bytes(int(part) for part in address[0].split("."))
    wanted = f"{int.from_bytes(quads, 'little'):08X}:{address[1]:04X}"
    for line in (TCP.read_text() if table is None else table).splitlines()[1:]:
        fields = line.split()
        if fields[1] == wanted and fields[3] == "01":  # ESTABLISHED
            return int(fields[7])
    return None


def same_user(address: tuple[str, int]) -> bool:
    """Whether the client at address is this user, or root: on a shared machine 127.0.0.1 is everybody's."""
    return owner(address) in (os.getuid(), 0)


def own_page(host: str, origin: str | None, port: int) -> bool:
    """Whether a request names this server and comes from its own page: another site in the same browser may not command it,
    and a name that someone points at 127.0.0.1 may not read it."""
    allowed = {f"{name}:{port}" for name in ("127.0.0.1", "localhost")}
    return host in allowed and (origin is None or origin.removeprefix("http://") in allowed)
