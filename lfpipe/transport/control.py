"""A session for others: the names of its directory, and of the lock, memory, FIFOs and sockets in
it, made by the supervisor; and control messages: msgpack maps in single-part ZeroMQ
messages, checked before use.

    ctl   of the supervisor, answered by `supervisor/requests.py`; stages and commands are DEALERs
    bus   of the supervisor; stages PUSH telemetry, which is dropped if nobody receives it
    tap   of the supervisor; monitors SUB to events, all or none

State is never sent over tap: `hello` answers with a snapshot. Every message carries the version
"v".
"""

import json
import os
import re
import time
from pathlib import Path
from typing import Any

import attrs
import msgpack
import zmq

from lfpipe.errors import UserError
from lfpipe.files.safe_files import write_file
from lfpipe.host.files import SHM_DIR, is_dir
from lfpipe.transport.ring import now_ns

PREFIX = f"lfpipe-{os.getuid()}-"  # of the directories, to separate users
LIVE = f"{PREFIX}live-"  # of those of live scenes, which no session has: names contain no "-"
MANIFEST = "session.json"  # in the directory of a session


def base_dir() -> Path:
    """Parent of the directories: LFPIPE_RUN_DIR; by default /dev/shm, whose files are memory, or
    where there is none, XDG_RUNTIME_DIR or /tmp. Raises UserError if it is not an absolute path.
    """
    # short: the path of a socket has at most 107 bytes, on macOS 103
    usual = SHM_DIR if is_dir(SHM_DIR) else os.environ.get("XDG_RUNTIME_DIR") or "/tmp"
    text = os.environ.get("LFPIPE_RUN_DIR") or str(usual)
    if not Path(text).is_absolute():
        raise UserError(
            f"LFPIPE_RUN_DIR={text!r} is not an absolute path",
            "set it to a directory of your own, or unset it",
        )
    return Path(text)


def _check_name(name: str, setting: str) -> None:
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.]{0,31}", name):
        raise UserError(
            f"{setting} is not a valid name",
            "use 1 to 32 letters, digits, _ and ., beginning with a letter or digit",
        )


@attrs.frozen
class Session:
    """The names of one session."""

    name: str = attrs.field()

    @name.validator
    def _check(self, _: object, value: str) -> None:
        _check_name(value, f"--session {value!r}")

    @property
    def run(self) -> str:
        """Unique id of this run of the session, for other programs. Raises FileNotFoundError."""
        manifest = SessionManifest.read(self.run_dir)
        return f"{self.name}.{manifest.pid}.{manifest.started_ns}"

    @property
    def run_dir(self) -> Path:
        return base_dir() / f"{PREFIX}{self.name}"

    def segment(self, ring: str) -> Path:
        """The file of a segment. ring: its name, or "status"."""
        return self.run_dir / (ring if ring == "status" else f"{ring}.ring")

    def wake(self, ring: str, reader: str) -> Path:
        """FIFO with which the writer of ring wakes reader."""
        return self.run_dir / f"wake.{ring}.{reader}"

    def credit(self, ring: str, reader: str) -> Path:
        """FIFO with which reader reports to the writer of ring that it has read a slot, in lossless
        sessions.
        """
        return self.run_dir / f"credit.{ring}.{reader}"


@attrs.frozen(kw_only=True)
class SessionManifest:
    """The file `session.json` in the run directory of a running session."""

    session: str
    """Its name."""
    pid: int
    """Of the supervisor."""
    started_ns: int
    """By CLOCK_MONOTONIC."""
    started: str
    """The same time by the wall clock."""
    options: dict[str, Any]
    """`SessionOptions` at its start, as plain values."""

    @classmethod
    def begin(cls, session: Session, options: dict[str, Any]) -> "SessionManifest":
        """Writes the manifest of a session that starts now in this process."""
        manifest = cls(
            session=session.name,
            pid=os.getpid(),
            started_ns=now_ns(),
            started=time.strftime("%Y-%m-%dT%H:%M:%S%z"),
            options=options,
        )
        write_file(session.run_dir / MANIFEST, json.dumps(attrs.asdict(manifest)).encode())
        return manifest

    @classmethod
    def read(cls, run_dir: Path) -> "SessionManifest":
        """The manifest of the session that runs there. Raises FileNotFoundError."""
        return cls(**json.loads((run_dir / MANIFEST).read_text()))


def default_name() -> str:
    """The session that commands use by default.

    Raises UserError if LFPIPE_SESSION is not a valid name.
    """
    name = os.environ.get("LFPIPE_SESSION") or "default"
    _check_name(name, f"LFPIPE_SESSION={name!r}")
    return name


VERSION = 2
MAX_BYTES = 64 * 1024  # a playlist of hundreds of scenes fits
MAX_DEPTH = 8  # the snapshot needs 4
FILE_CHECK_TIMEOUT_S = 15.0  # for an answer to a request that opens a file or a camera
LOAD_TIMEOUT_S = 900.0  # to a request that packs a large scene
EXECUTED = "executed"  # with it, a stage answers a command that it has executed
MAX_ID_BYTES = 64  # of the id of a request
Message = dict[str, Any]  # plain values by name


@attrs.frozen(kw_only=True)
class Answer:
    """The answer to a request."""

    cmd: str
    """The command of the request."""
    ok: bool
    error: str
    """Reason of a refusal; "" otherwise."""
    remedy: str
    values: Message
    """The whole answer, with the fields of its command."""

    @classmethod
    def of(cls, message: Message) -> "Answer":
        """The answer in a message."""
        return cls(
            cmd=str(message.get("cmd", "")),
            ok=message.get("ok") is True,
            error=str(message.get("error", "")),
            remedy=str(message.get("remedy", "")),
            values=message,
        )


class BadMessage(ValueError):
    """An invalid message; the text explains why and is sent back."""


def _depth(value: object, left: int = MAX_DEPTH) -> bool:
    if isinstance(value, dict):
        return left > 0 and all(
            isinstance(k, str) and _depth(v, left - 1) for k, v in value.items()
        )
    if isinstance(value, list):
        return left > 0 and all(_depth(v, left - 1) for v in value)
    return value is None or isinstance(value, bool | int | float | str)


def encode(message: Message) -> bytes:
    """Encodes a map of plain values, adding the version. Paths that are not UTF-8 are encoded with
    surrogates, as in Python.

    Raises BadMessage if it cannot be sent: other types, integers beyond 64 bits, more than
    MAX_BYTES.
    """
    try:
        data = bytes(msgpack.packb({"v": VERSION, **message}, unicode_errors="surrogateescape"))
    except (TypeError, ValueError, OverflowError) as error:  # UnicodeEncodeError is a ValueError
        raise BadMessage(
            f"the message is not a map of plain values: {type(error).__name__}"
        ) from None
    if len(data) > MAX_BYTES:
        raise BadMessage(f"the message has {len(data)} bytes; at most {MAX_BYTES} are allowed")
    return data


def decode(data: bytes) -> Message:
    """Decodes and checks the map in data.

    Raises BadMessage for a wrong size, depth, type or version; never another exception.
    """
    message = unpack(data)
    check(message)
    return message


def unpack(data: bytes) -> Message:
    """Decodes the map in data, unchecked. Raises BadMessage if there is none."""
    if len(data) > MAX_BYTES:
        raise BadMessage(f"the message has {len(data)} bytes; at most {MAX_BYTES} are allowed")
    try:
        message = msgpack.unpackb(
            data, raw=False, strict_map_key=True, max_ext_len=0, unicode_errors="surrogateescape"
        )
    # msgpack raises several types for hostile bytes; all mean the same here
    except Exception as error:
        raise BadMessage(f"the message is not msgpack: {type(error).__name__}") from None
    if not isinstance(message, dict):
        raise BadMessage("the message is not a map of plain values")
    return message


def check(message: Message) -> None:
    """Raises BadMessage for a wrong depth, type or version."""
    if not _depth({key: value for key, value in message.items() if key != "id"}):
        raise BadMessage(
            f"the message is not a map of plain values with at most {MAX_DEPTH} levels"
        )
    if message.get("v") != VERSION or message["v"] is True:
        raise BadMessage(f"the message has version {message.get('v')!r:.100}, expected {VERSION}")
    if not _is_id(message.get("id")):
        raise BadMessage(
            f"an id is one number, text or byte string of at most {MAX_ID_BYTES} bytes"
        )


def _is_id(value: object) -> bool:
    data = value.encode(errors="surrogateescape") if isinstance(value, str) else value
    if isinstance(data, bytes):
        return len(data) <= MAX_ID_BYTES
    return data is None or isinstance(data, bool | int | float)


def repeated(message: Message) -> Message:
    """The fields of a message that its answer repeats: `cmd` and `id`, if they are valid."""
    command = message.get("cmd")
    head = {"cmd": command} if isinstance(command, str) and _is_id(command) else {}
    return {**head, "id": message["id"]} if _is_id(message.get("id", [])) else head


def context() -> zmq.Context[zmq.Socket[bytes]]:
    """A ZeroMQ context whose sockets never delay an exit."""
    ctx: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    ctx.linger = 0
    return ctx


def connect(socket: zmq.Socket[bytes], run_dir: Path, name: str) -> None:
    """Connects to the session's ctl, bus or tap: Unix sockets in its run directory, which only its
    user may enter. If there is none, messages wait.
    """
    socket.connect(f"ipc://{run_dir / name}")


def request(run_dir: Path, message: Message, timeout_s: float = 2.0) -> Message:
    """Sends one command to the session in run_dir and returns its answer.

    Raises UserError if there is no answer, if the session ends meanwhile, or if the answer is an
    error.
    """
    try:
        data = encode(message)
    except BadMessage as error:
        raise UserError(
            f"{message.get('cmd')}: the request cannot be sent: {error}",
            "use a shorter one with plain values",
        ) from None
    remedy = "check whether it is running: `lfpipe monitor --once`"
    with (
        context() as ctx,
        ctx.socket(zmq.DEALER) as socket,
        socket.get_monitor_socket(zmq.EVENT_DISCONNECTED) as end,
    ):
        connect(socket, run_dir, "ctl")
        socket.send(data)
        if not zmq.select([socket, end], [], [], timeout_s)[0]:
            raise UserError(f"the session did not answer within {timeout_s:g} s", remedy)
        if not socket.poll(0):  # its last answer may have come with the end
            raise UserError("the session ended before it answered", remedy)
        answer = Answer.of(decode(socket.recv()))
    if not answer.ok:
        raise UserError(answer.error or "refused", answer.remedy)
    return answer.values
