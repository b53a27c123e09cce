"""What a command writes: no input and no file that exists is replaced, unless `--overwrite`."""

import os
from pathlib import Path

import pytest

from lfpipe.errors import UserError
from lfpipe.files.safe_files import TraceFile, check_output
from tests.support.processes import largest_file


@pytest.fixture
def here(tmp_path: Path) -> Path:
    (tmp_path / "scene").mkdir()
    for name in ("mine.txt", "scene/view.png"):
        (tmp_path / name).write_text("mine")
    for name, target in (("loop", "loop"), ("soft.png", "scene/view.png"), ("link", "scene")):
        (tmp_path / name).symlink_to(target)
    os.mkfifo(tmp_path / "fifo")
    return tmp_path


@pytest.mark.parametrize(
    ("name", "inputs", "overwrite", "said"),
    [
        *(
            (name, [], True, name[:20])
            for name in ("fifo", "loop", "scene", "missing/x", "mine.txt/x", "n" * 300, "/dev/null")
        ),
        ("a\0b", [], True, "null"),
        ("mine.txt", [], False, "mine.txt: already exists"),
        ("mine.txt", [], None, "mine.txt: already exists"),
        ("mine.txt", [], True, ""),
        ("new.txt", [], False, ""),
        *(
            (name, [given], True, "which this command reads")
            for name in ("scene/view.png", "soft.png", "link/view.png")
            for given in ("scene", "scene/view.png", "link")
        ),
        ("scene/trace.jsonl", ["scene"], True, "which this command reads"),
        ("new.png", ["scene"], False, ""),
    ],
)
def test_no_input_and_nothing_that_exists_is_replaced(
    here: Path, name: str, inputs: list[str], overwrite: bool | None, said: str
) -> None:
    before = sorted(here.rglob("*"))
    try:
        check_output(here / name, [here / given for given in inputs], overwrite)
    except UserError as error:
        assert said and said in error.message and error.remedy
        assert ("--overwrite" in error.remedy) == (overwrite is False)
    else:
        assert not said
    assert sorted(here.rglob("*")) == before


def test_a_full_disk_keeps_the_trace_of_an_earlier_session(tmp_path: Path) -> None:
    path = tmp_path / "t.jsonl"
    path.write_text("old\n")
    lost: list[str] = []
    trace = TraceFile(path, lost.append)
    with largest_file(10):
        for _ in range(2):
            trace.write(dict.fromkeys(("seq", "source_seq", "t_presented_ns"), 0))
    assert len(lost) == 1 and "t.jsonl" in lost[0] and "it ends here" in lost[0]
    assert path.read_text() == "old\n" and [p.name for p in tmp_path.iterdir()] == ["t.jsonl"]
