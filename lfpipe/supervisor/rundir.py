"""The run directory: owned by one session, locked while it lives, swept by whoever finds it without an owner.

Its memory is found by its name and says whose it is (`transport.segment`): nothing is unlinked that is another's, or lives.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import stat
import time
from collections.abc import Iterator
from pathlib import Path

import zmq

from lfpipe.errors import UserError
from lfpipe.host import processes, shared_memory
from lfpipe.host.file_lock import lock as lock_file
from lfpipe.supervisor.outcome import Outcome
from lfpipe.transport import control, segment, status
from lfpipe.transport.session import PREFIX, Session, base_dir

PATIENCE = 30  # times that a lock is asked for, PAUSE_S apart
PAUSE_S = 0.01
ENDING_S = 3.0  # how long a session that lost its run directory may take to end


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


def _sessions() -> Iterator[Session]:
    """Those of this user's that have a run directory. What cannot be read, or is none, is passed over."""
    base = base_dir()
    try:
        names = sorted(path.name for path in base.iterdir() if path.name.startswith(PREFIX))
    except OSError:
        return
    for name in names:
        with contextlib.suppress(OSError, UserError):  # it has just ended; it is not a name of ours
            session = Session(name.removeprefix(PREFIX))
            if _ours((base / name).lstat()):
                yield session


@contextlib.contextmanager
def filled(session: Session) -> Iterator[None]:
    """Reports as a UserError what the system refuses while a session's files are made: a full disk, a quota, ..."""
    try:
        yield
    except (OSError, zmq.ZMQError) as error:
        path = getattr(error, "filename", None) or session.run_dir
        what = "make room there" if error.errno in (errno.ENOSPC, errno.EDQUOT) else "remove it"
        raise UserError(f"{path}: {error.strerror}", f"{what}, or set XDG_RUNTIME_DIR to another directory") from None


def _lock(path: Path, make: bool = False) -> int | None:
    """The lock's descriptor, or None when another process holds it. make: also the directory, where it is gone. Raises OSError.

    A lock file that vanished meanwhile is no lock: who sweeps takes a directory that is not locked yet for a dead session's.
    """
    while True:
        if make:
            _own(path.parent)
        try:
            fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o600)
        except FileNotFoundError:
            if make:
                continue
            return None
        if not lock_file(fd):
            os.close(fd)
            return None
        if _is_at(path, fd):
            return fd
        os.close(fd)


def _is_at(path: Path, fd: int) -> bool:
    """Whether the open file is the one at path. One that cannot be looked at now counts as there."""
    try:
        return os.path.samestat(path.lstat(), os.fstat(fd))
    except (FileNotFoundError, NotADirectoryError):
        return False
    except OSError:
        return True


def _lock_patiently(path: Path) -> int | None:
    """As _lock, but who only looks whether the session lives (`running`), or sweeps, does not count as an owner."""
    for _ in range(PATIENCE):
        if (fd := _lock(path, make=True)) is not None:
            return fd
        time.sleep(PAUSE_S)
    return None


def acquire(session: Session) -> int:
    """Takes the session for this process: returns the lock's descriptor; the directory is empty but for the lock, and no
    memory has its names.

    Raises UserError when another `up` runs under this name, and where the path is too long for sockets; OSError where something
    in the directory cannot be removed.
    """
    control.address(session.run_dir, "ctl")
    fd = _lock_patiently(session.lock)
    if fd is None:
        option = "" if session.name == "default" else f" --session {session.name}"
        remedy = f"another --session NAME, or end that one: `lfpipe ctl{option} stop`"
        raise UserError(f"session {session.name!r} is running already", remedy)
    try:
        _empty(session.run_dir)
        _unlink_abandoned(session)
        _wait_for_the_one_before(session)
    except BaseException:
        release(session, fd)
        raise
    return fd


def _empty(run_dir: Path) -> None:
    """Removes all but the lock."""
    for path in run_dir.iterdir():
        if path.name != "lock":
            if stat.S_ISDIR(path.lstat().st_mode):
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)


def _unlink_abandoned(session: Session) -> None:
    for name, _ in segment.abandoned(session.segment("")):
        shared_memory.unlink(name)


def _wait_for_the_one_before(session: Session) -> None:
    """A session whose run directory was removed holds its memory until it has ended."""
    end_s = time.monotonic() + ENDING_S
    while segment.living(session.segment("")):
        if time.monotonic() > end_s:
            remedy = "try again in a few seconds, or another --session NAME"
            raise UserError(f"session {session.name!r} lost its run directory and has not ended yet", remedy)
        time.sleep(PAUSE_S)


def lost(session: Session, fd: int) -> Outcome | None:
    """The end of the session that holds the lock fd once its run directory is no longer its own; None while it is.

    Nobody could reach it any more, and the next of its name could not tell that it lives.
    """
    if _is_at(session.lock, fd):
        return None
    what = f"{session.run_dir} was removed while the session ran"
    return Outcome("its run directory was removed", what, "leave it alone, or set XDG_RUNTIME_DIR to where nothing clears up")


def release(session: Session, fd: int) -> None:
    """Removes all that the session made, the lock last, and nothing of another session that has the directory by now.

    What cannot be removed stays. Memory that this process holds is its own to unlink, and done before.
    """
    try:
        if _is_at(session.lock, fd):
            _remove(session, fd)
            return
    finally:
        os.close(fd)
    with contextlib.suppress(OSError):  # the lock is gone: the rest, if it is there, is removed as a dead session's
        if (lock := _lock(session.lock)) is not None:
            release(session, lock)


def _remove(session: Session, fd: int) -> None:
    """Within the directory everything is named by its descriptor: should it be replaced in this moment, nothing of the new one is
    touched."""
    _unlink_abandoned(session)
    with contextlib.suppress(OSError):
        directory = os.open(session.run_dir, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
        try:
            if not os.path.samestat(os.stat("lock", dir_fd=directory, follow_symlinks=False), os.fstat(fd)):
                return
            with os.scandir(directory) as entries:
                names = [entry.name for entry in entries if entry.name != "lock"]
            for name in names:
                _remove_entry(name, directory)
            os.unlink("lock", dir_fd=directory)
            session.run_dir.rmdir()
        finally:
            os.close(directory)


def _remove_entry(name: str, directory: int) -> None:
    try:
        os.unlink(name, dir_fd=directory)
    except OSError:
        shutil.rmtree(name, ignore_errors=True, dir_fd=directory)


def _waken(name: str) -> None:
    """Lets stopped stages of a session without a supervisor go on, to their end: the SIGTERM that the kernel sent them waits.

    name: of its status table; of another segment, nothing happens.
    """
    with contextlib.suppress(FileNotFoundError, ValueError):  # none, or of another version
        table = status.Table(name)
        pids = [int(row["pid"]) for row in table.rows.values()]
        table.close()
        for pid in pids:
            with contextlib.suppress(OSError):  # gone; or the number is now another program's, who is left alone
                if pid > 0 and processes.name_of(pid).startswith("lfpipe-"):
                    processes.resume(pid)


def sweep() -> list[str]:
    """Removes what sessions of this user left that no longer live; returns their names. What cannot be removed is passed over.

    Also memory of any dead session whose run directory is gone, wherever that was.
    """
    swept = []
    for session in _sessions():
        with contextlib.suppress(OSError):
            fd = _lock(session.lock)
            if fd is not None:
                _waken(session.segment("status"))
                release(session, fd)
                swept.append(session.name)
    for name, run_dir in segment.abandoned():
        if run_dir.is_absolute() and _is_gone(run_dir):
            _waken(name)
            with contextlib.suppress(OSError):
                shared_memory.unlink(name)
    return swept


def _is_gone(path: Path) -> bool:
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return True
    except OSError:
        return False
    return False


def running() -> list[str]:
    """Names of this user's living sessions."""
    names = []
    for session in _sessions():
        with contextlib.suppress(OSError):  # it begins, has just ended, or may not be read
            fd = os.open(session.lock, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
            try:
                if not lock_file(fd, shared=True):
                    names.append(session.name)
            finally:
                os.close(fd)
    return sorted(names)


def find(name: str) -> Session:
    """The living session of that name. Raises UserError that names those that run."""
    session = Session(name)
    living = running()
    if name not in living:
        others = ", ".join(living)
        raise UserError(
            f"no session {name!r} is running",
            f"running: {others}" if others else "start one: `lfpipe up --demo`",
        )
    return session
