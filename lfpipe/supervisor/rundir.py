"""The run directory: owned by one session, locked while it lives, swept by whoever finds it without an owner."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import signal
import stat
import time
from collections.abc import Iterator
from pathlib import Path

import zmq

from lfpipe.errors import UserError
from lfpipe.transport import segment, status
from lfpipe.transport.session import PREFIX, Session, base_dir

PATIENCE = 30  # times that a lock is asked for, 10 ms apart


def _own(path: Path) -> None:
    """Makes the directory, 0700, or checks that it is ours and nobody else's."""
    while True:
        try:
            path.mkdir(mode=0o700)
            return
        except FileExistsError:
            with contextlib.suppress(FileNotFoundError):  # swept since: make it after all
                if not _ours(path.lstat()):
                    raise UserError(f"{path} is not a directory of yours", "remove it, or another --session name") from None
                path.chmod(0o700)
                return
        except OSError as error:
            raise UserError(f"{path}: {error.strerror}", "set XDG_RUNTIME_DIR to a directory you may write to") from None


def _ours(found: os.stat_result) -> bool:
    """Whether that is a directory of this user's; in /tmp anybody may make one under our name, to be spoken to in our stead."""
    return stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid()


def _folders() -> Iterator[Path]:
    """This user's run directories."""
    for path in base_dir().glob(f"{PREFIX}*"):
        with contextlib.suppress(FileNotFoundError):  # it has just ended
            if _ours(path.lstat()):
                yield path


@contextlib.contextmanager
def filled(session: Session) -> Iterator[None]:
    """What the system refuses while a session's files are made is said as a UserError: a full disk, a quota, ..."""
    try:
        yield
    except (OSError, zmq.ZMQError) as error:
        remedy = "make room there, or set XDG_RUNTIME_DIR to another directory"
        raise UserError(f"{session.run_dir}: {error.strerror}", remedy) from None


def _lock(path: Path, make: bool = False) -> int | None:
    """The lock's descriptor, or None when another process holds it. make: also the directory, where it is gone.

    A lock file that vanished meanwhile is no lock: who sweeps takes a directory that is not locked yet for a dead session's.
    """
    while True:
        if make:
            _own(path.parent)
        try:
            fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        except FileNotFoundError:
            if make:
                continue
            return None
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(fd)
            return None
        with contextlib.suppress(FileNotFoundError):
            if path.stat().st_ino == os.fstat(fd).st_ino:
                return fd
        os.close(fd)


def _lock_patiently(path: Path) -> int | None:
    """As _lock, but who only looks whether the session lives (`running`), or sweeps, does not count as an owner."""
    for _ in range(PATIENCE):
        if (fd := _lock(path, make=True)) is not None:
            return fd
        time.sleep(0.01)
    return None


def acquire(session: Session) -> int:
    """Takes the session for this process: returns the lock's descriptor, the directory is empty but for the lock.

    Raises UserError when another `up` runs under this name.
    """
    fd = _lock_patiently(session.lock)
    if fd is None:
        raise UserError(
            f"session {session.name!r} is running already",
            "another --session NAME, or end that one: `lfpipe ctl"
            + ("" if session.name == "default" else f" --session {session.name}")
            + " stop`",
        )
    _clear(session)
    return fd


def _clear(session: Session) -> None:
    segment.unlink_all(session.segment(""))
    for path in session.run_dir.iterdir():
        if path != session.lock:
            path.unlink(missing_ok=True)


def release(session: Session, fd: int) -> None:
    """Removes all that the session made, the lock last."""
    _clear(session)
    shutil.rmtree(session.run_dir, ignore_errors=True)
    os.close(fd)


def _waken(session: Session) -> None:
    """Lets stopped stages of a session without a supervisor go on, to their end: the SIGTERM that the kernel sent them waits."""
    with contextlib.suppress(FileNotFoundError, ValueError):  # no table, or one that was never filled
        table = status.Table(session.segment("status"))
        pids = [int(row["pid"]) for row in table.rows.values()]
        table.close()
        for pid in pids:
            with contextlib.suppress(OSError):  # gone; or the number is now another program's, who is left alone
                if pid > 0 and Path(f"/proc/{pid}/comm").read_text().startswith("lfpipe-"):
                    os.kill(pid, signal.SIGCONT)


def sweep() -> list[str]:
    """Removes what sessions of this user left that no longer live; returns their names."""
    swept = []
    for path in _folders():
        try:
            session = Session(path.name.removeprefix(PREFIX))
        except UserError:
            continue  # not a name of ours
        fd = _lock(session.lock)
        if fd is not None:
            _waken(session)
            release(session, fd)
            swept.append(session.name)
    return swept


def running() -> list[str]:
    """Names of this user's living sessions."""
    names = []
    for path in _folders():
        try:
            fd = os.open(path / "lock", os.O_RDWR | os.O_CLOEXEC)
        except FileNotFoundError:
            continue  # it begins, or has just ended
        try:
            fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            names.append(path.name.removeprefix(PREFIX))
        finally:
            os.close(fd)
    return sorted(names)


def find(name: str) -> Session:
    """The living session of that name. Raises UserError that names those that run."""
    session = Session(name)
    if name not in running():
        others = ", ".join(running())
        raise UserError(
            f"no session {name!r} is running",
            f"running: {others}" if others else "start one: `lfpipe up --demo`",
        )
    return session
