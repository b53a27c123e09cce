"""The only functions that read and write files at paths from users."""

import os
import stat
from pathlib import Path

import pytest

from lfpipe.errors import UserError
from lfpipe.files import safe_files
from tests import hostile_files


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
    safe_files.OutputFile(path).file.close()  # as a killed writer leaves it
    assert names(tmp_path) == [".report.new", "report"]
    link = tmp_path / "link"
    link.symlink_to(path)
    with safe_files.replaced(link, 0o644) as file:
        file.write(b"new")
        file.flush()
        assert path.read_bytes() == b"old" and Path(file.name).read_bytes() == b"new"
        with pytest.raises(OSError, match="another lfpipe"), safe_files.replaced(path):
            pass
    assert (
        path.read_bytes() == b"new" and link.is_symlink() and names(tmp_path) == ["link", "report"]
    )
    for kind in ("fifo", "directory", "endless device", "link to itself"):
        hostile_files.NO_FILES[kind](tmp_path / kind)
        with pytest.raises(OSError), safe_files.replaced(tmp_path / kind):
            pass


def test_what_shows_a_person_is_for_its_owner(tmp_path: Path) -> None:
    umask = os.umask(0)
    try:
        with safe_files.create_private(tmp_path / "a"), safe_files.replaced(tmp_path / "b"):
            pass
        with pytest.raises(FileExistsError):
            safe_files.create_private(tmp_path / "a")
    finally:
        os.umask(umask)
    assert {stat.S_IMODE((tmp_path / name).stat().st_mode) for name in "ab"} == {0o600}
