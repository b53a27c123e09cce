"""The paper's statements about dense and sparse grids, near and far viewers, as metrics."""

from itertools import pairwise

import pytest

from lfpipe.bench.grid import ALPHAS_PX, AUTOMATIC, DISTANCES_MM, Spacing
from lfpipe.bench.results import Metrics


def column(key: str, spacings: list[Spacing]) -> list[float]:
    """A metric of the geometry of each spacing."""
    return [spacing.geometry()[key] for spacing in spacings]


@pytest.mark.parametrize("distance_mm", DISTANCES_MM)
def test_a_sparser_grid_has_a_larger_zone_and_responds_less(distance_mm: float) -> None:
    """ "Increasing the spacing between views enlarges the effective movement zone ... users may
    need to move more significantly to notice changes in parallax".
    """
    spacings = [Spacing(alpha_px, distance_mm) for alpha_px in ALPHAS_PX]
    zones = column("zone_mm", spacings)
    assert zones == sorted(zones) and zones[-1] > 5 * zones[3] >= 0
    responses = column("views_per_cm", spacings)
    for (dense, sparse), (first, second) in zip(
        pairwise(ALPHAS_PX), pairwise(responses), strict=True
    ):
        assert first / second == pytest.approx(sparse / dense)


def test_a_dense_grid_is_smooth_and_a_sparse_one_stable() -> None:
    """ "With minimal spacing, angular views change rapidly": the picture changes more per cm, and
    between views only interpolation is smooth.
    """
    dense, sparse = Spacing(8.0, 600.0), Spacing(48.0, 600.0)
    assert dense.largest_step("warp2") > 2 * sparse.largest_step("warp2") > 0
    assert sparse.largest_step("nearest") > 1.5 * sparse.largest_step("warp2"), "a jump"


@pytest.mark.parametrize("alpha_px", ALPHAS_PX)
def test_the_stereo_baseline_shrinks_as_the_viewer_moves_away(alpha_px: float) -> None:
    """ "At close range, the eyes subtend a wider angular separation across the grid ... As the user
    moves farther away, this angular difference shrinks".
    """
    spacings = [Spacing(alpha_px, distance_mm) for distance_mm in DISTANCES_MM]
    views = [spacing.parallax.views_between_eyes for spacing in spacings]
    for (near, far), (one, other) in zip(pairwise(DISTANCES_MM), pairwise(views), strict=True):
        assert one / other == pytest.approx(far / near)
    angles = column("disparity_deg", spacings)
    assert angles == sorted(angles, reverse=True), "more relaxed"


@pytest.mark.parametrize("distance_mm", DISTANCES_MM)
def test_the_automatic_spacing_is_the_most_responsive_comfortable_one(distance_mm: float) -> None:
    chosen: Metrics = Spacing(AUTOMATIC, distance_mm).geometry()
    assert chosen["disparity_deg"] == pytest.approx(1.0, abs=0.01)
    for alpha_px in ALPHAS_PX:
        other = Spacing(alpha_px, distance_mm).geometry()
        if other["disparity_deg"] <= 1.0:
            assert other["views_per_cm"] <= chosen["views_per_cm"] * 1.001
            assert other["depth"] <= chosen["depth"] * 1.001


def test_the_error_is_small_where_both_eyes_stay_within_the_grid() -> None:
    assert Spacing(24.0, 600.0).error(2) < Spacing(4.0, 400.0).error(2)
