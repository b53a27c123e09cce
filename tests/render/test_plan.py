"""The plan agrees with what the stages do, and states what leaving out the rest saves."""

import json

import attrs
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.config import Config, SceneSummary, updated
from lfpipe.config.quality import WARPS
from lfpipe.render.plan import make_plan
from lfpipe.render.synthesis.compositor import Compositor
from lfpipe.render.synthesis.viewpoint import ViewSolver
from lfpipe.scene.lightfield import LightField, Manifest
from tests.render import rendered
from tests.render.rendered import METHODS, OUTPUTS


def with_keys(**keys: object) -> Config:
    return updated(Config(), {key.replace("__", "."): value for key, value in keys.items()})


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
    left_out = {item.what for item in plan.left_out}
    assert ("warping" in left_out) == (plan.needs_tracking and not plan.needs_warp)
    json.dumps(attrs.asdict(plan))
    if not plan.needs_tracking:
        return
    solver = ViewSolver(scene.rows, scene.cols, how.render, 30.0, (320.0, 240.0))
    keys = {compositor.key(*solver.views((350.0, v, 290.0, v))) for v in (0.0, 240.0, 479.0)}
    assert plan.needs_rows == (len(keys) > 1), "eyes that move up change the picture"
    assert plan.needs_warp == (compositor.method in WARPS)
