"""The short form of the attack, and its tools; `profiling.attack` has the long form."""

import random
import subprocess
import sys
from pathlib import Path

import msgpack
import pytest

from lfpipe.transport import control
from profiling.attack import mutations, worker
from profiling.attack.book import Book
from profiling.attack.case import Case, Outcome, judged, rng_of
from profiling.attack.headers import FORMATS, claiming
from profiling.attack.messages import WAYS, ctl_message
from profiling.attack.page import Server, request
from profiling.attack.report import table
from profiling.attack.templates import make_all


@pytest.fixture(scope="module")
def templates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("attack") / "templates"
    make_all(folder)
    return folder


@pytest.mark.timeout(400)
def test_a_thousand_hostile_inputs(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "profiling.attack", "--quick", "--failures", str(tmp_path / "failures")]
    done = subprocess.run(command, cwd=Path(__file__).parents[2], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-2000:]


def test_a_seed_and_a_number_make_the_same_message_again() -> None:
    for number in range(200):
        assert ctl_message(rng_of(3, "ctl", number)) == ctl_message(rng_of(3, "ctl", number))


def test_messages_are_of_every_way_and_none_ends_the_session() -> None:
    made = [ctl_message(rng_of(1, "ctl", number)) for number in range(3000)]
    assert {message.kind for message in made} == set(WAYS)
    words = []
    for message in made:
        try:
            words += [control.decode(part).get("cmd") for part in message.frames[:1] if len(message.frames) == 1]
        except control.BadMessage:
            continue
    assert "stop" not in words
    assert {"set", "status", "hello", "pause"} <= {word for word in words if isinstance(word, str)}


@pytest.mark.parametrize("suffix", FORMATS)
def test_headers_claim_what_is_not_there(suffix: str) -> None:
    made = [claiming(random.Random(number), suffix) for number in range(50)]
    assert len(set(made)) > 20
    assert max(map(len, made)) < 20_000


def test_trees_and_bytes_differ_from_what_they_were() -> None:
    data = b'{"a": [1, 2, {"b": "c"}], "d": 1.5}'
    for change in (mutations.changed_json, mutations.changed_bytes, mutations.changed_numbers):
        assert sum(change(random.Random(number), data) != data for number in range(200)) > 150


@pytest.mark.parametrize("part", worker.PARTS)
def test_inputs_are_made_again_from_their_number(tmp_path: Path, templates: Path, part: str) -> None:
    (templates / "packed" / "lfpipe" / "scenes" / "k").mkdir(parents=True, exist_ok=True)
    (templates / "packed" / "lfpipe" / "scenes" / "k" / "manifest.json").write_text('{"a": 1}')
    (templates / "packed" / "lfpipe" / "index").mkdir(exist_ok=True)
    (templates / "packed" / "lfpipe" / "index" / "x").write_text("k")
    (templates / "reference").mkdir(exist_ok=True)
    (templates / "reference" / "report.json").write_text('{"a": 1}')
    for number in range(30):
        cases = []
        for name in ("one", "two"):
            (tmp_path / f"{name}{number}").mkdir()
            cases.append(worker.PARTS[part](rng_of(1, part, number), tmp_path / f"{name}{number}", templates))
        assert cases[0] == cases[1]


CASE = Case("kind: x", ["scene", "info", "--json", "scene"])


@pytest.mark.parametrize(
    ("code", "out", "err", "peak", "outcome"),
    [
        (0, '{"a": 1}', "", 900.0, "accepted"),
        (2, "", "error: no\n  remedy: yes\n", 100.0, "refused"),
        (2, "", "error: no\n  remedy: yes\n", 301.0, "memory"),
        (2, "", "", 100.0, "answer"),
        (2, "", "error: " + "x" * 70_000, 100.0, "answer"),
        (0, '{"a": NaN}', "", 100.0, "answer"),
        (1, "", "error: no", 100.0, "traceback"),
        (-11, "", "", 100.0, "traceback"),
        (1, "", 'Traceback (most recent call last):\n  File "/x/lfpipe/a.py", line 3\nKeyError: 1\n', 100.0, "traceback"),
    ],
)
def test_what_counts_as_held(tmp_path: Path, code: int, out: str, err: str, peak: float, outcome: str) -> None:
    assert judged(CASE, tmp_path, code, out, err, peak).outcome == outcome


def test_what_a_refusal_leaves_is_a_half_applied_change(tmp_path: Path) -> None:
    (tmp_path / "out").touch()
    assert judged(CASE, tmp_path, 2, "", "error: no", 1.0).outcome == "half-applied"


def test_failures_are_counted_by_cause(tmp_path: Path) -> None:
    book = Book(1, tmp_path)
    for number in range(5):
        book.add("scenes", Outcome("hci: bytes", "traceback", "KeyError at x"), number, f"there-{number}")
    book.add("scenes", Outcome("hci: bytes", "refused", peak_mb=70.0))
    assert (book.inputs, book.failed, len(book.causes)) == (6, 5, 1)
    text = table(book)
    assert "| tracebacks, crashes, wrong exit codes | 5 |" in text
    assert "KeyError at x" in text


def test_the_address_of_the_page_with_and_without_a_token() -> None:
    assert Server.of("session 'a' on http://127.0.0.1:80/ (Ctrl-C ends)") == Server("127.0.0.1", 80, "")
    assert Server.of("session 'a' on http://127.0.0.1:80/?token=ab_c-1 (Ctrl-C ends)") == Server("127.0.0.1", 80, "ab_c-1")
    assert Server.of("starting") is None
    server = Server("127.0.0.1", 80, "secret")
    for number in range(300):
        kind, data, known = request(random.Random(number), server)
        assert known or not (b"token=secret" in data or b"=secret\r" in data), kind


def test_every_type_of_msgpack_occurs() -> None:
    from profiling.attack.messages import value

    kinds = set()
    for number in range(3000):
        try:
            kinds.add(type(msgpack.unpackb(value(random.Random(number)), strict_map_key=False)).__name__)
        except Exception:  # malformed on purpose
            kinds.add("malformed")
    assert {"NoneType", "bool", "int", "float", "str", "bytes", "list", "dict", "ExtType", "Timestamp", "malformed"} <= kinds
