"""Segments identify their owner and whether its session lives, whatever else is in shared
memory.
"""

import signal
import string
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from lfpipe.host import segment
from lfpipe.supervisor import rundir
from lfpipe.transport.session import Session

PAGE = segment.PAGE


@pytest.fixture
def prefix() -> Iterator[str]:
    """Of names that are removed afterwards."""
    made = f"{segment.PREFIX}{time.monotonic_ns() % 10**12:012d}-"
    yield made
    for name in sorted(entry.name for entry in segment.SHM_DIR.glob(f"{made}*")):
        segment.unlink(name)


def page(path: bytes, length: int | None = None, magic: bytes = segment.MAGIC) -> bytes:
    return (
        magic + (len(path) if length is None else length).to_bytes(8, "little", signed=True) + path
    )[:PAGE].ljust(PAGE, b"\0")


@pytest.mark.native("a segment that names its owner itself")
@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    last=st.one_of(
        st.binary(max_size=64),
        st.binary(max_size=PAGE).map(page),
        st.builds(page, st.binary(max_size=30), st.integers(-(2**63), 2**63 - 1)),
        st.builds(
            page,
            st.text(string.printable, max_size=30).map(lambda text: b"/nowhere/" + text.encode()),
        ),
    ),
    pages=st.integers(0, 2),
)
@example(last=page(b"/nowhere/a\0b"), pages=1)
@example(last=page(b"/nowhere/" + b"x" * 4000), pages=1)
@example(last=page(b"/" + b"x/" * 2030), pages=1)
@example(last=page(b"\xff\xfe"), pages=1)
@example(last=page(b"", 2**62), pages=1)
def test_owned_takes_whatever_a_file_says_of_itself(
    prefix: str, base: Path, last: bytes, pages: int
) -> None:
    """And what does not bear the mark is there afterwards."""
    path = segment.SHM_DIR / f"{prefix}x"
    path.write_bytes(bytes(pages * PAGE) + last)
    marked = path.name in segment.owned()
    assert marked == (path.name in dict(segment.abandoned(prefix)))
    rundir.sweep()
    assert marked or path.exists()
    path.unlink(missing_ok=True)


@pytest.fixture
def base(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path


NAMES = st.text(string.ascii_letters + string.digits + "_.", min_size=1, max_size=32).filter(
    lambda text: text[0] not in "_."
)
PARTS = st.one_of(
    st.sampled_from(["status", "frames", "eyes"]),
    st.builds("{}.{}".format, st.sampled_from(["packets", "pictures"]), st.integers(1, 10**12)),
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(each=st.sets(st.tuples(NAMES, PARTS), max_size=20))
def test_segment_gives_every_ring_its_own_name(base: Path, each: set[tuple[str, str]]) -> None:
    names = [Session(name, "token").segment(part) for name, part in each]
    assert len(set(names)) == len(each)


@pytest.mark.native("a lock that ends with its descriptor")
def test_segment_is_abandoned_when_its_maker_ends(prefix: str) -> None:
    made = segment.create(f"{prefix}x", 100, Path("/nowhere/run"))
    assert not list(segment.abandoned(prefix))
    assert segment.owned(prefix) == {f"{prefix}x": Path("/nowhere/run")}
    reader = segment.attach(f"{prefix}x")
    made.close()
    assert dict(segment.abandoned(prefix)) == {f"{prefix}x": Path("/nowhere/run")}, (
        "readers do not keep it"
    )
    reader.close()
    made.unlink()
    assert not segment.owned(prefix)


def test_unlink_removes_no_other_segment_of_its_name(prefix: str) -> None:
    first = segment.create(f"{prefix}x", 100)
    segment.unlink(f"{prefix}x")
    second = segment.create(f"{prefix}x", 100)
    with pytest.raises(FileNotFoundError):
        first.unlink()
    second.unlink()
    with pytest.raises(FileNotFoundError):
        second.unlink()
    first.close()
    second.close()


MAKE = """
import sys
from lfpipe.host import segment
print(flush=True)
for k in range(10**9):
    made = segment.create(f"{sys.argv[1]}{k % 20}", 10000)
    if k >= 20 - 10:
        old = f"{sys.argv[1]}{(k - 10) % 20}"
        kept.pop(0).unlink()
    kept = [*(kept if k else []), made]
"""


def test_segment_of_a_killed_process_is_whole(prefix: str) -> None:
    for k in range(8):
        maker = subprocess.Popen(
            [sys.executable, "-c", MAKE, f"{prefix}{k}."],
            stdout=subprocess.PIPE,
            cwd=Path(__file__).parents[2],
        )
        assert maker.stdout is not None
        maker.stdout.readline()
        time.sleep(0.01 + 0.0037 * k)
        maker.send_signal(signal.SIGKILL)
        maker.communicate(timeout=60)
    found = sorted(entry.name for entry in segment.SHM_DIR.glob(f"{prefix}*"))
    assert found and found == sorted(segment.owned(prefix)) == sorted(
        name for name, _ in segment.abandoned(prefix)
    )


def test_segment_create_starts_no_process(prefix: str) -> None:
    """Python's tracker would be one, and has something to say of what its process left."""
    script = (
        f"from lfpipe.host import segment; segment.create('{prefix}x', 100); import os; os._exit(0)"
    )
    words = [sys.executable, "-c", script]
    done = subprocess.run(words, capture_output=True, cwd=Path(__file__).parents[2])
    assert done.returncode == 0 and not done.stderr and segment.owned(prefix)
