"""What `host` does on every system: wake-ups, locks that end with their process, the fence of
machines that need one, sums that have the same bits under every Python, and children that may
misbehave.
"""

import ctypes
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.host import files, worker
from lfpipe.host.worker import Worker
from lfpipe.transport import ring
from tests.support.processes import printed
from tests.support.refusal import refusal


def test_a_lock_ends_with_its_process_and_follows_no_link(tmp_path: Path) -> None:
    path = tmp_path / "lock"
    code = "import sys, os; from pathlib import Path; from lfpipe.host.files import lock_file; "
    code += "print(lock_file(Path(sys.argv[1])) is not None, flush=True); os._exit(0)"

    def taken_elsewhere() -> bool:
        return printed(sys.executable, "-c", code, path) == "True\n"

    assert taken_elsewhere() and not files.is_held(path), "the dead hold nothing"
    lock = files.lock_file(path)
    assert lock is not None and files.is_held(path) and lock.in_place()
    assert not taken_elsewhere()
    lock.release()
    (tmp_path / "link").symlink_to(path)
    with pytest.raises(OSError):
        files.lock_file(tmp_path / "link")


@pytest.fixture(autouse=True)
def forgotten() -> Iterator[None]:
    worker._full_fence.cache_clear()
    yield
    worker._full_fence.cache_clear()


def test_a_machine_without_a_fence_is_refused_before_a_ring_exists(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ctypes, "CDLL", lambda name: SimpleNamespace())  # without functions
    monkeypatch.setattr(ring, "fence", worker._fence)
    spec = ring.RingSpec((4,), np.dtype("u1"))
    refused = refusal(ring.create, tmp_path / "a.ring", spec)
    assert "libatomic is not installed" in refused.message and "libatomic1" in refused.remedy
    monkeypatch.undo()
    assert not list(tmp_path.iterdir())


@given(st.lists(st.integers(-(2**40), 2**40), max_size=9))
def test_sums_have_the_same_bits_under_every_python(values: list[int]) -> None:
    assert worker.add(map(float, values)) == sum(values)
    assert worker.add([1e16, 1.0, -1e16]) == 0.0  # `sum` gives 1.0 from Python 3.12 on, 0.0 before


Start = Callable[..., Worker]
HANGS = """import signal, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
for n in range(6): print('{"step": 1}', flush=True); time.sleep(0.4)
print('{"step": "last"}', flush=True); time.sleep(100)"""
HUNGRY = f"""import sys; sys.path.insert(0, {str(Path(worker.__file__).parents[2])!r})
from lfpipe.host.worker import serve
serve(lambda request, report: {{'n': len(bytearray(200 << 20))}}, 100 << 20)"""


@pytest.fixture
def child(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Start]:
    """Runs a program as the child, to its end."""
    running: list[Worker] = []

    def run(program: str, limit_s: float = 20.0, kind: type[Worker] = Worker) -> Worker:
        (tmp_path / "childs_program.py").write_text(program)
        monkeypatch.setenv("PYTHONPATH", str(tmp_path))
        running.append(kind("childs_program", {"a": 1}, "/some/file", limit_s))
        running[-1].wait()
        return running[-1]

    yield run
    for each in running:
        each.close()


def test_request_steps_and_result(child: Start) -> None:
    steps: list[object] = []

    class Steps(Worker):
        def on_step(self, step: dict[str, object]) -> None:
            steps.append(step)

    program = """import sys, json
print(json.dumps({"step": 1})); print("noise"); print("[1]")
print(json.dumps({"ok": True, "result": json.loads(sys.stdin.readline())}))"""
    assert child(program, kind=Steps).result() == {"a": 1} and steps == [{"step": 1}]


def test_noise_without_end_neither_blocks_nor_fills_memory(child: Start) -> None:
    running = child(
        "import sys\nfor _ in range(300): sys.stderr.write('warning ' * 10000);"
        " sys.stdout.write('x' * 10000)\n"
    )
    assert "exit code 0" in str(refusal(running.result))
    assert (
        len(running._log) <= worker.MAX_LOG_BYTES
        and len(running._partial_line) <= worker.MAX_LINE_BYTES
    )


@pytest.mark.parametrize(
    "answer", ["", "[]", '{"ok": true, "result": 5}', '{"ok": 0, "error": 1}', "[" * 100_000]
)
def test_an_answer_that_is_none_is_a_refusal(child: Start, answer: str) -> None:
    assert "/some/file" in str(refusal(child(f"print({answer!r})").result))


OPENS = """import os, time; print('{"reading": "/some/file/a.h5"}', flush=True)
"""


@pytest.mark.parametrize(
    ("ends", "said"),
    [
        ("os.abort()", r"(?s)a\.h5: .*signal 6.*damaged"),
        ("os.kill(os.getpid(), 11)", r"(?s)a\.h5: .*signal 11.*damaged"),
        ("[].pop()", r"(?s)a\.h5: .*exit code 1: IndexError.*damaged"),
        ("os.kill(os.getpid(), 9)", r"(?s)a\.h5: .*signal 9.*smaller"),
        ("time.sleep(99)", r"(?s)a\.h5: no progress within 1 s\b.*disk.*damaged"),
    ],
)
def test_the_file_whose_reader_fails_is_named_with_a_remedy_for_that(
    child: Start, ends: str, said: str
) -> None:
    assert re.search(said, str(refusal(child(OPENS + ends, limit_s=1.0).result)))


@pytest.mark.parametrize(
    ("program", "limit_s", "how"),
    [
        ("raise SystemExit(3)", 20.0, "exit code 3"),
        ("import os; os.abort()", 20.0, "signal 6"),
        (HANGS, 1.5, "no progress within 1.5 s"),  # 2.4 s after the start: steps give it time
        (HUNGRY, 20.0, "100 MB of memory"),
    ],
)
def test_failed_child_reports_its_error_and_ends(
    child: Start, program: str, limit_s: float, how: str
) -> None:
    running = child(program, limit_s=limit_s)
    assert how in str(refusal(running.result))
    assert running._process.poll() is not None
