"""The only functions that read and write files at paths from users."""

import stat
from collections.abc import Callable
from pathlib import Path

import pytest

from lfpipe import config
from lfpipe.capture.recordings import open_recording
from lfpipe.config.check import load
from lfpipe.errors import UserError
from lfpipe.files import safe_files
from lfpipe.replays.run import read_report
from lfpipe.scene.layouts import describe
from lfpipe.sequence.folder import open_sequence
from tests.scene import made
from tests.support import hostile_files
from tests.support.hostile_sequences import made_sequence
from tests.support.processes import largest_file, open_umask
from tests.support.refusal import refusal


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


STATUS = Path("/proc/self/status")  # a file that does not know its size
NO_FILES = [f"no files/{kind}" for kind in sorted(set(hostile_files.NO_FILES) - {"empty"})]
Read = Callable[[Path], object]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("a/row", "b", "no files"):
        (tmp_path / name).mkdir(parents=True)
    for name, target in (("inside", "row"), ("loop", "loop"), ("outside", "../b")):
        (tmp_path / "a" / name).symlink_to(target)
    (tmp_path / "1000").write_bytes(b"x" * 1000)
    (tmp_path / "latin").write_bytes(b"ab\xff")
    for name in NO_FILES:
        hostile_files.NO_FILES[name.partition("/")[2]](tmp_path / name)
    return tmp_path


def text(name: str) -> Read:
    return lambda folder: safe_files.read_text(folder / name, name, "another one")


def links(*names: str) -> Read:
    return lambda folder: safe_files.check_links(folder / "a", names)


@pytest.mark.parametrize(
    ("read", "error", "why"),
    [
        *(
            (text(name), UserError, f"{name}: cannot be read: .*\n.*another one")
            for name in (*NO_FILES, "x" * 300, "gone/x")
        ),
        (text("a\0b"), UserError, r"a.*b: cannot be read: .*\n.*another one"),
        (text("latin"), UserError, "not UTF-8: byte 0xff at 2"),
        (lambda f: safe_files.read_bytes(f / "1000", 999), OSError, "has more than 999 bytes"),
        (
            lambda f: safe_files.open_file(f / "1000", 999),
            UserError,
            "has 1000 bytes; at most 999",
        ),
        (lambda f: safe_files.read_bytes(STATUS, 10), OSError, "more than 10 bytes"),
        (links("x", "outside"), UserError, "outside of the folder"),
        (links("x", "outside/x"), UserError, "outside of the folder"),
    ],
)
def test_forbidden_files_are_refused_by_name(
    folder: Path, read: Read, error: type[Exception], why: str
) -> None:
    with pytest.raises(error, match=f"(?s){why}"):
        read(folder)


def test_what_may_be_read_is(folder: Path) -> None:
    links("inside", "inside/x", "loop", "row/x", "x")(folder)
    assert safe_files.read_bytes(folder / "1000", 1000) == b"x" * 1000
    assert len(safe_files.read_bytes(STATUS, 100_000)) > 100


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


def test_half_a_line_of_a_killed_writer_or_a_full_disk_is_cut_off(tmp_path: Path) -> None:
    path = tmp_path / "requests.jsonl"
    path.write_bytes(b"1\n2")
    lines = safe_files.LineFile(path)
    lines.append(b"3\n")
    with largest_file(7), pytest.raises(OSError):
        lines.append(b"more than fits\n")
    assert path.read_bytes() == b"1\n3\n"


def test_a_file_stays_as_private_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "config.toml"
    path.touch(0o600)
    safe_files.write_file(path, b"", 0o644)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


LFS = b"version https://git-lfs.github.com/spec/v1\noid sha256:%s\nsize 9\n" % (b"0" * 64)


@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("walk/frames.bin", open_sequence),
        ("walk/frames.jsonl", open_sequence),
        ("walk/manifest.json", open_sequence),
        ("report.json", lambda path: read_report(path.parent)),
        ("v.toml", load),
        ("scene/view_0_1.png", lambda path: describe(path.parent, config.Scene())),
        ("lf.npy", lambda path: describe(path, config.Scene())),
        ("film.mp4", lambda path: describe(path, config.Scene())),
        ("film.avi", open_recording),
    ],
)
def test_pointer_of_git_lfs_is_named_wherever_a_file_is_read(
    name: str, read: Callable[[Path], object], tmp_path: Path
) -> None:
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    if path.parent.name == "walk":
        path.parent.rmdir()
        made_sequence(path.parent)
    if path.parent.name == "scene":
        made.write_grid(path.parent, made.views(1, 3, 24, 32), "view_{r}_{c}.png")
    path.write_bytes(LFS)
    error = refusal(read, path.parent if path.parent.name == "walk" else path)
    assert path.name in error.message and "Git LFS" in error.message
    assert "git lfs pull" in error.message
