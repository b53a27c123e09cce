"""The only functions that read and write files at paths from users."""

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from lfpipe.errors import UserError
from lfpipe.files import safe_files
from tests.support import hostile_files
from tests.support.processes import open_umask


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("kind", sorted(set(hostile_files.NO_FILES) - {"empty"}))
def test_what_is_no_file_is_refused_at_once_by_name(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "thing"
    hostile_files.NO_FILES[kind](path)
    with pytest.raises(UserError, match="thing: cannot be read: ") as caught:
        safe_files.read_text(path, 1000, str(path), "another one")
    assert "another one" in str(caught.value)


def test_no_more_is_read_than_may_be(tmp_path: Path) -> None:
    path = tmp_path / "text"
    path.write_bytes(b"x" * 1000)
    assert safe_files.read_bytes(path, 1000) == b"x" * 1000
    with pytest.raises(OSError, match="has more than 999 bytes"):
        safe_files.read_bytes(path, 999)
    with pytest.raises(UserError, match="has 1000 bytes; at most 999"):
        safe_files.open_file(path, 999)
    assert len(safe_files.read_bytes(Path("/proc/self/status"), 100_000)) > 100, (
        "a file that does not know its size"
    )
    with pytest.raises(OSError, match="more than 10 bytes"):
        safe_files.read_bytes(Path("/proc/self/status"), 10)


def test_a_path_that_is_none_and_a_text_that_is_none(tmp_path: Path) -> None:
    for path in (Path("a\0b"), tmp_path / ("x" * 300), tmp_path / "gone" / "x"):
        with pytest.raises(UserError, match="cannot be read"):
            safe_files.read_text(path, 10, repr(path), "r")
    (tmp_path / "t").write_bytes(b"ab\xff")
    with pytest.raises(UserError, match="not UTF-8: byte 0xff at 2"):
        safe_files.read_text(tmp_path / "t", 10, "t", "r")


def test_links_out_of_a_folder_are_refused(tmp_path: Path) -> None:
    for folder in ("a", "b", "a/row"):
        (tmp_path / folder).mkdir()
    (tmp_path / "a" / "inside").symlink_to("row")
    (tmp_path / "a" / "loop").symlink_to("loop")
    (tmp_path / "a" / "outside").symlink_to("../b")
    safe_files.check_links(tmp_path / "a", ["inside", "inside/x", "loop", "row/x", "x"])
    for name in ("outside", "outside/x"):
        with pytest.raises(UserError, match="outside of the folder"):
            safe_files.check_links(tmp_path / "a", ["x", name])


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "report"
    with safe_files.replaced(path) as file:
        file.write(b"old")
    with pytest.raises(RuntimeError), safe_files.replaced(path) as file:
        file.write(b"new")
        raise RuntimeError
    assert path.read_bytes() == b"old" and names(tmp_path) == ["report"]
    link = tmp_path / "link"
    link.symlink_to(path)
    with safe_files.replaced(link, 0o644) as file:
        file.write(b"new")
        file.flush()
        assert path.read_bytes() == b"old" and Path(file.name).read_bytes() == b"new"
    assert (
        path.read_bytes() == b"new" and link.is_symlink() and names(tmp_path) == ["link", "report"]
    )
    for kind in ("fifo", "directory", "endless device", "link to itself"):
        hostile_files.NO_FILES[kind](tmp_path / kind)
        with pytest.raises(OSError), safe_files.replaced(tmp_path / kind):
            pass


def test_what_shows_a_person_is_for_its_owner(tmp_path: Path) -> None:
    with open_umask():
        with safe_files.create_private(tmp_path / "a"), safe_files.replaced(tmp_path / "b"):
            pass
        with pytest.raises(FileExistsError):
            safe_files.create_private(tmp_path / "a")
    assert {stat.S_IMODE((tmp_path / name).stat().st_mode) for name in "ab"} == {0o600}


def test_of_two_writers_the_later_one_is_refused_and_the_file_in_use_stays(tmp_path: Path) -> None:
    path = tmp_path / "video.mkv"
    first, second = safe_files.OutputFile(path), safe_files.OutputFile(path)
    first.file.write(b"first")
    first.file.flush()
    first.place()
    with pytest.raises(OSError, match="another lfpipe"):
        second.place()
    with pytest.raises(OSError, match="another lfpipe"):
        safe_files.OutputFile(path)
    second.close()
    first.close()
    assert path.read_bytes() == b"first" and names(tmp_path) == ["video.mkv"]


@pytest.mark.parametrize("name", [".b.new.png", ".report.new", "x" * 250, f"{'x' * 180}.png"])
def test_no_file_beside_is_taken_for_unfinished_work(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"mine")
    (tmp_path / f".{name[:180]}.new").write_bytes(b"mine")
    before = names(tmp_path)
    for other in ("b.png", "report", f"{'x' * 180}1.png"):
        safe_files.write_file(tmp_path / other, b"new")
        (tmp_path / other).unlink()
    assert names(tmp_path) == before and (tmp_path / name).read_bytes() == b"mine"


def test_a_file_stays_as_private_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "config.toml"
    path.touch(0o600)
    safe_files.write_file(path, b"", 0o644)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


HOLD = """
import sys, time
from lfpipe.files.safe_files import temporary_folder
with temporary_folder("test") as folder:
    (folder / "face.png").write_bytes(b"private")
    print(folder, flush=True)
    time.sleep(100)
"""


def test_a_temporary_folder_of_a_killed_process_is_removed_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    (tmp_path / "lfpipe-test-notes").mkdir()
    (tmp_path / "lfpipe-test-notes" / "mine.txt").write_text("mine")
    (tmp_path / "lfpipe-test-file").write_text("mine")
    (tmp_path / "lfpipe-test-link").symlink_to("lfpipe-test-notes")
    env = {**os.environ, "TMPDIR": str(tmp_path)}
    running = [
        subprocess.Popen([sys.executable, "-c", HOLD], env=env, stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    try:
        killed, living = (Path(p.stdout.readline().strip()) for p in running if p.stdout)
        running[0].kill()
        running[0].wait()
        assert killed.is_dir()
        with safe_files.temporary_folder("test") as folder:
            assert stat.S_IMODE(folder.parent.stat().st_mode) == 0o700
            assert not killed.parent.exists() and living.is_dir()
        assert not folder.parent.exists()
    finally:
        for process in running:
            process.kill()
            process.communicate()
    assert {"lfpipe-test-file", "lfpipe-test-link", "lfpipe-test-notes"} <= set(names(tmp_path))
    assert (tmp_path / "lfpipe-test-notes" / "mine.txt").read_text() == "mine"
