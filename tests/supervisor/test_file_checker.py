"""The child that checks files may misbehave: the supervisor gets a result or a refusal, and nothing is left."""

import json
import os
import re
import sys
import time
from pathlib import Path

import pytest

from lfpipe.config import Config
from lfpipe.errors import UserError
from lfpipe.host.pipes import PipeReader
from lfpipe.supervisor import file_checker
from lfpipe.supervisor.file_checker import FileChecker
from lfpipe.transport.clock import now_ns
from tests.world import write_scene


def finish(checker: FileChecker, most_s: float = 30.0) -> dict[str, object]:
    end = time.monotonic() + most_s
    while not checker.done:
        checker.read()
        assert time.monotonic() < end
        time.sleep(0.01)
    return checker.result()


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "settings"))


@pytest.fixture
def child(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):  # type: ignore[no-untyped-def]
    """Runs another program in the child's stead."""

    def run(program: str) -> FileChecker:
        path = tmp_path / "child.py"
        path.write_text(program)
        monkeypatch.setattr(file_checker, "COMMAND", (sys.executable, str(path)))
        return FileChecker({"check": "trace", "path": "/some/file"}, Config())

    return run


def test_a_scene_gives_its_summary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said = bytearray()

    class Recorded(PipeReader):
        def read(self) -> bytes | None:
            data = super().read()
            said.extend(data or b"")
            return data

    monkeypatch.setattr(file_checker, "PipeReader", Recorded)
    checker = FileChecker({"check": "scene", "path": str(write_scene(tmp_path / "views", 2, 3))}, Config())
    result = finish(checker, 60)
    assert checker.progress == "" and re.search(rb"^views \d of 6$", said, re.MULTILINE), said
    assert (result["rows"], result["cols"], result["height_px"], result["width_px"]) == (2, 3, 48, 64)
    assert Path(str(result["pack"])).is_dir()


@pytest.mark.parametrize("check", ["scene", "trace", "record"])
def test_what_is_refused_on_the_command_line_is_refused_here(tmp_path: Path, check: str) -> None:
    path = tmp_path / "nowhere" / "file" if check == "scene" else Path("/proc/nothing/x")
    with pytest.raises(UserError) as error:
        finish(FileChecker({"check": check, "path": str(path)}, Config()))
    assert error.value.remedy and str(path.parent) in str(error.value)


def test_a_path_that_is_not_utf8_arrives_whole(tmp_path: Path) -> None:
    folder = os.fsdecode(os.fsencode(tmp_path) + b"/\xff")
    with pytest.raises(UserError) as error:
        finish(FileChecker({"check": "scene", "path": folder}, Config()))
    assert "\\udcff" in ascii(error.value.message) or "\\xff" in error.value.message


def test_noise_without_end_neither_blocks_nor_fills_memory(child) -> None:  # type: ignore[no-untyped-def]
    noise = "import sys\nfor _ in range(300): sys.stderr.write('warning ' * 10000); sys.stdout.write('x' * 10000)\n"
    checker = child(noise)
    with pytest.raises(UserError, match="ended with exit code 0"):
        finish(checker)
    assert len(checker._log) <= file_checker.MAX_LOG_BYTES and len(checker._out) <= file_checker.MAX_ANSWER_BYTES


@pytest.mark.parametrize(
    "answer", ["", "[]", '{"ok": true}', '{"ok": true, "result": 5}', '{"ok": 0, "error": 1}', "[" * 100_000]
)
def test_an_answer_that_is_none_is_a_refusal(child, answer: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(UserError, match="/some/file"):
        finish(child(f"print({answer!r})"))


@pytest.mark.parametrize(("program", "how"), [("raise SystemExit(3)", "exit code 3"), ("import os; os.abort()", "signal 6")])
def test_a_child_that_dies_says_how(child, program: str, how: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(UserError, match=how):
        finish(child(program))


def test_a_child_that_hangs_is_ended(child, monkeypatch: pytest.MonkeyPatch) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.setattr(file_checker, "LIMIT_S", 0.3)
    checker = child("import signal, time\nsignal.signal(signal.SIGTERM, signal.SIG_IGN)\ntime.sleep(100)")
    with pytest.raises(UserError, match=r"no progress within 0\.3 s"):
        finish(checker)
    assert checker._process.poll() is not None


def test_a_child_that_reports_progress_may_take_its_time(child, monkeypatch: pytest.MonkeyPatch) -> None:  # type: ignore[no-untyped-def]
    t_ns = now_ns()
    monkeypatch.setattr(file_checker, "now_ns", lambda: t_ns)
    checker = child('for step in range(5): print(step, flush=True); input()\nprint(\'{"ok": true, "result": {"a": 1}}\')')
    for step in range(5):
        while checker.progress != str(step):
            checker.read()
        t_ns += int(0.9 * file_checker.LIMIT_S * 1e9)
        assert not checker.done
        checker._process.stdin.write(b"\n")
        checker._process.stdin.flush()
    assert finish(checker) == {"a": 1}


def test_a_child_outlives_nobody() -> None:
    """A killed supervisor leaves no child that continues packing."""
    program = (
        "import os, sys, time\n"
        "from lfpipe.config import Config\n"
        "from lfpipe.supervisor.file_checker import FileChecker\n"
        "os.mkfifo(sys.argv[1])\n"
        "checker = FileChecker({'check': 'trace', 'path': sys.argv[1]}, Config())\n"
        "print(checker._process.pid, flush=True)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    import subprocess
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run([sys.executable, "-c", program, f"{folder}/fifo"], capture_output=True, text=True, check=False)
    pid = int(done.stdout)
    end = time.monotonic() + 20
    while Path(f"/proc/{pid}").exists() and "Z" not in Path(f"/proc/{pid}/stat").read_text().split(")")[1]:
        assert time.monotonic() < end, "the child is still there"
        time.sleep(0.05)


def test_the_request_is_plain_json() -> None:
    assert json.loads(json.dumps({"path": "/tmp/\udcff"}))["path"] == "/tmp/\udcff"
