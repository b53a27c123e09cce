"""What a command writes: nothing is lost, whatever path it is given, and what lfpipe wrote is recognised."""

import json
import os
import threading
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lfpipe.errors import UserError
from lfpipe.files.output import (
    MARK,
    OutputFile,
    check_output,
    check_outputs,
    mark_video,
    marked_picture,
    output_file,
    written_by_lfpipe,
)
from lfpipe.files.trace import TraceFile

LINE = {
    "seq": 0,
    "source_seq": 0,
    "epoch": 0,
    "t_sensor_ns": 1,
    "t_presented_ns": 2,
    "eyes_used": {},
    "view": {},
    "composed": True,
}
PICTURE = np.arange(48 * 64 * 3, dtype=np.uint8).reshape(48, 64, 3)


def _tree(folder: Path) -> dict[str, tuple[int, bytes]]:
    """Name -> (inode, content) of every file."""
    return {str(p.relative_to(folder)): (p.stat().st_ino, p.read_bytes()) for p in sorted(folder.rglob("*")) if p.is_file()}


def _refused(path: Path, *inputs: Path, force: bool = False) -> bool:
    try:
        check_output(path, inputs, force)
    except UserError as error:
        assert error.remedy
        return True
    return False


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.binary(min_size=1, max_size=200) | st.text(min_size=1, max_size=100).map(str.encode), force=st.booleans())
def test_what_others_wrote_is_refused_and_kept(tmp_path: Path, data: bytes, force: bool) -> None:
    path = tmp_path / "notes.txt"
    path.write_bytes(data)
    before = _tree(tmp_path)
    assert _refused(path, force=force) is not force
    assert _tree(tmp_path) == before


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.recursive(st.integers() | st.text() | st.booleans(), lambda x: st.lists(x) | st.dictionaries(st.text(), x)))
def test_json_of_others_is_refused(tmp_path: Path, value: object) -> None:
    path = tmp_path / "data.json"
    path.write_text(json.dumps(value))
    assert _refused(path)


def _written(folder: Path, kind: str) -> Path:
    """A file that lfpipe wrote."""
    path = folder / f"ours.{kind}"
    if kind in ("png", "jpg"):
        path.write_bytes(marked_picture(cv2.imencode(f".{kind}", PICTURE)[1].tobytes()))
    elif kind in ("mkv", "avi"):
        writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"HFYU"), 30, (64, 48))
        for _ in range(3):
            writer.write(PICTURE)
        writer.release()
        assert not written_by_lfpipe(path)
        assert mark_video(path)
    elif kind == "jsonl":
        trace = TraceFile(path, pytest.fail)
        trace.write(LINE)
        trace.close()
    elif kind == "csv":
        path.write_bytes(b"seq,source_seq,epoch,t_sensor_ns,t_read_ns\n")
    else:
        path.write_bytes({"html": b"<!doctype html>\n<!-- " + MARK + b" -->", "toml": b"# " + MARK, "txt": b""}[kind])
    return path


@pytest.mark.parametrize("kind", ["png", "jpg", "mkv", "avi", "jsonl", "csv", "html", "toml", "txt"])
def test_what_lfpipe_wrote_may_be_replaced(tmp_path: Path, kind: str) -> None:
    path = _written(tmp_path, kind)
    assert not _refused(path)
    assert _refused(path, path)  # but not if it is an input


def test_a_mark_changes_no_pixel(tmp_path: Path) -> None:
    for kind in ("png", "jpg"):
        plain = cv2.imencode(f".{kind}", PICTURE)[1]
        marked = np.frombuffer(marked_picture(plain.tobytes()), np.uint8)
        assert np.array_equal(cv2.imdecode(plain, 1), cv2.imdecode(marked, 1))
    for kind in ("mkv", "avi"):
        video = cv2.VideoCapture(str(_written(tmp_path, kind)), cv2.CAP_FFMPEG)
        frames = [video.read() for _ in range(4)]
        assert [done for done, _ in frames] == [True] * 3 + [False]
        assert np.array_equal(frames[2][1], PICTURE)


@pytest.mark.parametrize(
    "text", [b"hour,visits\n2026-11-21 15:00,12\n", b"What was written by lfpipe\n", b'{"seq": 0}\n', b"[" * 100_000]
)
def test_look_alikes_are_not_ours(tmp_path: Path, text: bytes) -> None:
    path = tmp_path / "x"
    path.write_bytes(text)
    assert _refused(path)


def test_places_that_are_no_files(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "file").write_bytes(b"")
    wrong = ["fifo", "loop", ".", "missing/x", "file/x", "n" * 300, "a\0b"]
    assert [name for name in wrong if not _refused(tmp_path / name, force=True)] == []
    assert _refused(Path("/dev/null"), force=True)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(name=st.sampled_from(["view.png", "sub/../view.png", "hard.png", "soft.png", "link/view.png", "new/inner.png"]))
def test_an_input_is_never_an_output(tmp_path: Path, name: str) -> None:
    scene = tmp_path / "scene"
    if not scene.exists():
        (scene / "sub").mkdir(parents=True)
        (scene / "new").mkdir()
        _written(scene, "png").rename(scene / "view.png")
        (scene / "new" / "inner.png").hardlink_to(scene / "view.png")
        (scene / "hard.png").hardlink_to(scene / "view.png")
        (scene / "soft.png").symlink_to("view.png")
        (scene / "link").symlink_to(".")
    before = _tree(tmp_path)
    assert _refused(scene / name, scene, force=True)
    assert _refused(scene / name, scene / "view.png", force=True)
    assert _tree(tmp_path) == before
    assert not _refused(scene / "trace.jsonl", scene)


def test_two_outputs_of_one_command_differ(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("x")
    with pytest.raises(UserError, match="--trace"):
        check_outputs({"--display": tmp_path / "x", "--trace": tmp_path / "link"})
    check_outputs({"--display": tmp_path / "x", "--trace": tmp_path / "y", "--still": None})


def test_a_file_in_use_is_refused_until_its_writer_ends(tmp_path: Path) -> None:
    path = tmp_path / "t.jsonl"
    trace = TraceFile(path, pytest.fail)
    assert _refused(path, force=True)  # before its first line
    assert not path.exists()
    trace.write(LINE)
    assert json.loads(path.read_bytes()) == LINE  # can be read while it grows
    assert _refused(path, force=True)
    trace.close()
    assert not _refused(path)


def test_an_output_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "out.bin"
    path.write_bytes(b"old")
    seen, stop = set(), threading.Event()

    def read() -> None:
        while not stop.is_set():
            seen.add(path.read_bytes())

    reader = threading.Thread(target=read)
    reader.start()
    try:
        with output_file(path) as file:
            for _ in range(2000):
                file.write(b"new" * 100)
    finally:
        stop.set()
        reader.join()
    assert seen <= {b"old", b"new" * 200_000}
    with pytest.raises(ZeroDivisionError), output_file(path):
        _ = 1 / 0
    assert path.read_bytes() == b"new" * 200_000
    assert [p.name for p in tmp_path.iterdir()] == ["out.bin"]


def test_a_killed_writers_leftover_is_removed(tmp_path: Path) -> None:
    path = tmp_path / "out.mkv"
    left = OutputFile(path)
    left.file.close()  # as a killed process leaves it
    OutputFile(path).close()
    assert list(tmp_path.iterdir()) == []


def test_a_restarted_writer_goes_on_and_a_new_session_begins_anew(tmp_path: Path) -> None:
    path, began = tmp_path / "t.jsonl", tmp_path / "session.json"
    for since, lines in ((None, 1), (began, 2), (None, 1)):
        began.touch()
        os.utime(began, ns=(1, 1))
        trace = TraceFile(path, pytest.fail, since)
        trace.write(LINE)
        trace.close()
        assert path.read_bytes().count(b"\n") == lines
