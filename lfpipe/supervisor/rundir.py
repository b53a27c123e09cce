"""The directory of a session: one process owns and locks it while it runs. Any process of the user
may sweep one without an owner. Live scenes of other programs have such directories, too.

A lock ends with its process.
"""

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
from lfpipe.host import worker
from lfpipe.host.files import PAUSE_S, REMEDIES, Lock, is_held, is_missing, lock_file
from lfpipe.transport import control
from lfpipe.transport.control import LIVE, PREFIX, Session, base_dir

# to take a lock: a process that sweeps or lists sessions holds one briefly
ATTEMPTS = 30


def _is_own_directory(path: Path) -> bool:
    """Whether path is a directory of this user and not a link: in /dev/shm and /tmp, any user may
    create one with this name. Raises OSError.
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
            f"{path}: {error.strerror}", "set LFPIPE_RUN_DIR to a directory that you may write to"
        ) from None


def try_lock(path: Path, make: bool = False) -> Lock | None:
    """Locks the file at path, created if missing; None if another process holds it.

    make: also creates its directory. Otherwise None if that is missing. Raises OSError, and
    UserError for a directory of another user. A sweep treats an unlocked directory as a dead
    session's, so a lock is valid only if the file still exists.
    """
    while True:
        try:
            if make:
                _make_directory(path.parent)
            lock = lock_file(path)
        except FileNotFoundError:
            if make:
                continue
            return None
        if lock is None or lock.in_place():
            return lock
        lock.release()


def _directories() -> Iterator[tuple[str, Path]]:
    """This user's directories, by the names of their sessions; those of live scenes have none.

    Skips anything unreadable and of other names.
    """
    try:
        paths = sorted(path for path in base_dir().iterdir() if path.name.startswith(PREFIX))
    except OSError:
        return
    for path in paths:
        name = path.name.removeprefix(LIVE).removeprefix(PREFIX)
        # it has just ended, or it is not the name of a session
        with contextlib.suppress(OSError, UserError):
            Session(name)
            if _is_own_directory(path):
                yield "" if path.name.startswith(LIVE) else name, path


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
            REMEDIES.get(error.errno or 0, f"{what}, or set LFPIPE_RUN_DIR to another directory"),
        ) from None


def acquire(session: Session) -> Lock:
    """Takes the session for this process and returns its lock. The directory is then empty except
    for the lock.

    Raises UserError if another `up` runs under this name or the path is too long for sockets,
    OSError if an entry of the directory cannot be removed.
    """
    socket = str(session.run_dir / ".ctl")
    if len(socket) > zmq.IPC_PATH_MAX_LEN:
        raise UserError(
            f"{socket} has {len(socket)} characters; a socket allows {zmq.IPC_PATH_MAX_LEN}",
            "use a shorter --session name, or a shorter LFPIPE_RUN_DIR",
        )
    option = "" if session.name == "default" else f" --session {session.name}"
    remedy = f"use another --session NAME, or end it: `lfpipe ctl{option} stop`"
    running = UserError(f"session {session.name!r} is already running", remedy)
    return acquire_directory(session.run_dir, running)


def acquire_directory(path: Path, in_use: UserError) -> Lock:
    """Takes the directory at path for this process, as `acquire`. Raises in_use if another process
    owns it.
    """
    for _ in range(ATTEMPTS):
        if (lock := try_lock(path / "lock", make=True)) is not None:
            break
        time.sleep(PAUSE_S)
    else:
        raise in_use
    try:
        _empty(path)
    except BaseException:
        remove(path, lock)
        raise
    return lock


def _empty(path: Path) -> None:
    """Removes all but the lock. First resumes the stopped stages of a dead supervisor, so that the
    kernel's SIGTERM can end them.
    """
    from lfpipe.transport.status import Table  # needs numpy, which `find` does not wait for

    with contextlib.suppress(OSError, ValueError):
        table = Table(path / "status")
        pids = [int(row["pid"]) for row in table.rows.values()]
        table.close()
        for pid in filter(None, pids):
            worker.resume_stage(pid)
    for entry in path.iterdir():
        if entry.name != "lock":
            if stat.S_ISDIR(entry.lstat().st_mode):
                shutil.rmtree(entry)
            else:
                entry.unlink(missing_ok=True)


def remove(path: Path, lock: Lock) -> None:
    """Removes a directory, the lock last, and releases the lock. Skips files that cannot be
    removed, and everything if another process now owns the directory.
    """
    try:
        if lock.in_place():
            with contextlib.suppress(OSError):
                _empty(path)
                (path / "lock").unlink()
                path.rmdir()
    finally:
        lock.release()


def sweep() -> list[str]:
    """Removes leftovers of this user's dead sessions, and returns their names. Skips files that
    cannot be removed.
    """
    names = []
    for name, path in _directories():
        with contextlib.suppress(OSError):
            if (lock := try_lock(path / "lock")) is not None:
                remove(path, lock)
                names.append(name or path.name)
    return names


def sweep_own(run_dir: Path) -> None:
    """Removes the directory of a killed supervisor, as each of its stages does at its end: one that
    comes while another one sweeps tries again.
    """
    for _ in range(ATTEMPTS):
        if (lock := try_lock(run_dir / "lock")) is not None:
            remove(run_dir, lock)
        if is_missing(run_dir):
            return
        time.sleep(PAUSE_S)


def running() -> list[str]:
    """Names of this user's living sessions."""
    names = []
    for name, path in _directories():
        with contextlib.suppress(OSError):  # it is starting, has just ended, or is unreadable
            names += [name] if name and is_held(path / "lock") else []
    return sorted(names)


def find(name: str) -> Session:
    """The running session of that name. Raises UserError with the names of running ones."""
    session = Session(name)
    names = running()
    if name not in names:
        others = ", ".join(names)
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
