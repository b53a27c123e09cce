"""The source of the fence on machines that need one."""

import ctypes
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lfpipe.errors import UserError
from lfpipe.host import fence
from lfpipe.transport import ring


@pytest.fixture(autouse=True)
def forgotten() -> Iterator[None]:
    fence._full_fence.cache_clear()
    yield
    fence._full_fence.cache_clear()


def only(monkeypatch: pytest.MonkeyPatch, **libraries: Any) -> None:
    """The only libraries of this machine; "own" is the C library."""

    def load(name: str | None) -> Any:
        try:
            return libraries[(name or "own").partition(".")[0]]
        except KeyError:
            raise OSError(f"{name}: cannot open shared object file") from None

    monkeypatch.setattr(ctypes, "CDLL", load)
    monkeypatch.setattr(ctypes.util, "find_library", lambda name: None)


def test_libatomic_gives_a_sequentially_consistent_fence(monkeypatch: pytest.MonkeyPatch) -> None:
    called: list[int] = []
    only(monkeypatch, libatomic=SimpleNamespace(atomic_thread_fence=called.append), own=SimpleNamespace())
    fence._fence()
    fence._fence()
    assert called == [fence.SEQ_CST] * 2


def test_the_c_library_s_own_is_taken_where_libatomic_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    called: list[str] = []
    only(monkeypatch, own=SimpleNamespace(OSMemoryBarrier=lambda: called.append("own")))
    fence._fence()
    assert called == ["own"]


def test_a_machine_without_a_fence_is_refused_before_a_ring_exists(monkeypatch: pytest.MonkeyPatch) -> None:
    only(monkeypatch, own=SimpleNamespace())
    monkeypatch.setattr(ring, "fence", fence._fence)
    with pytest.raises(UserError, match="libatomic is not installed") as error:
        ring.create("lfpipe-test-no-fence", ring.RingSpec((4,), np.dtype("u1")))
    assert "libatomic1" in error.value.remedy
    monkeypatch.undo()
    with pytest.raises(FileNotFoundError):
        ring.Reader("lfpipe-test-no-fence")


def test_the_fence_of_this_machine_runs() -> None:
    try:
        fence._fence()
    except UserError as error:  # x86-64 needs none, and may have none
        assert "libatomic" in error.message
