"""The method that a scene deserves: warped where disparity explains its views, and cross-faded
elsewhere.
"""

import attrs
import numpy as np
import pytest

from lfpipe.render.plan import scores
from lfpipe.scene.analysis import best_method
from lfpipe.scene.lightfield import LightField
from tests.render import rendered
from tests.render.rendered import METHODS


def chosen(field: LightField) -> str:
    """The method that a pack of the field has."""
    reach_px = max(-field.disparity_min_px, field.disparity_max_px)
    return best_method(scores(field).psnr_db, reach_px, field.disparity is not None)


FIELD = rendered.field(5, 5, 96, 96)
MIXED = np.random.default_rng(0).permuted(np.asarray(FIELD.disparity), axis=-1)[..., ::-1, :]
EQUAL = np.broadcast_to(FIELD.views[:, :1, :1], FIELD.views.shape)


@pytest.mark.parametrize(
    ("field", "methods", "scored"),
    [
        # views far apart are never blended
        (rendered.field(5, 5, scale=6.0), {"nearest", "warp", "warp2"}, set(METHODS)),
        (attrs.evolve(rendered.field(1, 2, scale=6.0), disparity=None), {"nearest"}, set()),
        (rendered.field(1, 2, depth=False), {"blend"}, set()),
        # too small for scores
        (rendered.field(1, 2), {"warp2"}, set()),
        (rendered.field(2, 2), {"warp2"}, set()),
        # a wrong disparity, and equal views
        (attrs.evolve(FIELD, disparity=MIXED), {"blend"}, set(METHODS)),
        (
            attrs.evolve(FIELD, views=EQUAL, disparity=np.zeros_like(MIXED)),
            {"nearest"},
            set(METHODS),
        ),
    ],
)
def test_best_method_of_unusual_scenes(
    field: LightField, methods: set[str], scored: set[str]
) -> None:
    assert chosen(field) in methods and set(scores(field).psnr_db) == scored
