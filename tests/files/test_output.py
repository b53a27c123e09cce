"""What a command writes: nothing is lost, whatever path it is given, and what lfpipe wrote is
recognised.
"""

import json
import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from lfpipe.errors import UserError
from lfpipe.files.output import (
    MARK,
    TABLE,
    check_output,
    check_outputs,
    marked_picture,
    written_by_lfpipe,
)
from lfpipe.files.trace import TraceFile
from lfpipe.files.video_writer import VideoWriter
from tests.support.processes import largest_file

LINE = dict.fromkeys(
    (
        "seq",
        "source_seq",
        "epoch",
        "t_sensor_ns",
        "t_presented_ns",
        "eyes_used",
        "view",
        "composed",
    ),
    0,
)
PICTURE = np.arange(48 * 64 * 3, dtype=np.uint8).reshape(48, 64, 3)


def _tree(folder: Path) -> dict[str, tuple[int, bytes]]:
    """Name -> (inode, content) of every file."""
    return {
        str(p.relative_to(folder)): (p.stat().st_ino, p.read_bytes())
        for p in sorted(folder.rglob("*"))
        if p.is_file()
    }


def _refused(path: Path, *inputs: Path, overwrite: bool = False, writes: str = "") -> bool:
    try:
        check_output(path, inputs, overwrite, writes=writes)
    except UserError as error:
        assert error.remedy
        return True
    return False


JSON = st.recursive(
    st.integers() | st.text() | st.booleans(), lambda x: st.lists(x) | st.dictionaries(st.text(), x)
)


@settings(max_examples=150)
@given(
    data=st.binary(max_size=200).map(b".".__add__)
    | JSON.map(lambda value: json.dumps(value).encode()),
    overwrite=st.booleans(),
)
@example(b"hour,visits\n2026-11-21 15:00,12\n", False)  # look-alikes
@example(b"What was written by lfpipe\n", False)
@example(b'{"seq": 0}\n', False)
@example(b"[" * 100_000, False)
def test_files_of_other_programs_are_refused_and_kept(
    tmp_path_factory: pytest.TempPathFactory, data: bytes, overwrite: bool
) -> None:
    path = tmp_path_factory.getbasetemp() / "others" / "notes.txt"
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(data)
    before = _tree(path.parent)
    assert _refused(path, overwrite=overwrite) is not overwrite
    assert _tree(path.parent) == before


def _written(folder: Path, kind: str) -> Path:
    """A file that lfpipe wrote."""
    path = folder / f"ours.{kind}"
    if kind in ("png", "jpg"):
        path.write_bytes(marked_picture(cv2.imencode(f".{kind}", PICTURE)[1].tobytes()))
    elif kind in ("mkv", "avi", "mp4"):
        writer = VideoWriter(path, (64, 48), 30)
        for _ in range(3):
            writer.write(PICTURE)
        writer.release(path)
    elif kind == "jsonl":
        trace = TraceFile(path, pytest.fail)
        trace.write(LINE)
        trace.close()
    elif kind == "csv":
        path.write_bytes(b"seq,source_seq,epoch,t_sensor_ns,t_read_ns\n")
    else:
        path.write_bytes(
            {"html": b"<!doctype html>\n<!-- " + MARK + b" -->", "toml": b"# " + MARK, "txt": b""}[
                kind
            ]
        )
    return path


@pytest.mark.parametrize(
    "kind", ["png", "jpg", "mkv", "avi", "mp4", "jsonl", "csv", "html", "toml", "txt"]
)
def test_what_lfpipe_wrote_may_be_replaced(tmp_path: Path, kind: str) -> None:
    path = _written(tmp_path, kind)
    assert not _refused(path, writes=TABLE)
    assert _refused(path, path)  # but not if it is an input


def test_a_mark_changes_no_pixel(tmp_path: Path) -> None:
    for kind in ("png", "jpg"):
        plain = cv2.imencode(f".{kind}", PICTURE)[1]
        marked = np.asarray(cv2.imread(str(_written(tmp_path, kind))))
        assert np.array_equal(np.asarray(cv2.imdecode(plain, 1)), marked)
    for kind in ("mkv", "avi", "mp4"):
        video = cv2.VideoCapture(str(_written(tmp_path, kind)), cv2.CAP_FFMPEG)
        frames = [video.read() for _ in range(4)]
        assert [done for done, _ in frames] == [True] * 3 + [False]
        assert kind != "mkv" or np.array_equal(frames[2][1], PICTURE)


READ = {  # what commands read, and files of others
    "in.avi": b"",
    "in.csv": b"seq,source_seq,epoch,t_sensor_ns,t_read_ns\n",
    "theirs.avi": b"",
    "theirs.csv": b"time\n",
    "walk/manifest.json": b'{\n "format": "lfpipe-sequence"',
    "ref/report.json": b'{\n "format": 1,\n "versions": {\n  "lfpipe"',
    "ref/pictures/none": b"",
    "bench/results.json": b'{"format": "lfpipe-bench-5"',
    "scene/sub/none": b"",
    "scene/new/none": b"",
    "file": b"",
}
LINKS = {"loop": "loop", "scene/soft.png": "view.png", "scene/link": "."}
IN_SCENE = ("view.png", "sub/../view.png", "hard.png", "soft.png", "link/view.png", "new/inner.png")


@pytest.fixture
def read(tmp_path: Path) -> Path:
    for name, data in READ.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(data)
    for name, target in LINKS.items():
        (tmp_path / name).symlink_to(target)
    os.mkfifo(tmp_path / "fifo")
    _written(tmp_path, "png").rename(tmp_path / "scene/view.png")
    for name, other in (
        ("scene/new/inner.png", "scene/view.png"),
        ("scene/hard.png", "scene/view.png"),
        ("other", _written(tmp_path, "jsonl").name),
    ):
        (tmp_path / name).hardlink_to(tmp_path / other)
    return tmp_path


@pytest.mark.parametrize(
    ("name", "inputs", "more", "refused"),
    [
        # no files
        *(
            (name, [], {"overwrite": True}, True)
            for name in ("fifo", "loop", ".", "missing/x", "file/x", "n" * 300, "a\0b", "/dev/null")
        ),
        # a file of several names
        ("ours.jsonl", [], {"overwrite": True}, True),
        ("other", [], {"overwrite": True}, True),
        # an input
        *(
            (f"scene/{name}", [given], {"overwrite": True}, True)
            for name in IN_SCENE
            for given in ("scene", "scene/view.png")
        ),
        ("scene/trace.jsonl", ["scene"], {}, True),
        ("new.png", ["scene"], {}, False),
        # what another command reads
        *(
            (name, [], {"overwrite": True}, True)
            for name in (
                *("walk/manifest.json", "ref/report.json", "bench/results.json", "walk/truth.csv"),
                *("walk/out.png", "ref/trace.jsonl", "ref/pictures/frames.bin", "in.csv"),
            )
        ),
        ("bench/report.html", [], {}, False),
        ("in.csv", ["in.avi"], {"overwrite": True, "writes": TABLE}, True),
        ("theirs.csv", ["theirs.avi"], {"overwrite": True}, True),
        ("theirs.csv", [], {"overwrite": True}, False),
    ],
)
def test_no_file_that_is_read_or_none_is_replaced(
    read: Path, name: str, inputs: list[str], more: dict[str, Any], refused: bool
) -> None:
    before = _tree(read)
    assert _refused(read / name, *(read / given for given in inputs), **more) == refused
    assert _tree(read) == before


def test_two_outputs_of_one_command_differ(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("x")
    with pytest.raises(UserError, match="--trace"):
        check_outputs({"--display": tmp_path / "x", "--trace": tmp_path / "link"})
    check_outputs({"--display": tmp_path / "x", "--trace": tmp_path / "y", "--still": None})


def test_a_file_in_use_is_refused_until_its_writer_ends(tmp_path: Path) -> None:
    path = tmp_path / "t.jsonl"
    trace = TraceFile(path, pytest.fail)
    assert _refused(path, overwrite=True)  # before its first line
    trace.write(LINE)
    assert json.loads(path.read_bytes()) == LINE  # can be read while it grows
    assert _refused(path, overwrite=True)
    trace.close()
    assert not _refused(path) and written_by_lfpipe(path)


def test_a_full_disk_keeps_the_trace_of_an_earlier_session(tmp_path: Path) -> None:
    path = tmp_path / "t.jsonl"
    old = _written(tmp_path, "jsonl").rename(path).read_bytes()
    lost: list[str] = []
    trace = TraceFile(path, lost.append)
    with largest_file(10):
        trace.write(LINE)
    assert len(lost) == 1 and not trace.wanted
    assert path.read_bytes() == old and [p.name for p in tmp_path.iterdir()] == ["t.jsonl"]
