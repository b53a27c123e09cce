"""Machines that lack a home directory, room, or a feature of Linux."""

import errno
import os
import re
from pathlib import Path
from typing import Any

import pytest

from lfpipe.host import home, segment


def nobody(_uid: int) -> Any:
    raise KeyError


def test_provide_home_gives_a_user_without_an_entry_a_folder_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", "/somewhere")
    home.provide_home()
    assert os.environ["HOME"] == "/somewhere"
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr("pwd.getpwuid", nobody)
    for _ in range(2):
        monkeypatch.delenv("HOME")
        home.provide_home()
        given = Path(os.environ["HOME"])
        assert given.parent == tmp_path and given.stat().st_mode & 0o777 == 0o700
    monkeypatch.delenv("HOME")
    other = given.stat().st_uid + 1
    monkeypatch.setattr("os.getuid", lambda: other)
    given.rename(tmp_path / f"lfpipe-home-{other}")  # put there by another user
    home.provide_home()
    assert Path(os.environ["HOME"]).stat().st_mode & 0o777 == 0o700
    assert not os.environ["HOME"].endswith(f"-{other}")


def test_more_room_is_more_than_there_is() -> None:
    total_mb = os.statvfs(segment.SHM_DIR).f_frsize * os.statvfs(segment.SHM_DIR).f_blocks >> 20
    remedy = segment.more_room(1 << 20)
    sizes = [int(digits) for digits in re.findall(r"size=(\d+)m", remedy)]
    assert len(sizes) == 2 and min(sizes) > total_mb


@pytest.mark.parametrize("code", segment.WITHOUT_TMPFILE)
def test_create_works_where_a_file_system_lacks_unnamed_files(
    code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = os.open

    def without(path: Any, flags: int, *more: Any, **named: Any) -> int:
        if flags & os.O_TMPFILE == os.O_TMPFILE:
            raise OSError(code, os.strerror(code))
        return real(path, flags, *more, **named)

    monkeypatch.setattr(os, "open", without)
    made = segment.create(f"lfp-test-{os.getpid()}-{errno.errorcode[code]}", 5000)
    assert made.size >= 5000 and made.in_place()
    made.unlink()
    made.close()
