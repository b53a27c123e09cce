"""The distance of the eyes on the grid: known cases computed by hand, and arbitrary
configurations.
"""

import math
from collections.abc import Mapping

import attrs
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.config import Config, updated
from lfpipe.render.viewer.geometry import Parallax, parallax
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.source import Geometry
from tests.render import rendered
from tests.support.examples import examples

# The HCI scene "cotton": baseline 25 mm, focus 4.25 m,
# focal length 1462.9 px of 512, disparities -1.6..1.5
COTTON = Geometry(25.0, 4250.0, 1462.9)


def cotton(**changes: object) -> LightField:
    about = {
        "geometry": COTTON,
        "disparity_min_px": -1.6,
        "disparity_max_px": 1.5,
        "name": "cotton",
    } | changes
    return attrs.evolve(rendered.field(9, 9, 4, 512), **about)  # type: ignore[arg-type]


def configured(tree: Mapping[str, Mapping[str, object]]) -> Config:
    """The configuration that a table of sections gives."""
    values = {
        f"{section}.{key}": value for section, keys in tree.items() for key, value in keys.items()
    }
    return updated(Config(), values)


def chosen(field: LightField, eyes_px: float = 63.0, **render: object) -> Parallax:
    config = configured(
        {"camera": {"focal_px": 600.0}, "screen": {"width_mm": 299.0}, "render": render}
    )
    return parallax(config, field, 640, eyes_px)


# of cotton, from 600 mm, where the eyes are 63 px apart
TRUE_VIEWS = 63 * 4250 / (600 * 25)
# 3 % of the picture's width are 8.97 mm, less than the 10.47 of one degree; a view step moves the
# farthest 1.6 px of 0.584 mm
COMFORT_VIEWS = 8.97 / (1.6 * 299 / 512)
# one metre away
CLOSE_UP = cotton(disparity_min_px=-0.1, disparity_max_px=0.1, geometry=Geometry(100.0, 1000.0))
OFFSET = cotton(disparity_min_px=9.0, disparity_max_px=12.0, border_px=(9.0, 10.5))
# a scene, px between the eyes, keys of render, the figures of the parallax, and words of its text
FOUND: dict[str, tuple[LightField, float, dict[str, object], dict[str, float], str]] = {
    # alpha = focal length of the webcam * baseline / focus distance, whatever the distance
    **{
        f"true depth from {distance_mm} mm": (
            cotton(),
            eyes_px,
            {"depth": 1.0},
            {"alpha_px": 600 * 25 / 4250, "compression": 1.0, "distance_mm": distance_mm},
            "",
        )
        for eyes_px, distance_mm in ((63.0, 600), (31.5, 1200))
    },
    "a plane before the middle": (
        cotton(),
        63.0,
        {"zero_plane_px": 1.5},
        {"true_views": 63 * (1462.9 / (1462.9 / 4250 + 1.5 / 25)) / (600 * 25)},
        "",
    ),
    "true depth that is not known": (
        cotton(geometry=Geometry()),
        63.0,
        {"depth": 1.0},
        {"views_between_eyes": 8.0},
        "",
    ),
    "half of the depth": (
        cotton(),
        63.0,
        {"depth": 0.5},
        {"views_between_eyes": math.sqrt(4 * TRUE_VIEWS)},
        "",
    ),
    "half of nine columns": (
        cotton(),
        63.0,
        {},
        {"views_between_eyes": 4.0, "alpha_px": 63.0 / 4, "compression": 4 / TRUE_VIEWS}
        | {"true_views": TRUE_VIEWS, "comfort_views": COMFORT_VIEWS, "distance_mm": 600.0}
        | {"zero_plane_px": 0.0},
        "",
    ),
    "twice as far": (cotton(), 31.5, {}, {"distance_mm": 1200.0, "alpha_px": 63.0 / 8}, ""),
    "a scene that is near": (
        CLOSE_UP,
        63.0,
        {},
        {
            "views_between_eyes": 63 / (0.1 * 600),
            "true_views": 63 / (0.1 * 600),
            "compression": 1.0,
        },
        "true depth",
    ),
    # without the capture's focal length the zero plane's depth is not known
    "its plane moved": (
        CLOSE_UP,
        63.0,
        {"zero_plane_px": 0.05},
        {"true_views": 63 / (0.1 * 600)},
        "",
    ),
    **{
        f"room of {rows}x{cols}": (
            attrs.evolve(
                rendered.field(rows, cols, 4, 64),
                disparity_min_px=-extent_px,
                disparity_max_px=extent_px,
            ),
            63.0,
            {},
            {"views_between_eyes": room},
            "",
        )
        for rows, cols, extent_px, room in (
            (9, 9, 1e-3, 4.0),
            (9, 1, 1e-3, 4.0),
            (1, 5, 1e-3, 2.0),
            (1, 1, 1e-3, 0.5),
            (1, 40, 0.0, 4.0),
        )
    },
    "far before the screen": (
        OFFSET,
        63.0,
        {"zero_plane_px": 0.0},
        {"views_between_eyes": 1.28},
        "",
    ),
    # the budget is that of the plane that is chosen, the nearest at the border
    "automatic plane": (
        OFFSET,
        63.0,
        {},
        {"zero_plane_px": 10.5, "views_between_eyes": 4.0, "comfort_views": 1.28 * 12.0 / 1.5},
        "+10.50 px/view",
    ),
    "what was far is near": (OFFSET.inverted(), 63.0, {}, {"zero_plane_px": -9.0}, ""),
}


@pytest.mark.parametrize("kind", FOUND)
def test_parallax_is_the_least_of_room_comfort_and_true_depth(kind: str) -> None:
    field, eyes_px, render, metrics, words = FOUND[kind]
    found = chosen(field, eyes_px, **render)
    assert {name: getattr(found, name) for name in metrics} == pytest.approx(metrics, rel=1e-3)
    beyond = found.views_between_eyes > (found.comfort_views or math.inf)
    assert words in str(found) and ("comfort limit" in str(found)) == beyond


@pytest.mark.parametrize(
    ("width_mm", "distance_mm", "zero_px", "limit_mm", "extent_px", "why"),
    [
        (600.0, 600.0, 0.0, 600 * math.pi / 180, 1.6, "1 degree"),
        (299.0, 600.0, 0.0, 0.03 * 299, 1.6, "3% of the picture's width"),
        (3000.0, 10000.0, 0.0, 63.0, 1.6, "must not diverge"),
        # nearly all of it stands before the screen
        (3000.0, 10000.0, -1.5, 0.03 * 3000, 3.0, "3% of the picture's width"),
        (299.0, 600.0, 1.0, 0.03 * 299, 2.6, "3% of the picture's width"),
    ],
)
def test_parallax_names_each_limit_of_comfort(
    width_mm: float, distance_mm: float, zero_px: float, limit_mm: float, extent_px: float, why: str
) -> None:
    screen = {"width_mm": width_mm, "distance_mm": distance_mm}
    for alpha in (1e-3, 1e3):
        render = {"zero_plane_px": zero_px, "alpha_px": alpha}
        how = configured({"camera": {"focal_px": 600.0}, "screen": screen, "render": render})
        found = parallax(how, cotton(), 640, 63.0)
        assert found.distance_mm == distance_mm and "(configured)" in str(found)
        assert found.comfort_views == pytest.approx(limit_mm / (extent_px * width_mm / 512))
        assert found.comfort_views is not None
        assert (
            (why in str(found)) == (found.views_between_eyes > found.comfort_views) == (alpha < 1)
        )


@examples(200)
@given(
    alpha=st.one_of(st.just("auto"), st.floats(1e-9, 1e9)),
    eyes_px=st.one_of(st.none(), st.floats(allow_nan=True, allow_infinity=True)),
    low=st.floats(-100, 100),
    span=st.floats(0, 200),
    zero=st.floats(-1000, 1000),
    depth=st.floats(0, 1),
    grid=st.tuples(st.integers(1, 3), st.integers(1, 40)),
    distance=st.one_of(st.just("auto"), st.floats(50, 50000)),
    geometry=st.sampled_from(
        [Geometry(), COTTON, Geometry(1e-9, 1e9, 1.0), Geometry(1e9, 1e-9, 1e9)]
    ),
)
def test_parallax_of_anything_is_finite(
    alpha: float | str,
    eyes_px: float | None,
    low: float,
    span: float,
    zero: float,
    depth: float,
    grid: tuple[int, int],
    distance: float | str,
    geometry: Geometry,
) -> None:
    field = attrs.evolve(
        rendered.noise(*grid, 1, 1, 1.0, 0),
        disparity_min_px=low,
        disparity_max_px=low + span,
        geometry=geometry,
    )
    render = {"alpha_px": alpha, "zero_plane_px": zero, "depth": depth}
    found = parallax(
        configured({"render": render, "screen": {"distance_mm": distance}}), field, 640, eyes_px
    )
    assert 0 < found.alpha_px < math.inf and math.isfinite(found.views_between_eyes)
    assert 50 <= found.distance_mm <= 50000 and str(found)
