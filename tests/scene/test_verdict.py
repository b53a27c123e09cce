"""Verdict: what evidence means, and which method scores speak for."""

import pytest

from lfpipe.scene.verdict import Evidence, best_method

CLOSER = "the camera comes nearer"


@pytest.mark.parametrize(
    ("evidence", "kind"),
    [
        (Evidence(held_out_db=31, explained=0.4), "light field"),
        (Evidence(held_out_db=25, explained=0.64), "light field"),
        (Evidence(held_out_db=25, explained=0.4), "no light field"),
        (Evidence(held_out_db=40, explained=0.1), "no light field"),
        (Evidence(held_out_db=40, explained=0.9, change=CLOSER), "no light field"),
        (Evidence(held_out_db=40, explained=0.9, moved_px=0.1), "one view"),
        (Evidence(held_out_db=20, explained=0.1, missed_motion=(0.1, 0.3)), "too far apart"),
    ],
)
def test_evidence_has_one_verdict(evidence: Evidence, kind: str) -> None:
    assert evidence.verdict.kind == kind
    assert bool(evidence.verdict.reason) == (kind != "light field")


@pytest.mark.parametrize(
    ("scores", "reach_px", "has_disparity", "method"),
    [
        ({"nearest": 30.0, "blend": 30.2, "warp": 30.2, "warp2": 30.24}, 9, True, "nearest"),
        ({"nearest": 30.0, "blend": 31.0, "warp": 34.0, "warp2": 34.1}, 9, True, "warp"),
        ({"nearest": 30.0, "warp": 34.0, "warp2": 34.5}, 9, True, "warp2"),
        ({}, 0.6, True, "warp2"),
        ({}, 0.4, True, "blend"),
        ({}, 2.0, False, "blend"),
        ({}, 2.1, False, "nearest"),
    ],
)
def test_best_method_is_the_cheapest_that_nothing_beats_visibly(
    scores: dict[str, float], reach_px: float, has_disparity: bool, method: str
) -> None:
    assert best_method(scores, reach_px, has_disparity) == method
