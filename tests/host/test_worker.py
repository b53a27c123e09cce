"""A child may misbehave: the parent gets a result or a refusal, and nothing is left."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from lfpipe.errors import UserError
from lfpipe.host import worker
from lfpipe.host.worker import Worker

Start = Callable[..., Worker]
HANGS = """import signal, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
for n in range(8): print('{"step": 1}', flush=True); time.sleep(0.5)
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
        def heard(self, step: dict[str, object]) -> None:
            steps.append(step)

    program = """import sys, json
print(json.dumps({"step": 1})); print("noise"); print("[1]")
print(json.dumps({"ok": True, "result": json.loads(sys.stdin.readline())}))"""
    assert child(program, kind=Steps).result() == {"a": 1} and steps == [{"step": 1}]


def test_noise_without_end_neither_blocks_nor_fills_memory(child: Start) -> None:
    running = child("import sys\nfor _ in range(300): sys.stderr.write('warning ' * 10000); sys.stdout.write('x' * 10000)\n")
    with pytest.raises(UserError, match="exit code 0"):
        running.result()
    assert len(running._log) <= worker.MAX_LOG_BYTES and len(running._rest) <= worker.MAX_LINE_BYTES


@pytest.mark.parametrize("answer", ["", "[]", '{"ok": true, "result": 5}', '{"ok": 0, "error": 1}', "[" * 100_000])
def test_an_answer_that_is_none_is_a_refusal(child: Start, answer: str) -> None:
    with pytest.raises(UserError, match="/some/file"):
        child(f"print({answer!r})").result()


@pytest.mark.parametrize(
    ("program", "limit_s", "how"),
    [
        ("raise SystemExit(3)", 20.0, "exit code 3"),
        ("import os; os.abort()", 20.0, "signal 6"),
        (HANGS, 2.0, "no progress within 2 s"),  # but 4 s after the start: steps give it time
        (HUNGRY, 20.0, "100 MB of memory"),
    ],
)
def test_a_child_that_fails_says_how_and_is_gone(child: Start, program: str, limit_s: float, how: str) -> None:
    running = child(program, limit_s=limit_s)
    with pytest.raises(UserError, match=how):
        running.result()
    assert running._process.poll() is not None
