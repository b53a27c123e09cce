"""Machines that lack room, or a feature of Linux."""

import errno
import os
import re
from typing import Any

import pytest

from lfpipe.host import segment


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
