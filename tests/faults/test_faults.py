"""One session, fault after fault: pictures return after each, none is torn, every drop is counted, and nothing accumulates."""

import math
from pathlib import Path

import attrs
import pytest

from tests.faults.session import WatchedSession
from tests.faults.soak import HARMLESS, LETHAL, Soak
from tests.world import World

pytestmark = pytest.mark.live

MANY = pytest.param(500, marks=(pytest.mark.soak, pytest.mark.timeout(7200)))


@pytest.mark.timeout(240)
@pytest.mark.parametrize("count", [len(LETHAL) + len(HARMLESS), MANY])
def test_a_session_outlives_a_row_of_random_faults(world: World, monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(world.run_dir))
    session = WatchedSession(world, size_px=(320, 240))
    outcome = Soak(session, seed=3).run(count, books_every=4)
    assert {fault.kind for fault in outcome.faults} == {*LETHAL, *HARMLESS}
    assert sum(outcome.restarts.values()) >= 3 and outcome.watcher.seen > 300 and outcome.watcher.pictures > 200
    assert not outcome.broken(recovery_s=math.inf), outcome.table()
    assert not any(any(account.errors().values()) for account in outcome.accounts), outcome.accounts
    session.end()
    assert not world.left()


def test_the_checks_of_the_soak_can_fail(tmp_path: Path) -> None:
    """A frame with one flipped bit, and an account with one frame too few, are detected."""
    import cv2

    from tests.faults.watcher import Account, is_whole, write_checked_frames

    folder = write_checked_frames(tmp_path / "frames", 64, 48, 2)
    frame = cv2.imread(str(folder / "f0001.bmp"))
    assert frame is not None and is_whole(frame)
    frame[30, 20, 1] ^= 1
    assert not is_whole(frame)
    books = Account(frames=10, eyes=9, lines=7, capture_lost=3, capture_deaths=0, capture_drops=3, track_drops=1, render_drops=2)
    assert not any(books.errors().values())
    assert attrs.evolve(books, eyes=8).errors() == {"capture": 0, "track": -1, "render": 1}
    assert attrs.evolve(books, capture_drops=4).errors()["capture"] == 1
    assert attrs.evolve(books, capture_drops=2, capture_deaths=1).errors()["capture"] == -1
