"""Keys for control over a network: CURVE (RFC 26), both ends known to each other by their public keys.

A folder of keys holds, each as one line of Z85 text:

    server.public   server.secret    of the session's side
    client.public   client.secret    of who drives it
    clients/NAME.public              who may drive it; a file taken away is a client shut out from its next connection on

Secrets are readable by their owner alone; a folder of another's is refused.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import platformdirs
import zmq
from zmq.utils import z85

from lfpipe.errors import UserError
from lfpipe.transport import control

KEY_CHARACTERS = 40
MAKE = "`lfpipe keys new` makes them"


def folder(named: str = "") -> Path:
    """Where keys are kept: the folder that is named, or the user's."""
    return Path(named).expanduser() if named else Path(platformdirs.user_config_dir("lfpipe")) / "keys"


def _require() -> None:
    if not zmq.has("curve"):
        raise UserError(
            f"libzmq {zmq.zmq_version()} was built without CURVE", "install pyzmq from its wheel; it brings a libzmq that has it"
        )


def _write(path: Path, key: bytes, mode: int) -> None:
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
        file.write(key + b"\n")


def make_keys(folder: Path) -> list[Path]:
    """Makes a pair for a server and one for a client that it lets in; returns the files.

    Raises UserError where there are keys already, or the folder cannot be written to.
    """
    _require()
    made = []
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        there = sorted(folder.glob("*.secret"))
        if there:
            raise UserError(
                f"{there[0]} is there already", "take the old keys away first: who holds a copy of them is shut out by that"
            )
        folder.chmod(0o700)
        (folder / "clients").mkdir(mode=0o700, exist_ok=True)
        for name in ("server", "client"):
            public, secret = zmq.curve_keypair()
            named = {folder / f"{name}.secret": secret, folder / f"{name}.public": public}
            if name == "client":
                named[folder / "clients" / "client.public"] = public
            for path, key in named.items():
                path.unlink(missing_ok=True)
                _write(path, key, 0o600)
                made.append(path)
    except OSError as error:
        raise UserError(f"{error.filename or folder}: {error.strerror}", "a folder that you may write to") from None
    return made


def _read(path: Path, secret: bool = False) -> bytes:
    """The key in path. Raises UserError where there is none, where it is no key, or a secret that others may read."""
    try:
        found = path.stat()
        key = path.read_bytes().strip()
    except OSError as error:
        raise UserError(f"{path}: {error.strerror}", MAKE) from None
    if secret and (found.st_uid != os.getuid() or found.st_mode & 0o077):
        raise UserError(f"{path} is not yours alone", f"chmod 600 {path}, or new keys if others have seen it: {MAKE}")
    try:
        if len(key) != KEY_CHARACTERS:
            raise ValueError
        z85.decode(key)
    except (ValueError, KeyError):
        raise UserError(f"{path}: not a key", MAKE) from None
    return key


def allowed(folder: Path) -> dict[str, bytes]:
    """name -> public key of every client that may come in. Raises UserError where a file is no key."""
    return {path.stem: _read(path) for path in sorted((folder / "clients").glob("*.public"))}


def check_bind(bind: str, folder: Path) -> str:
    """The network address that `control.bind` asks for, empty for none.

    Raises UserError where it is neither `ipc` nor tcp://HOST:PORT, or where there are no keys: without them nobody may drive.
    """
    if bind == "ipc":
        return ""
    if not (match := re.fullmatch(r"tcp://[^\s/:@]+:(\d{1,5})|tcp://\[[0-9a-fA-F:]+\]:(\d{1,5})", bind)) or not (
        0 < int(match[1] or match[2]) < 65536
    ):
        raise UserError(
            f"control.bind = {bind!r} is no address", "ipc, or tcp://HOST:PORT with HOST an address of this machine, or *"
        )
    _require()
    try:
        _read(folder / "server.secret", secret=True)
        _read(folder / "server.public")
        clients = allowed(folder)
    except UserError as error:
        raise UserError(f"control.bind = {bind!r} needs keys: {error.message}", error.remedy) from None
    if not clients:
        raise UserError(
            f"control.bind = {bind!r}: {folder / 'clients'} lets nobody in", "put the client.public of each client there"
        )
    return bind


class Door:
    """A ROUTER on the network that only known keys get through. The context is its own: libzmq asks one doorkeeper a context."""

    def __init__(self, bind: str, folder: Path) -> None:
        """Raises UserError as `check_bind`, and where the address is taken or not of this machine."""
        check_bind(bind, folder)
        self._folder = folder
        self._zmq = control.context()
        self.bell = self._zmq.socket(zmq.REP)
        self.bell.bind("inproc://zeromq.zap.01")
        self.ctl = self._zmq.socket(zmq.ROUTER)
        self.ctl.curve_server = True
        self.ctl.curve_secretkey = _read(folder / "server.secret", secret=True)
        self.ctl.curve_publickey = _read(folder / "server.public")
        self.ctl.setsockopt(zmq.ZAP_DOMAIN, b"lfpipe")
        self.ctl.setsockopt(zmq.ZAP_ENFORCE_DOMAIN, 1)  # where the doorkeeper does not answer nobody comes in
        control.limit(self.ctl)
        try:
            self.ctl.bind(bind)
        except zmq.ZMQError as error:
            self.close()
            raise UserError(f"control.bind = {bind!r}: {error.strerror}", "another port, or an address of this machine") from None

    def answer(self, parts: list[bytes]) -> None:
        """Answers libzmq's question (ZAP, RFC 27) whether a client may come in."""
        version, request_id, _domain, _address, _identity, mechanism, *credentials = parts
        name = None
        if mechanism == b"CURVE" and len(credentials) == 1:
            try:
                names = {key: name for name, key in allowed(self._folder).items()}
            except UserError:  # a file there is being written, or is no key: nobody comes in by it
                names = {}
            name = names.get(z85.encode(credentials[0]))
        status, text = (b"400", b"unknown key") if name is None else (b"200", b"OK")
        self.bell.send_multipart([version, request_id, status, text, (name or "").encode(), b""])

    def close(self) -> None:
        self.bell.close()
        self.ctl.close()
        self._zmq.term()


def request(address: str, folder: Path, message: dict[str, Any], timeout_s: float = 2.0) -> dict[str, Any]:
    """One command to the session at address, tcp://HOST:PORT, with the client's keys of folder; its answer.

    Raises UserError where the keys are missing, where nobody answers, or when the answer is an error.
    """
    _require()
    if not address.startswith("tcp://"):
        raise UserError(f"--connect {address}: no address", "tcp://HOST:PORT, as control.bind of the session has it")
    with control.context() as ctx, ctx.socket(zmq.DEALER) as socket:
        socket.curve_secretkey = _read(folder / "client.secret", secret=True)
        socket.curve_publickey = _read(folder / "client.public")
        socket.curve_serverkey = _read(folder / "server.public")
        try:
            socket.connect(address)
        except zmq.ZMQError as error:
            raise UserError(
                f"--connect {address}: {error.strerror}", "tcp://HOST:PORT, as control.bind of the session has it"
            ) from None
        remedy = "is it up with that control.bind, are these its server.public and a client.public of its clients/?"
        return control.exchange(socket, message, timeout_s, f"{address} did not answer within {timeout_s:g} s", remedy)
