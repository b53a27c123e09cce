"""The state of a session: pure changes, rings on demand, quality levels, rollback."""

from collections.abc import Callable

import attrs
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.config import Config, Governor, Render, SessionOptions, Track, converter
from lfpipe.config.session_options import CameraViewer, Lossless, MouseViewer, NoViewer
from lfpipe.supervisor.session_state import SessionState
from lfpipe.transport import control
from tests.supervisor.states import SCENE, VIEWER, made_state

OTHER = attrs.evolve(SCENE, pack="/packs/two", height_px=96)
SINGLE = attrs.evolve(SCENE, pack="/packs/single", rows=1, cols=1, needs_eyes=False)
LOWER = Config(render=Render(method="nearest"))
PLUGIN = Config(track=Track(engine="of a plugin"))  # type: ignore[arg-type]

Change = Callable[[SessionState], SessionState]
CHANGES: dict[str, Change] = {
    "set": lambda state: state.changed(LOWER if state.config == Config() else Config()),
    "plugin": lambda state: state.changed(PLUGIN),
    "load": lambda state: state.loaded(SCENE),
    "other": lambda state: state.loaded(OTHER),
    "single": lambda state: state.loaded(SINGLE),
    "pause": lambda state: state.changed(paused=not state.paused),
    "lower": lambda state: state.with_level(min(1, len(state.levels) - 1)),
    "record": lambda state: state.changed(record="/out"),
    "stop": lambda state: state.changed(record=""),
    "pictures": lambda state: state.with_pictures(10),
    "shorter": lambda state: state.with_pictures(5),
    "drop": lambda state: state.without_pictures() if state.options.pictures else state,
    "settle": SessionState.settled,
    "roll": SessionState.rolled_back,
}


@given(st.lists(st.sampled_from(list(CHANGES)), max_size=30))
def test_session_state_rings_levels_and_revisions_agree(steps: list[str]) -> None:
    state = made_state()
    names = set[str]()
    for step in steps:
        before = state
        state = CHANGES[step](state)
        same_work = (state.config, state.options, state.paused) == (
            before.config,
            before.options,
            before.paused,
        )
        assert state.rev - before.rev in ((0, 1) if same_work else (1,)), (
            "stages hear of every change, once"
        )
        rings = state.rings()
        assert rings.keys() == {name for name in (state.options.pictures,) if name}
        for name in rings.keys() - before.rings().keys():
            assert name not in names, "a reader of an old ring never maps a new one under its name"
            names.add(name)
        if before.options.pictures == state.options.pictures != "":
            assert state.pictures_until_ns >= before.pictures_until_ns, "a lease never shortens"
        assert state.level in state.levels
        message = control.decode(control.encode(state.message()))
        assert converter().structure(message["config"], Config) == state.config
        assert (
            converter().structure(converter().unstructure(state.options), SessionOptions)
            == state.options
        )
    back = state.rolled_back()
    assert back.revertible == state.known_good
    assert attrs.evolve(back.options, scene=None, viewer=VIEWER, level=None) == attrs.evolve(
        state.options, scene=None, viewer=VIEWER, level=None
    ), "a rollback takes back configuration and scene, and leaves recordings and traces alone"


def test_loaded_starts_at_the_zero_plane_of_the_scene() -> None:
    state = made_state()
    state = state.changed(
        attrs.evolve(state.config, render=attrs.evolve(state.config.render, zero_plane_px=10.25))
    )
    other = state.loaded(OTHER)
    assert other.config.render == attrs.evolve(state.config.render, zero_plane_px="auto"), (
        "in the measure of the scene before"
    )
    other = other.changed(
        attrs.evolve(other.config, render=attrs.evolve(other.config.render, zero_plane_px=-0.5))
    )
    back = other.loaded(SCENE)
    assert back.config.render.zero_plane_px == 10.25
    assert back.loaded(SCENE).config == back.config, "opened again, a scene stays as it is"
    assert back.loaded(OTHER).config.render.zero_plane_px == -0.5
    assert back.rolled_back().options.scene == state.known_good["scene"]


def test_loaded_takes_invert_depth_from_the_scene() -> None:
    state = made_state()
    order = attrs.evolve(state.config.scene, invert_depth="yes")
    turned = state.changed(attrs.evolve(state.config, scene=order))
    assert turned.options.scene == attrs.evolve(
        SCENE,
        disparity_min_px=-SCENE.disparity_max_px,
        disparity_max_px=-SCENE.disparity_min_px,
        depth_inverted=True,
    )
    assert (
        turned.loaded(OTHER).config.scene.invert_depth == "auto"
        and turned.loaded(OTHER).options.scene == OTHER
    )


def test_with_level_is_full_again_where_the_levels_change() -> None:
    state = made_state()
    lower = state.with_level(1)
    assert (
        lower.level == state.levels[1]
        and lower.level.number == 1
        and lower.with_level(0).options.level is None
    )
    assert lower.changed(paused=True).level == lower.level, "the levels are the same"
    assert lower.changed(LOWER).options.level is None
    for fixed in (
        state.changed(clock=Lossless()),
        state.changed(Config(governor=Governor(quality="fixed"))),
    ):
        assert fixed.levels == state.levels[:1]


def test_loaded_keeps_tracking_where_views_need_eyes() -> None:
    state = made_state(viewer=MouseViewer())
    assert state.loaded(OTHER).options.viewer == state.loaded(SCENE).options.viewer == MouseViewer()
    single = made_state().loaded(SINGLE)
    assert not single.options.viewer.tracked
    assert single.loaded(OTHER).options.viewer == VIEWER
    state = made_state(viewer=NoViewer())
    assert state.loaded(SINGLE).options.viewer == NoViewer()
    assert state.loaded(OTHER).options.viewer == CameraViewer(), "it looks for the first camera"
    assert attrs.evolve(SCENE, rows=1, cols=5).needs_eyes
