"""Independent receivers: python-osc's server, liblsl's inlets, and opentrack's documented
layout.
"""

import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pythonosc.dispatcher import Dispatcher
from pythonosc.osc_server import BlockingOSCUDPServer

# LSL looks for streams by multicast on every network; in tests it stays on this machine.
LSL_CONFIG = """
[multicast]
ResolveScope = machine
[lab]
KnownPeers = {127.0.0.1}
[log]
level = -3
"""


def free_port() -> int:
    """A free UDP port of 127.0.0.1."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def lsl_environment(folder: Path) -> dict[str, str]:
    """Environment that keeps liblsl on this machine."""
    path = folder / "lsl_api.cfg"
    path.write_text(LSL_CONFIG)
    return {"LSLAPICFG": str(path)}


class OpentrackReceiver:
    """opentrack's UDP input: six little-endian doubles, x, y, z in cm and yaw, pitch, roll in
    degrees (its README and wiki).
    """

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._socket.bind(("127.0.0.1", port))
        self._socket.settimeout(60)

    def poses(self, count: int) -> list[tuple[float, ...]]:
        """The next count poses, each from one datagram of exactly 48 bytes."""
        found = []
        for _ in range(count):
            data, _ = self._socket.recvfrom(1 << 16)
            assert len(data) == 48
            found.append(struct.unpack("<dddddd", data))
        return found

    def close(self) -> None:
        self._socket.close()


@contextmanager
def osc_server(port: int) -> Iterator[list[tuple[str, tuple[Any, ...]]]]:
    """python-osc's server: all that comes, as (address, values)."""
    heard: list[tuple[str, tuple[Any, ...]]] = []
    dispatcher = Dispatcher()
    dispatcher.set_default_handler(lambda address, *values: heard.append((address, values)))
    with BlockingOSCUDPServer(("127.0.0.1", port), dispatcher) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
        thread.start()
        try:
            yield heard
        finally:
            server.shutdown()
            thread.join(60)
