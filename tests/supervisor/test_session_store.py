"""What a session keeps for its stages while they are restarted."""

from pathlib import Path

import attrs
import pytest

from lfpipe import config
from lfpipe.config import SceneSummary
from lfpipe.scene import cache
from lfpipe.scene.pack import summarize
from lfpipe.scene.packing import pack_scene
from lfpipe.supervisor.session_store import SessionStore
from lfpipe.transport.session import Session
from tests.supervisor.states import made_state
from tests.support.world import write_scene


@pytest.fixture
def scenes(tmp_path: Path) -> config.Scene:
    return config.Scene(cache_dir=str(tmp_path / "cache"))


def packed(folder: Path, cols: int, settings: config.Scene) -> SceneSummary:
    return summarize(pack_scene(write_scene(folder, 2, cols), settings))


def test_the_pack_of_a_session_stays_while_no_stage_has_it_open(
    base: Path, name: str, tmp_path: Path, scenes: config.Scene
) -> None:
    first, second = (packed(tmp_path / f"scene{n}", n, scenes) for n in (2, 3))
    session = Session(name).with_token()
    session.run_dir.mkdir(mode=0o700)
    store = SessionStore(session, made_state(scene=first))
    try:
        assert not cache.remove(Path(first.pack))
        store.apply(store.state.loaded(second))
        assert cache.remove(Path(first.pack)) and not cache.remove(Path(second.pack))
        gone = attrs.evolve(first, pack=str(tmp_path / "gone"))
        store.apply(store.state.loaded(gone))  # the stage that shows it says so
    finally:
        store.close()
    assert cache.remove(Path(second.pack))
