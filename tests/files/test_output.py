"""What a command writes: nothing is lost, whatever path it is given, and what lfpipe wrote is
recognised.
"""

import json
import os
from pathlib import Path

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


def _refused(path: Path, *inputs: Path, force: bool = False, writes: str = "") -> bool:
    try:
        check_output(path, inputs, force, writes=writes)
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
    force=st.booleans(),
)
@example(b"hour,visits\n2026-11-21 15:00,12\n", False)  # look-alikes
@example(b"What was written by lfpipe\n", False)
@example(b'{"seq": 0}\n', False)
@example(b"[" * 100_000, False)
def test_what_others_wrote_is_refused_and_kept(
    tmp_path_factory: pytest.TempPathFactory, data: bytes, force: bool
) -> None:
    path = tmp_path_factory.getbasetemp() / "others" / "notes.txt"
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(data)
    before = _tree(path.parent)
    assert _refused(path, force=force) is not force
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


def test_places_that_are_no_files(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "file").write_bytes(b"")
    wrong = ["fifo", "loop", ".", "missing/x", "file/x", "n" * 300, "a\0b", "/dev/null"]
    assert [name for name in wrong if not _refused(tmp_path / name, force=True)] == []


def test_an_input_is_never_an_output(tmp_path: Path) -> None:
    scene = tmp_path / "scene"
    for name in ("sub", "new"):
        (scene / name).mkdir(parents=True)
    _written(scene, "png").rename(scene / "view.png")
    for name in ("new/inner.png", "hard.png"):
        (scene / name).hardlink_to(scene / "view.png")
    (scene / "soft.png").symlink_to("view.png")
    (scene / "link").symlink_to(".")
    before = _tree(tmp_path)
    for name in (
        "view.png",
        "sub/../view.png",
        "hard.png",
        "soft.png",
        "link/view.png",
        "new/inner.png",
    ):
        assert _refused(scene / name, scene, force=True) and _refused(
            scene / name, scene / "view.png", force=True
        )
    assert _tree(tmp_path) == before
    assert _refused(scene / "trace.jsonl", scene) and not _refused(tmp_path / "new.png", scene)


def test_what_another_command_reads_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "in.avi").write_bytes(b"")
    (tmp_path / "in.csv").write_bytes(b"seq,source_seq,epoch,t_sensor_ns,t_read_ns\n")
    (tmp_path / "theirs.avi").write_bytes(b"")
    (tmp_path / "theirs.csv").write_bytes(b"time\n")
    for name, file, head in (
        ("walk", "manifest.json", b'{\n "format": "lfpipe-sequence"'),
        ("ref", "report.json", b'{\n "format": 1,\n "versions": {\n  "lfpipe"'),
        ("bench", "results.json", b'{"format": "lfpipe-bench-6"'),
    ):
        (tmp_path / name).mkdir()
        (tmp_path / name / file).write_bytes(head)
        assert _refused(tmp_path / name / file, force=True)
    for new in ("walk/truth.csv", "walk/out.png", "ref/trace.jsonl", "ref/pictures/frames.bin"):
        (tmp_path / new).parent.mkdir(exist_ok=True)
        assert _refused(tmp_path / new, force=True), new
    assert not _refused(tmp_path / "bench" / "report.html")
    assert _refused(tmp_path / "in.csv", force=True)
    assert _refused(tmp_path / "in.csv", tmp_path / "in.avi", force=True, writes=TABLE)
    assert _refused(tmp_path / "theirs.csv", tmp_path / "theirs.avi", force=True)
    assert not _refused(tmp_path / "theirs.csv", force=True)


def test_a_file_of_several_names_is_kept(tmp_path: Path) -> None:
    path = _written(tmp_path, "jsonl")
    (tmp_path / "other").hardlink_to(path)
    assert _refused(path, force=True) and _refused(tmp_path / "other", force=True)


def test_two_outputs_of_one_command_differ(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("x")
    with pytest.raises(UserError, match="--trace"):
        check_outputs({"--display": tmp_path / "x", "--trace": tmp_path / "link"})
    check_outputs({"--display": tmp_path / "x", "--trace": tmp_path / "y", "--still": None})


def test_a_file_in_use_is_refused_until_its_writer_ends(tmp_path: Path) -> None:
    path = tmp_path / "t.jsonl"
    trace = TraceFile(path, pytest.fail)
    assert _refused(path, force=True)  # before its first line
    trace.write(LINE)
    assert json.loads(path.read_bytes()) == LINE  # can be read while it grows
    assert _refused(path, force=True)
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
