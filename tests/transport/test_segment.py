"""Shared memory has its name when it is complete, and its room before it is used."""

import errno
import re
import shutil
import signal
import stat
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from lfpipe.errors import UserError
from lfpipe.host import files
from lfpipe.host.files import Segment
from tests.support.world import until


@pytest.fixture
def path(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """In memory, of whose size the file can take more than there is."""
    folder = files.SHM_DIR / f"lfpipe-test-{time.monotonic_ns()}"
    folder.mkdir()
    yield folder / "x.ring"
    shutil.rmtree(folder)


def test_segment_has_its_name_when_it_is_complete(path: Path) -> None:
    made = files.create_segment(path, 100)
    assert not path.exists() and made.size == files.PAGE
    files.publish_segment(made, path)
    assert made.in_place() and stat.S_IMODE(path.stat().st_mode) == 0o600
    assert path.stat().st_blocks * 512 >= files.PAGE, "its memory is reserved"
    second = files.create_segment(path, 100)
    files.publish_segment(second, path)
    made.remove()
    assert second.in_place(), "the name is that of another one now"
    second.remove()
    assert not list(path.parent.iterdir())


def test_segment_create_without_memory_leaves_nothing(path: Path) -> None:
    total = shutil.disk_usage(path.parent).total
    with pytest.raises(UserError, match=r"MB free of .* needs") as error:
        files.create_segment(path, total * 2)
    sizes = [int(digits) for digits in re.findall(r"size=(\d+)m", error.value.remedy)]
    assert len(sizes) == 2 and min(sizes) > 2 * total >> 20
    assert not list(path.parent.iterdir())


MAKE = """
import sys
from pathlib import Path
from lfpipe.host import files
print(flush=True)
for k in range(10**9):
    path = Path(sys.argv[1]) / f"{k % 20}.ring"
    made = files.create_segment(path, 10000)
    made.buf[:1] = b"x"
    files.publish_segment(made, path)
    made.close()
"""


def test_segment_of_a_killed_process_is_whole(path: Path) -> None:
    for k in range(8):
        maker = subprocess.Popen(
            [sys.executable, "-c", MAKE, path.parent],
            stdout=subprocess.PIPE,
            cwd=Path(__file__).parents[2],
        )
        assert maker.stdout is not None
        maker.stdout.readline()
        until(lambda: any(path.parent.glob("[0-9]*.ring")), "the first segment")
        for _ in range(37 * k):  # for ever longer
            list(path.parent.iterdir())
        maker.send_signal(signal.SIGKILL)
        maker.communicate(timeout=60)
    found = [Segment(one) for one in path.parent.glob("[0-9]*.ring")]
    assert all(one.buf[0] == ord("x") and one.size == 3 * files.PAGE for one in found)
    for one in found:
        one.close()


def test_segment_refuses_a_link(path: Path) -> None:
    path.symlink_to("/dev/zero")
    with pytest.raises(OSError) as error:
        Segment(path)
    assert error.value.errno == errno.ELOOP
