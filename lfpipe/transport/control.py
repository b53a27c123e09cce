"""Control messages: msgpack maps in single-part ZeroMQ messages, checked before anybody looks inside.

    ctl   ROUTER bound by the supervisor; stages and commands are DEALERs; it takes the words of COMMANDS
    bus   PULL bound by the supervisor; stages PUSH telemetry, dropped when nobody takes it
    tap   XPUB bound by the supervisor; monitors subscribe to what happens

State is never sent over tap: `hello` answers with a snapshot. Every message carries the version "v".
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgpack
import zmq

from lfpipe.errors import UserError
from lfpipe.host import endpoints

VERSION = 1
MAX_BYTES = 64 * 1024
MAX_DEPTH = 8
FILE_CHECK_TIMEOUT_S = 15.0  # for an answer to `trace` and `record`, whose paths are looked at first
QUEUE = 64  # messages that wait on either side of a socket, per client
COMMANDS = ("hello", "status", "set", "pause", "resume", "recentre", "load", "pictures", "trace", "record", "share", "stop")


class BadMessage(ValueError):
    """Not a message of ours; the text says why and is sent back."""


def _depth(value: object, left: int = MAX_DEPTH) -> bool:
    if isinstance(value, dict):
        return left > 0 and all(isinstance(k, str) and _depth(v, left - 1) for k, v in value.items())
    if isinstance(value, list):
        return left > 0 and all(_depth(v, left - 1) for v in value)
    return value is None or isinstance(value, bool | int | float | str)


def encode(message: dict[str, Any]) -> bytes:
    """A map of plain values as bytes, with the version put in. Paths that are not UTF-8 travel as Python holds them.

    Raises BadMessage where it cannot be sent: other types, integers beyond 64 bits, more than MAX_BYTES.
    """
    try:
        data = bytes(msgpack.packb({"v": VERSION, **message}, unicode_errors="surrogateescape"))
    except (TypeError, ValueError, OverflowError) as error:  # UnicodeEncodeError is a ValueError
        raise BadMessage(f"not a map of plain values: {type(error).__name__}") from None
    if len(data) > MAX_BYTES:
        raise BadMessage(f"{len(data)} bytes; {MAX_BYTES} are allowed")
    return data


def decode(data: bytes) -> dict[str, Any]:
    """The map in data. Raises BadMessage for anything else: size, depth, types, version; never another exception."""
    if len(data) > MAX_BYTES:
        raise BadMessage(f"{len(data)} bytes; {MAX_BYTES} are allowed")
    try:
        message = msgpack.unpackb(data, raw=False, strict_map_key=True, max_ext_len=0, unicode_errors="surrogateescape")
    except Exception as error:  # msgpack raises half a dozen kinds for hostile bytes; all mean the same here
        raise BadMessage(f"not msgpack: {type(error).__name__}") from None
    if not isinstance(message, dict) or not _depth(message):
        raise BadMessage(f"not a map of plain values at most {MAX_DEPTH} deep")
    if message.get("v") != VERSION or message["v"] is True:
        raise BadMessage(f"version {message.get('v')!r}, {VERSION} is spoken here")
    return message


def context() -> zmq.Context[zmq.Socket[bytes]]:
    """A ZeroMQ context whose sockets never hold up an exit."""
    made: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    made.linger = 0
    return made


def limit(socket: zmq.Socket[bytes]) -> None:
    """Bounds what a socket that anybody may talk to holds: beyond MAX_BYTES an answer says so, beyond twice that none."""
    socket.setsockopt(zmq.MAXMSGSIZE, 2 * MAX_BYTES)
    socket.set_hwm(QUEUE)


def check_place(run_dir: Path, name: str) -> None:
    """Raises UserError where the path of a socket in the run directory is too long."""
    if length := endpoints.too_long(run_dir, name):
        raise UserError(
            f"{run_dir / name} has {length} characters, a socket takes {endpoints.LONGEST}",
            "a shorter --session name, or a shorter XDG_RUNTIME_DIR",
        )


def connect(socket: zmq.Socket[bytes], run_dir: Path, name: str) -> None:
    """Connects to the session's ctl, bus or tap. Raises UserError where the path is too long for a socket."""
    check_place(run_dir, name)
    endpoints.connect(socket, run_dir, name)


def request(run_dir: Path, message: dict[str, Any], timeout_s: float = 2.0) -> dict[str, Any]:
    """Sends one command to the session in run_dir and returns its answer.

    Raises UserError when nobody answers, or when the answer is an error.
    """
    with context() as ctx, ctx.socket(zmq.DEALER) as socket:
        connect(socket, run_dir, "ctl")
        remedy = "`lfpipe monitor --once` shows whether it runs"
        return exchange(socket, message, timeout_s, f"the session did not answer within {timeout_s:g} s", remedy)


def exchange(socket: zmq.Socket[bytes], message: dict[str, Any], timeout_s: float, silence: str, remedy: str) -> dict[str, Any]:
    """One command and its answer, over a socket that is connected. Raises UserError, with silence and remedy where none comes."""
    try:
        socket.send(encode(message))
    except BadMessage as error:
        raise UserError(f"{message['cmd']}: the request cannot be sent: {error}", "a shorter one, of plain values") from None
    if not socket.poll(int(timeout_s * 1000)):
        raise UserError(silence, remedy)
    answer = decode(socket.recv())
    if not answer.get("ok"):
        raise UserError(str(answer.get("error", "refused")), str(answer.get("remedy", "")))
    return answer
