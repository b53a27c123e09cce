"""The run directory: one session owns and locks it while it runs. Any process of the user may
sweep one without an owner.

A lock ends with its process. A sweep unlinks shared memory only if it belongs to this user and its
session is dead (`host.segment`).
"""

import contextlib
import errno
import os
import shutil
import stat
import time
from collections.abc import Iterator
from pathlib import Path

from lfpipe.errors import UserError
from lfpipe.host import file_lock, processes, segment
from lfpipe.host.file_lock import Lock
from lfpipe.host.files import is_missing
from lfpipe.host.limits import REMEDIES
from lfpipe.transport import control
from lfpipe.transport.session import PREFIX, Session, base_dir, place_prefix

# to take a lock: a process that sweeps or lists sessions holds one briefly
ATTEMPTS, PAUSE_S = 30, 0.01
ENDING_S = 3.0  # time limit for a session that lost its run directory to end


def _is_own_directory(path: Path) -> bool:
    """Whether path is a directory of this user and not a link: in /tmp, any user may create one
    with this name. Raises OSError.
    """
    entry = path.lstat()
    return stat.S_ISDIR(entry.st_mode) and entry.st_uid == os.getuid()


def _make_directory(path: Path) -> None:
    """Creates path with mode 0700, or sets that mode. Raises UserError if it is not this user's
    directory, FileNotFoundError if another process has just removed it.
    """
    try:
        path.mkdir(mode=0o700)
    except FileExistsError:
        if not _is_own_directory(path):
            raise UserError(
                f"{path} is not a directory of yours", "remove it, or use another --session name"
            ) from None
        path.chmod(0o700)
    except OSError as error:
        raise UserError(
            f"{path}: {error.strerror}", "set XDG_RUNTIME_DIR to a directory that you may write to"
        ) from None


def take_lock(path: Path, make: bool = False) -> Lock | None:
    """Locks the file at path, created if missing; None if another process holds it.

    make: also creates its directory. Otherwise None if that is missing. Raises OSError, and
    UserError for a directory of another user. A sweep treats an unlocked directory as a dead
    session's, so a lock is valid only if the file still exists.
    """
    while True:
        try:
            if make:
                _make_directory(path.parent)
            lock = file_lock.take(path)
        except FileNotFoundError:
            if make:
                continue
            return None
        if lock is None or lock.in_place():
            return lock
        lock.release()


def _sessions() -> Iterator[Session]:
    """This user's sessions that have a run directory.

    Skips anything unreadable or not a run directory.
    """
    base = base_dir()
    try:
        names = sorted(path.name for path in base.iterdir() if path.name.startswith(PREFIX))
    except OSError:
        return
    for name in names:
        # it has just ended, or it is not the name of a session
        with contextlib.suppress(OSError, UserError):
            session = Session(name.removeprefix(PREFIX))
            if _is_own_directory(base / name):
                yield session


@contextlib.contextmanager
def filled(session: Session) -> Iterator[None]:
    """Turns system errors while a session's files are created (a full disk, a quota, ...) into a
    UserError.
    """
    try:
        yield
    except OSError as error:
        path = getattr(error, "filename", None) or session.run_dir
        what = "free space there" if error.errno in (errno.ENOSPC, errno.EDQUOT) else "remove it"
        raise UserError(
            f"{path}: {error.strerror}",
            REMEDIES.get(error.errno or 0, f"{what}, or set XDG_RUNTIME_DIR to another directory"),
        ) from None


def acquire(session: Session) -> Lock:
    """Takes the session for this process and returns its lock. The directory is then empty except
    for the lock, and the names of the session's memory are free.

    Raises UserError if another `up` runs under this name or the path is too long for sockets,
    OSError if an entry of the directory cannot be removed.
    """
    control.check_place(session.run_dir, "ctl")
    for _ in range(ATTEMPTS):
        if (lock := take_lock(session.lock, make=True)) is not None:
            break
        time.sleep(PAUSE_S)
    else:
        option = "" if session.name == "default" else f" --session {session.name}"
        remedy = f"use another --session NAME, or end it: `lfpipe ctl{option} stop`"
        raise UserError(f"session {session.name!r} is already running", remedy)
    try:
        _empty(session.run_dir)
        if not _unlink_memory(session):
            remedy = "try again in a few seconds, or use another --session NAME"
            raise UserError(
                f"session {session.name!r} lost its run directory and has not ended yet", remedy
            )
    except BaseException:
        release(session, lock)
        raise
    return lock


def _empty(run_dir: Path) -> None:
    for path in run_dir.iterdir():
        if not path.name.startswith("lock"):
            if stat.S_ISDIR(path.lstat().st_mode):
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)


def _unlink_memory(session: Session) -> bool:
    """Unlinks the session's abandoned memory; returns whether none is left. Waits for other
    sweeping processes, and for the end of a live session that lost its run directory.
    """
    prefix = place_prefix(session.run_dir)
    end_s = time.monotonic() + ENDING_S
    while True:
        for name, _ in segment.abandoned(prefix):
            _resume_stages(name)
            segment.unlink(name)
        if not segment.owned(prefix):
            return True
        if time.monotonic() > end_s:
            return False
        time.sleep(PAUSE_S)


def release(session: Session, lock: Lock) -> None:
    """Removes everything that the session created, the lock last, and releases the lock. Skips
    files that cannot be removed, and everything if another session now owns the directory. The
    caller must have unlinked its own memory.
    """
    try:
        if lock.in_place():
            _unlink_memory(session)
            with contextlib.suppress(OSError):
                _empty(session.run_dir)
                session.lock.unlink()
                session.run_dir.rmdir()
            return
    finally:
        lock.release()
    # if only the lock is missing, the rest is removed like a dead session's
    with contextlib.suppress(OSError):
        if (again := take_lock(session.lock)) is not None:
            release(session, again)


def _resume_stages(name: str) -> None:
    """Resumes the stopped stages of a dead supervisor, so that the kernel's SIGTERM can end them.

    name: of a segment; nothing happens unless it holds a status table of this version.
    """
    from lfpipe.transport.status import Table  # needs numpy, which `find` does not wait for

    with contextlib.suppress(FileNotFoundError, ValueError):
        table = Table(name)
        pids = [int(row["pid"]) for row in table.rows.values()]
        table.close()
        for pid in pids:
            if pid > 0:
                processes.resume_stage(pid)


def sweep() -> list[str]:
    """Removes leftovers of this user's dead sessions, and returns their names. Skips files that
    cannot be removed.

    Covers the run directories of this runtime directory, and all memory whose run directory no
    longer exists.
    """
    swept = []
    for session in _sessions():
        with contextlib.suppress(OSError):
            lock = take_lock(session.lock)
            if lock is not None:
                release(session, lock)
                swept.append(session.name)
    for name, run_dir in segment.abandoned():
        if run_dir.is_absolute() and is_missing(run_dir):
            _resume_stages(name)
            with contextlib.suppress(OSError):
                segment.unlink(name)
    return swept


def running() -> list[str]:
    """Names of this user's living sessions in this runtime directory."""
    names = []
    for session in _sessions():
        with contextlib.suppress(OSError):  # it is starting, has just ended, or is unreadable
            names += [session.name] if file_lock.is_held(session.lock) else []
    return sorted(names)


def find(name: str) -> Session:
    """The running session of that name. Raises UserError with the names of running ones."""
    session = Session(name)
    living = running()
    if name not in living:
        others = ", ".join(living)
        raise UserError(
            f"no session {name!r} is running",
            f"use one that is running: {others}" if others else "start one: `lfpipe up --demo`",
        )
    return session


def ask(name: str, message: control.Message, timeout_s: float = 2.0) -> control.Message:
    """Sends one command to the session that has this name now; returns its answer.

    Raises UserError.
    """
    return control.request(find(name).run_dir, message, timeout_s)
