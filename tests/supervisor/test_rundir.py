"""Run directories and the memory that belongs to them: whose it is, who removes it, and what is left alone."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import zmq

from lfpipe.errors import UserError
from lfpipe.observe import live
from lfpipe.supervisor import rundir
from lfpipe.transport import segment
from lfpipe.transport.segment import SHM_DIR
from lfpipe.transport.session import PREFIX, Session
from tests.supervisor.holder import ROOT, Holder, holding

NOBODY = 65534


@pytest.fixture
def name() -> str:
    return f"t{os.getpid()}x{time.monotonic_ns() % 10**9}"


@pytest.fixture
def base(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The runtime directory of this process."""
    made = tmp_path / "run"
    made.mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(made))
    return made


def inodes(segments: list[str]) -> list[int]:
    """Of segments that are there; raises FileNotFoundError where one is gone."""
    return [(SHM_DIR / each).stat().st_ino for each in segments]


def gone(segments: list[str]) -> bool:
    return not any((SHM_DIR / each).exists() for each in segments)


def test_a_session_of_the_same_name_elsewhere_leaves_a_living_one_alone(base: Path, tmp_path: Path, name: str) -> None:
    other = tmp_path / "other"
    other.mkdir()
    with holding(base, name) as first:
        before = inodes(first)
        with holding(other, name) as second:
            assert not set(first) & set(second)
        assert gone(second) and inodes(first) == before
    assert gone(first)


def test_the_same_directory_by_another_path_is_the_same_session(base: Path, tmp_path: Path, name: str) -> None:
    link = tmp_path / "link"
    link.symlink_to(base)
    with holding(link, name) as segments:
        assert [Session(name).segment(part) for part in ("status", "frames", "eyes")] == segments
        assert rundir.running() == [name]
        assert "is running already" in Holder(base, name).failed()


def test_a_reader_with_another_runtime_directory_finds_the_one_session_of_that_name(
    base: Path, tmp_path: Path, name: str
) -> None:
    others = [tmp_path / "b", tmp_path / "c"]
    for other in others:
        other.mkdir()
    with holding(others[0], name) as first:
        assert [Session(name).segment(part) for part in ("status", "frames", "eyes")] == first
        assert Session(f"{name}.2").segment("status") not in first
        with holding(others[1], name) as second:
            assert Session(name).segment("status") not in (*first, *second), "which of the two?"
        with holding(base, name) as own:
            assert Session(name).segment("status") == own[0]
    assert rundir.running() == []


def test_names_are_short_enough_for_every_system(base: Path) -> None:
    names = {
        Session(session).segment(part)
        for session in ("a", "a" * 32)
        for part in ("status", "frames", "eyes", "packets.1", "pictures.9999", "pictures.10000", "pictures.123456789")
    }
    assert len(names) == 14 and max(len(f"/{each}") for each in names) <= 31


def squat(path: Path, kind: str) -> None:
    """Something at path that is not a segment of ours."""
    if kind == "directory":
        path.mkdir()
    elif kind == "link":
        path.symlink_to("/dev/shm/target")
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        path.write_bytes(b"" if kind == "empty file" else bytes(8192) if kind == "zeros" else b"not a segment " * 1000)
    if kind == "file of another":
        os.chown(path, NOBODY, NOBODY)


def described(path: Path) -> tuple[int, ...]:
    found = path.lstat()
    return found.st_ino, found.st_mode, found.st_uid, found.st_size


def remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        path.rmdir()
    else:
        path.unlink()


KINDS = ["directory", "link", "pipe", "file", "empty file", "zeros"] + (["file of another"] if os.getuid() == 0 else [])


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_not_ours_is_left_alone_in_shared_memory(base: Path, name: str, kind: str) -> None:
    """In the way of no ring it disturbs nobody; in the way of one, the message names it and the remedy works."""
    beside, within = (SHM_DIR / Session(name).segment(part) for part in ("x", "frames"))
    squat(beside, kind)
    try:
        before = described(beside)
        with holding(base, name):
            pass
        squat(within, kind)
        said = Holder(base, name).failed()
        assert str(within) in said and "remove" in said and "--session" in said
        with holding(base, f"{name}.2"):
            pass
        assert described(beside) == before and described(within)[1:] == before[1:]
        remove(within)
        with holding(base, name):
            pass
    finally:
        for path in (beside, within):
            if path.exists() or path.is_symlink():
                remove(path)
    assert not list(base.iterdir())


def test_the_helpers_of_a_killed_session_do_not_take_the_memory_of_the_next(base: Path, name: str) -> None:
    """The tracker of shared memory that Python starts outlives its process, and unlinks by name what that never unlinked."""
    first = Holder(base, name)
    first.ready()
    helpers = first.children()
    for pid in helpers:
        os.kill(pid, signal.SIGSTOP)
    first.process.kill()
    first.process.wait()
    with holding(base, name) as segments:
        before = inodes(segments)
        for pid in helpers:
            os.kill(pid, signal.SIGCONT)
        end = time.monotonic() + 20
        while any(Path(f"/proc/{pid}").exists() and "Z" not in _state(pid) for pid in helpers) and time.monotonic() < end:
            time.sleep(0.01)
        assert inodes(segments) == before
    first.kill()


def _state(pid: int) -> str:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    return "Z"


def test_a_killed_session_is_swept_and_a_living_one_is_not(base: Path, name: str) -> None:
    killed = Holder(base, name)
    left = killed.ready()
    killed.kill()
    assert not gone(left), "nothing to sweep: this test shows nothing"
    with holding(base, f"{name}.2") as living:
        assert gone(left) and not gone(living)
        assert [path.name for path in base.iterdir()] == [f"{PREFIX}{name}.2"]


@pytest.mark.parametrize("how", ["removed", "base removed", "moved"])
def test_memory_whose_run_directory_is_gone_is_removed_once_its_session_is_dead(
    base: Path, tmp_path: Path, name: str, how: str
) -> None:
    """By whichever session of this user begins next, wherever its run directory is."""
    other = tmp_path / "other"
    other.mkdir()
    holder = Holder(base, name)
    left = holder.ready()
    if how == "moved":
        (base / f"{PREFIX}{name}").rename(tmp_path / "moved")
    else:
        shutil.rmtree(base if how == "base removed" else base / f"{PREFIX}{name}")
    with holding(other, "another"):
        assert not gone(left), "its session lives"
    holder.kill()
    with holding(other, "another"):
        assert gone(left)


def test_a_session_that_lost_its_run_directory_leaves_the_next_one_alone(base: Path, name: str) -> None:
    first = Holder(base, name)
    first.ready()
    shutil.rmtree(base / f"{PREFIX}{name}")
    second = Holder(base, name)  # waits for the first
    time.sleep(0.3)
    first.end()
    segments = second.ready()
    assert rundir.running() == [name] and not gone(segments)
    second.end()
    assert gone(segments) and not list(base.iterdir())


def test_a_removed_run_directory_is_noticed(base: Path, name: str) -> None:
    session = Session(name)
    lock = rundir.acquire(session)
    assert rundir.lost(session, lock) is None
    session.lock.unlink()
    assert rundir.lost(session, lock) is not None, "the lock is gone"
    other = rundir.acquire(session)
    outcome = rundir.lost(session, lock)
    assert outcome is not None and str(session.run_dir) in (outcome.failure or "") and outcome.remedy
    rundir.release(session, lock)
    assert rundir.running() == [name], "it is another's now"
    rundir.release(session, other)
    assert not list(base.iterdir())


def test_a_run_directory_without_its_lock_is_removed_all_the_same(base: Path, name: str) -> None:
    session = Session(name)
    lock = rundir.acquire(session)
    (session.run_dir / "session.json").touch()
    session.lock.unlink()
    rundir.release(session, lock)
    assert not list(base.iterdir())


def test_a_monitor_says_that_a_session_is_of_another_version(base: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    session = Session(name)
    lock = rundir.acquire(session)
    (session.run_dir / "session.json").write_text("{}")
    memory = segment.create(session.segment("status"), 1 << 16, session.run_dir)
    segment.buffer(memory)[:8] = b"LFSTAT0\0"
    for words in (["--once"], ["--json"], ["--csv"]):
        done = subprocess.run(
            [sys.executable, "-m", "lfpipe", "monitor", "--session", name, *words], capture_output=True, text=True
        )
        assert done.returncode == 2 and "LFSTAT0" in done.stderr and "remedy" in done.stderr, done.stderr
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    with pytest.raises(segment.WrongSegment, match="LFSTAT0"):
        live.run(name, False, "")
    memory.unlink()
    memory.close()
    rundir.release(session, lock)


@pytest.fixture
def strange(base: Path, name: str) -> Iterator[list[Path]]:
    """Entries that no session made, or that may not be read."""
    made = [base / f"{PREFIX}{word}" for word in ("lockdir", "locklink", "unreadable", "closed", "with folder", "a name", "file")]
    for path in made[:6]:
        path.mkdir(mode=0o700)
    (made[0] / "lock").mkdir()
    (made[1] / "lock").symlink_to("/nowhere/lock")
    (made[2] / "lock").touch(0o000)
    (made[4] / "folder").mkdir()
    (made[4] / "folder" / "file").touch()
    made[6].touch()
    made[3].chmod(0)
    yield made
    with contextlib.suppress(FileNotFoundError):  # root may sweep it
        made[3].chmod(0o700)


LOOK = """
from lfpipe.observe import live
from lfpipe.supervisor import rundir
from lfpipe.transport import segment
import sys
print(rundir.running(), rundir.find(sys.argv[1]).name)
rundir.sweep()
"""


def test_an_entry_that_may_not_be_read_shuts_nobody_out(base: Path, name: str, strange: list[Path]) -> None:
    """As a user to whom permissions apply."""
    drop = ["setpriv", "--bounding-set=-all", "--inh-caps=-all"] if os.getuid() == 0 else []
    if drop and shutil.which("setpriv") is None:
        pytest.skip("setpriv is not installed, and permissions do not apply to root")
    holder = Holder(base, name, *drop)
    holder.ready()
    env = {**os.environ, "XDG_RUNTIME_DIR": str(base)}
    done = subprocess.run([*drop, sys.executable, "-c", LOOK, name], capture_output=True, text=True, cwd=ROOT, env=env)
    assert done.returncode == 0 and done.stdout == f"['{name}'] {name}\n", done.stderr
    holder.end()


def test_an_entry_of_another_kind_shuts_nobody_out(base: Path, name: str, strange: list[Path]) -> None:
    with holding(base, name):
        assert rundir.running() == [name] and rundir.find(name) == Session(name)
        rundir.sweep()
    assert (strange[1] / "lock").is_symlink() and not Path("/nowhere").exists(), "a link is not followed"


@pytest.mark.parametrize("kind", ["directory", "link"])
def test_a_lock_that_is_none_is_named_and_its_remedy_works(base: Path, name: str, kind: str) -> None:
    lock = Session(name).lock
    lock.parent.mkdir(mode=0o700)
    squat(lock, kind)
    said = Holder(base, name).failed()
    assert str(lock) in said and "remove it" in said
    remove(lock)
    with holding(base, name):
        pass


def test_what_lies_in_a_dead_run_directory_goes_with_it(base: Path, name: str, tmp_path: Path) -> None:
    """Also folders, and links without what they lead to."""
    kept = tmp_path / "kept"
    kept.mkdir()
    (kept / "file").touch()
    for session in (Session(name), Session(f"{name}.2")):
        (session.run_dir / "a" / "b").mkdir(parents=True)
        (session.run_dir / "a" / "b" / "file").touch()
        (session.run_dir / "link").symlink_to(kept)
    session.run_dir.parent.chmod(0o700)
    with holding(base, name):
        assert sorted(path.name for path in base.iterdir()) == [f"{PREFIX}{name}"]
        assert not (Session(name).run_dir / "a").exists()
    assert (kept / "file").exists() and not list(base.iterdir())


def test_a_run_directory_is_found_again_whatever_its_mode(base: Path, name: str) -> None:
    Session(name).run_dir.mkdir(mode=0o777)
    with holding(base, name):
        assert stat.S_IMODE(Session(name).run_dir.stat().st_mode) == 0o700


@pytest.mark.parametrize("value", ["run", "./run", "~/run", b"/tmp/\xff\xfe", "missing", "file", "x" * 5000], ids=range(7))
def test_a_runtime_directory_that_cannot_be_is_named_with_a_remedy(tmp_path: Path, name: str, value: str | bytes) -> None:
    (tmp_path / "file").touch()
    path = os.fsdecode(value)
    if value in ("missing", "file"):
        path = str(tmp_path / path)
    elif value == "x" * 5000:
        path = f"{tmp_path}/{path}"
    said = Holder(Path(path), name).failed() if not path.startswith((".", "~")) else _raw(path, name)
    assert "XDG_RUNTIME_DIR" in said and "remedy" in said, said
    for words in (["monitor", "--once"], ["ctl", "status"]):
        env = {**os.environ, "XDG_RUNTIME_DIR": path}
        done = subprocess.run(
            [sys.executable, "-m", "lfpipe", *words], capture_output=True, text=True, errors="replace", cwd=tmp_path, env=env
        )
        assert done.returncode == 2 and "error: " in done.stderr and "Traceback" not in done.stderr, done.stderr


def _raw(path: str, name: str) -> str:
    env = {**os.environ, "XDG_RUNTIME_DIR": path}
    command = [sys.executable, "-m", "tests.supervisor.holder", name]
    done = subprocess.run(command, capture_output=True, text=True, env=env, cwd=ROOT, input="end\n")
    assert done.returncode == 2 and "Traceback" not in done.stderr, done.stderr
    return done.stderr


def test_spaces_and_signs_in_the_runtime_directory_work(monkeypatch: pytest.MonkeyPatch) -> None:
    with tempfile.TemporaryDirectory() as folder:  # of a short path
        place = Path(folder) / "a [b] *? 'ü' %s {}"
        place.mkdir()
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(place))
        with holding(place, "a") as segments:
            assert rundir.running() == ["a"] and not gone(segments)
        assert gone(segments)


def test_the_remedy_for_a_path_too_long_for_sockets_works(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need = zmq.IPC_PATH_MAX_LEN - len(f"/{PREFIX}ab/ctl")  # what a session of two letters leaves
    place = Path(f"{tmp_path}/".ljust(need, "y"))
    place.mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(place))
    with pytest.raises(UserError, match="a socket takes") as error:
        rundir.acquire(Session("abc"))
    assert "shorter --session" in error.value.remedy and "shorter XDG_RUNTIME_DIR" in error.value.remedy
    assert not list(place.iterdir())
    lock = rundir.acquire(Session("ab"))
    rundir.release(Session("ab"), lock)


HOSTILE = ["", " ", ".", "..", "../x", "a/b", "a\nb", "a\n", "-a", "a b", "a" * 33, "é", "١", "a-b", "a*", "\0", "a\0", "$(id)"]


@pytest.mark.parametrize("text", [*HOSTILE, "\udcff"])
def test_a_session_name_that_cannot_be_is_named_with_a_remedy(text: str) -> None:
    with pytest.raises(UserError) as error:
        Session(text)
    assert repr(text) in error.value.message and "1 to 32" in error.value.remedy


@pytest.mark.parametrize("text", ["../x", "a\nb", "\udcff"])
def test_a_session_name_in_the_environment_is_checked_as_well(base: Path, text: str) -> None:
    for words in (["monitor", "--once"], ["ctl", "status"], ["up", "--demo"]):
        env = {**os.environ, "LFPIPE_SESSION": text}
        done = subprocess.run(
            [sys.executable, "-m", "lfpipe", *words], capture_output=True, text=True, errors="replace", env=env, cwd=base
        )
        assert done.returncode == 2 and "LFPIPE_SESSION=" in done.stderr and "Traceback" not in done.stderr, done.stderr
    assert not list(base.iterdir())
