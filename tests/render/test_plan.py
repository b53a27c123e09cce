"""The plan agrees with what the stages do, and states what leaving out the rest saves."""

import json
from typing import Any

import attrs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from lfpipe.config import Config, SceneSummary, updated
from lfpipe.render.plan import Plan, make_plan
from lfpipe.render.synthesis.compositor import Compositor
from lfpipe.render.synthesis.viewpoint import ViewSolver
from lfpipe.render.viewer.viewer import Viewer
from lfpipe.scene.lightfield import LightField, Manifest
from tests.render import rendered
from tests.render.rendered import METHODS, OUTPUTS, S, record
from tests.support.examples import examples


def field(rows: int, cols: int, **changes: Any) -> LightField:
    """Views of 48x64 px."""
    scene = attrs.evolve(
        rendered.noise(rows, cols, 48, 64, 3.0, seed=1),
        manifest=Manifest(scores={"nearest": 30.0, "blend": 41.0}),
    )
    return attrs.evolve(
        scene,
        views=scene.views[:1],
        **{"disparity": scene.disparity if rows * cols > 1 else None} | changes,
    )


def saved(plan: Plan) -> dict[str, str]:
    return {item.what: item.saves for item in plan.left_out}


def with_keys(**keys: object) -> Config:
    return updated(Config(), {key.replace("__", "."): value for key, value in keys.items()})


def read_channels(view: int, how: Config, channels: int) -> tuple[int, ...]:
    """Stored channels of one view of a row of three that a picture for eyes at the outer two
    depends on.
    """
    scene = attrs.evolve(
        rendered.noise(1, 3, 16, 16, 1.0, seed=7, channels=channels),
        disparity=None,
        method="nearest",
    )

    def picture(views: NDArray[np.uint8]) -> NDArray[np.uint8]:
        return (
            Compositor(attrs.evolve(scene, views=views), how.render)
            .compose((0.0, 0.0), (0.0, 2.0))
            .copy()
        )

    read = []
    for channel in range(channels):
        changed = np.array(scene.views)
        changed[:, 0, view, channel] = 255 - changed[:, 0, view, channel]
        if not np.array_equal(picture(np.asarray(scene.views)), picture(changed)):
            read.append(channel)
    return tuple(read)


@pytest.mark.parametrize(("channels", "ghost_compensation"), [(1, 0.0), (3, 50.0)])
@pytest.mark.parametrize("anaglyph", OUTPUTS)
def test_plan_planes_are_those_that_change_the_picture(
    anaglyph: str, ghost_compensation: float, channels: int
) -> None:
    how = with_keys(
        render__anaglyph=anaglyph,
        render__ghost_compensation=ghost_compensation,
        render__method="nearest",
    )
    left, middle, right = (read_channels(view, how, channels) for view in range(3))
    if anaglyph == "mono":  # one viewpoint, midway between the eyes
        assert left == right == ()
        left, middle = middle, left
    assert middle == ()
    scene = field(1, 3)
    assert make_plan(attrs.evolve(scene, views=scene.views[:, :, :, :channels]), how).planes == (
        left,
        right,
    )


@st.composite
def scenes(draw: st.DrawFn) -> LightField:
    rows, cols = draw(st.tuples(st.integers(1, 3), st.integers(1, 5)))
    extent_px = draw(st.sampled_from([0.0, 0.1, 0.4, 0.6, 3.0]))
    scene = rendered.noise(
        rows, cols, 8, 8, extent_px, seed=1, channels=draw(st.sampled_from([1, 3]))
    )
    scores: dict[str, float] = draw(
        st.dictionaries(st.sampled_from(METHODS), st.floats(20.0, 50.0))
    )
    disparity = scene.disparity if draw(st.booleans()) else None
    return attrs.evolve(
        scene,
        method=draw(st.sampled_from(METHODS)),
        manifest=Manifest(scores=scores),
        disparity=disparity,
    )


configs = st.builds(
    with_keys,
    render__method=st.sampled_from(["auto", *METHODS]),
    render__anaglyph=st.sampled_from(OUTPUTS),
    render__alpha_px=st.one_of(st.just("auto"), st.floats(50.0, 2000.0)),
    render__extrapolate_views=st.sampled_from([0.0, 0.5, 2.0]),
    screen__distance_mm=st.sampled_from(["auto", 600.0]),
    camera__above_mm=st.sampled_from([0.0, 180.0]),
)


class Untouchable:
    """A disparity that fails on reading."""

    nbytes = 1

    def __array__(self, *_: object, **__: object) -> NDArray[np.int8]:
        raise AssertionError("disparity was read")


@given(scenes(), configs)
def test_plan_is_what_the_stages_do(scene: LightField, how: Config) -> None:
    plan = make_plan(scene, how)
    compositor = Compositor(scene, how.render)
    assert plan.method == compositor.method
    summary = SceneSummary(
        pack="/pack",
        name="one",
        rows=scene.rows,
        cols=scene.cols,
        height_px=8,
        width_px=8,
        method=scene.method,
        has_disparity=scene.disparity is not None,
    )
    assert plan.needs_tracking == summary.needs_eyes
    assert ("warping" in saved(plan)) == (plan.needs_tracking and not plan.needs_warp)
    json.dumps(attrs.asdict(plan))
    if not plan.needs_tracking:
        return
    solver = ViewSolver(scene.rows, scene.cols, how.render, 30.0, (320.0, 240.0))
    keys = {compositor.key(*solver.views((350.0, v, 290.0, v))) for v in (0.0, 240.0, 479.0)}
    assert plan.needs_rows == (len(keys) > 1), "eyes that move up change the picture"
    if scene.disparity is not None:
        guarded: Any = Untouchable()
        try:
            Compositor(attrs.evolve(scene, disparity=guarded), how.render).compose(
                (0.0, 0.3), (0.0, 0.6)
            )
            assert not plan.needs_warp
        except AssertionError as error:
            assert plan.needs_warp, error


@examples(50)
@given(configs)
def test_plan_needs_depth_where_distance_changes_the_views(how: Config) -> None:
    scene = rendered.noise(9, 9, 8, 8, 1.0, seed=1)
    scene = attrs.evolve(scene, disparity_min_px=0.0, disparity_max_px=0.0)
    how = updated(how, {"render.method": "blend"})  # nearest would round small changes away
    seen = []
    for eye_distance in (30.0, 60.0):  # the same direction, half the distance
        viewer = Viewer(scene, how)
        viewer.viewpoints(record(320.0, 240.0, 30.0), 0, 0)
        for k in range(1, 41):
            viewer.viewpoints(record(330.0, 250.0, eye_distance), k * S // 4, k * S // 4)
        assert viewer.solver is not None and viewer.last_viewpoints is not None
        left, right = viewer.last_viewpoints.left, viewer.last_viewpoints.right
        seen.append((viewer.solver.alpha_px, left[0], left[1] + right[1]))
    same = seen[0] == pytest.approx(seen[1], abs=1e-3)
    assert make_plan(scene, how).needs_depth == (not same)


@pytest.mark.parametrize(
    ("changes", "method", "why"),
    [
        (
            {"method": "blend"},
            "auto",
            "blend predicts held-out views as well (nearest 30.0 dB, blend 41.0 dB)",
        ),
        ({"method": "blend", "manifest": Manifest()}, "auto", "the scene's own method is blend"),
        ({"disparity": None}, "warp", "the scene has no disparity"),
        ({}, "blend", "render.method is blend"),
    ],
)
def test_plan_explains_why_nothing_is_warped(
    changes: dict[str, Any], method: str, why: str
) -> None:
    plan = make_plan(
        field(5, 5, **{"disparity_min_px": -1.0, "disparity_max_px": 1.0} | changes),
        with_keys(render__method=method),
    )
    assert next(item.why for item in plan.left_out if item.what == "warping") == why
