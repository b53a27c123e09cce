"""What a session keeps for its stages while they are restarted."""

from pathlib import Path
from typing import Any

import attrs
import pytest

from lfpipe import config
from lfpipe.config import LiveSource, SceneSummary
from lfpipe.config.session_options import MouseViewer, NoViewer
from lfpipe.scene.pack import remove, summarize
from lfpipe.scene.packing import pack_scene
from lfpipe.supervisor.session_state import SessionStore
from lfpipe.transport.control import Session
from lfpipe.transport.ring import Reader, Writer
from tests.supervisor.states import VIEWER, made_state
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
    session = Session(name)
    session.run_dir.mkdir(mode=0o700)
    store = SessionStore(session, made_state(scene=first))
    try:
        assert not remove(Path(first.pack))
        store.apply(store.state.loaded(second))
        assert remove(Path(first.pack)) and not remove(Path(second.pack))
        gone = attrs.evolve(first, pack=str(tmp_path / "gone"))
        store.apply(store.state.loaded(gone))  # the stage that shows it says so
    finally:
        store.close()
    assert remove(Path(second.pack))


CAMERA = attrs.evolve(VIEWER, jpeg_px=None)
LIVE = LiveSource(source="row:a,b", rows=1, cols=2, tiles_across=2, frame_px=(64, 24))


@pytest.mark.parametrize(
    ("options", "rings"),
    [
        ({"viewer": VIEWER}, {"frames", "eyes"}),
        ({"viewer": MouseViewer()}, {"eyes"}),
        ({"viewer": NoViewer()}, {"eyes"}),
        ({"viewer": attrs.evolve(VIEWER, tracked=False)}, {"eyes"}),
        (
            {"viewer": VIEWER, "live": LIVE},
            {"frames", "eyes", "views", "disparity", "viewpoints"},
        ),
        (
            {
                "viewer": attrs.evolve(CAMERA, tracked=False),
                "live": LIVE,
                "show": False,
                "record": "/x",
            },
            {"frames", "eyes", "views"},
        ),
    ],
)
def test_a_ring_exists_from_its_first_use_by_a_writer(
    base: Path, name: str, options: dict[str, Any], rings: set[str]
) -> None:
    session = Session(name)
    session.run_dir.mkdir(mode=0o700)

    def made() -> set[str]:
        return {path.stem for path in session.run_dir.glob("*.ring")}

    store = SessionStore(session, made_state(**options))
    try:
        assert made() == rings
        store.apply(store.state.changed(viewer=CAMERA))
        assert made() == rings | {"frames"}
        before = Reader(session.segment("frames"))
        store.apply(store.state.changed(viewer=MouseViewer()))
        store.apply(store.state.changed(viewer=CAMERA))
        Writer(session.segment("frames")).begin()
        assert before.epoch == 0, "who maps it has the same memory"
    finally:
        store.close()
    assert not made()
