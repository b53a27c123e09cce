"""One session, fault after fault: pictures return after each, none is torn, every drop is counted,
and nothing accumulates.
"""

import pytest

from tests.faults.soak import HARMLESS, LETHAL, Soak
from tests.support.world import World

pytestmark = pytest.mark.live

MANY = pytest.param(500, marks=(pytest.mark.soak, pytest.mark.timeout(7200)))


@pytest.mark.timeout(240)
@pytest.mark.parametrize("count", [len(LETHAL) + len(HARMLESS), MANY])
def test_soak_session_outlives_random_faults(
    world: World, monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    monkeypatch.setenv("LFPIPE_RUN_DIR", str(world.run_dir))
    soak = Soak(world, seed=3)
    assert not (wrong := soak.run(count)), wrong
    assert (
        sum(soak.restarts.values()) >= 3
        and soak.watcher.frames > 300
        and soak.watcher.pictures > 200
    )
    soak.end()
    assert not world.left()
