"""Traces damaged by chance or on purpose, and places where no timeline can be written."""

import json
import os
import random
import stat
import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfpipe.errors import UserError
from lfpipe.files.line_file import LineFile
from lfpipe.files.output import check_output
from lfpipe.files.trace import TraceFile
from lfpipe.observe.timeline import check_out, convert, finish_trace
from tests import hostile_files as hostile
from tests.observe.test_timeline import line
from tests.world import World

LINES = [line(k, 10**9 + k * 33_000_000, (1000, 3000, 500, 4000, 100)) for k in range(6)]


def written(path: Path, lines: int = 6) -> Path:
    path.write_text("".join(json.dumps(each) + "\n" for each in LINES[:lines]))
    return path


@settings(max_examples=100)
@given(seed=st.integers(0, 2**32))
def test_a_damaged_trace_is_converted_or_refused(seed: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        trace, out = Path(folder) / "t.jsonl", Path(folder) / "t.json"
        trace.write_bytes(hostile.damaged_lines(random.Random(seed), LINES))
        try:
            count = convert(trace, out)
            assert len(json.loads(out.read_text(), parse_constant=pytest.fail)["traceEvents"]) == count
        except UserError as error:
            assert str(trace) in error.message and error.remedy and len(str(error)) <= 2000
            assert os.listdir(folder) == ["t.jsonl"]  # noqa: PTH208


@pytest.mark.parametrize("kind", sorted(set(hostile.NO_FILES) - {"empty"}))
def test_what_is_no_file_is_neither_read_nor_written(kind: str, tmp_path: Path) -> None:
    thing = tmp_path / "thing"
    hostile.NO_FILES[kind](thing)
    with pytest.raises(UserError, match="thing"):
        convert(thing, tmp_path / "out.json")
    if kind in ("2 TB", "4 GB", "dangling link"):
        return  # a file may be written there
    with pytest.raises(UserError, match="thing"):
        convert(written(tmp_path / "t.jsonl"), thing)
    with pytest.raises(UserError, match="thing"):
        check_out(thing)
    with pytest.raises(OSError):
        LineFile(thing)
    said: list[str] = []
    TraceFile(thing, said.append).write({"seq": 1})
    assert len(said) == 1 and "thing" in said[0]


@pytest.mark.parametrize("check", [check_out, check_output])
@pytest.mark.parametrize("place", ["/proc/x/t.json", "/proc/t.json", "gone/t.json", "file/t.json", "a\0b", "x" * 300, "/sys/t"])
def test_a_place_that_cannot_be_written_is_refused(check: object, place: str, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UserError) as caught:
        check(tmp_path / place)  # type: ignore[operator]
    assert caught.value.remedy


def test_a_conversion_that_fails_leaves_what_was_there(tmp_path: Path) -> None:
    out = tmp_path / "t.json"
    out.write_text("# written by lfpipe")
    (tmp_path / "bad.jsonl").write_text(json.dumps(LINES[0]) + "\n{}\n")
    with pytest.raises(UserError, match=r"bad\.jsonl.*line 2: source_seq is missing"):
        convert(tmp_path / "bad.jsonl", out)
    assert out.read_text() == "# written by lfpipe"
    assert convert(written(tmp_path / "good.jsonl"), out) > 20 and stat.S_IMODE(out.stat().st_mode) == 0o600


def test_a_timeline_that_cannot_be_left_is_kept(tmp_path: Path) -> None:
    part = written(tmp_path / "t.json.part")
    (tmp_path / "t.json").mkdir()
    asked: list[object] = []

    def ask(message: dict[str, object]) -> dict[str, object]:
        asked.append(message)
        return {"path": str(part)}

    with pytest.raises(UserError, match="is a directory"):
        finish_trace(ask, tmp_path)
    assert not asked, "it goes on"
    with pytest.raises(UserError) as caught:
        finish_trace(ask, None)
    assert str(part) in caught.value.remedy and part.exists()
    assert finish_trace(ask, tmp_path / "u.json").exists() and not part.exists()


def test_a_place_for_a_timeline_is_checked_before_it_begins(live: World, tmp_path: Path) -> None:
    named = ("--session", live.name)
    (tmp_path / "DIR").mkdir()
    for place in (tmp_path, tmp_path / "DIR", tmp_path / "gone" / "t.json", "/proc/t.json", "/dev/null"):
        done = live.run("trace", "start", place, *named)
        assert done.returncode == 2 and str(place) in done.stderr and "remedy" in done.stderr, done
    assert live.run("trace", "stop", *named).returncode == 2, "none runs"
    umask = os.umask(0)
    try:
        assert live.run("trace", "start", tmp_path / "t.json", *named).returncode == 0
        live.pictures(len(live.lines()) + 10)
        assert live.run("trace", "stop", tmp_path / "DIR", *named).returncode == 2
        assert stat.S_IMODE((tmp_path / "t.json.part").stat().st_mode) == 0o600
        assert live.run("trace", "stop", *named).returncode == 0
    finally:
        os.umask(umask)
    assert stat.S_IMODE((tmp_path / "t.json").stat().st_mode) == 0o600
    assert [path.name for path in (tmp_path / "DIR").iterdir()] == []
