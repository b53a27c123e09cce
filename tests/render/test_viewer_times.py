"""Presence, Viewer, idle motion: their times and limits as a person is promised them, in numbers
that no constant of the code gives.
"""

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.config import Config, Render
from lfpipe.render.presence import Presence, Rest, ViewerState, idle_place
from lfpipe.render.viewer import Viewer
from tests.render.rendered import S, field, record

HOME = Rest(300.0, 200.0, 60.0)
ASIDE = Rest(500.0, 210.0, 90.0)


class Faces:
    """A Presence that sees faces at 30 Hz."""

    def __init__(self) -> None:
        self.presence = Presence()
        self.t_ns = 0

    def see(self, here: Rest | None, seconds: float, track: int) -> ViewerState:
        """The state after a face, or none, was there for so long, and at least one frame."""
        for _ in range(round(seconds * 30) or 1):
            self.t_ns += S // 30
            self.presence.update(self.t_ns, here, track)
        return self.presence.state


@pytest.mark.parametrize(("away_s", "state"), [(9.8, "seated"), (10.2, "arriving")])
def test_a_seat_is_kept_for_ten_seconds_of_absence(away_s: float, state: str) -> None:
    faces = Faces()
    assert faces.see(HOME, 3, 1) is ViewerState.SEATED
    assert faces.see(None, 1, 1) is ViewerState.LOST
    faces.see(None, away_s - 1, 1)
    assert faces.see(HOME, 0, 2).word == state


@pytest.mark.parametrize(("away_s", "seated"), [(28.0, True), (32.0, False)])
def test_a_seat_waits_half_a_minute_while_another_face_is_there(
    away_s: float, seated: bool
) -> None:
    faces = Faces()
    faces.see(HOME, 3, 1)
    faces.see(ASIDE, away_s, 2)
    faces.see(HOME, 0.0, 3)
    assert (faces.presence.state is ViewerState.SEATED) == seated


def viewer(**render: Any) -> Viewer:
    return Viewer(field(9, 9, 16, 16), Config(render=Render(method="warp2", **render)))


def column(subject: Viewer, t_ns: int, **eyes: Any) -> float:
    """The column between both eyes' views, of a frame of t_ns that is shown at once."""
    views = subject.viewpoints(record(**eyes), t_ns, t_ns)
    return (views.left[1] + views.right[1]) / 2


def test_a_view_holds_for_three_seconds_and_then_returns_to_its_middle() -> None:
    subject = viewer(alpha_px=20.0)
    columns = [column(subject, k * S // 60, x=370.0) for k in range(60)]
    left = columns[-1]
    assert abs(left - 4) > 1
    away = [column(subject, (60 + k) * S // 60, x=370.0, face=0) for k in range(12 * 60)]
    assert away[: round(2.9 * 60)] == pytest.approx([left] * round(2.9 * 60), abs=0.01)
    assert abs(away[round(3.5 * 60)] - left) > 0.1
    assert abs(away[-1] - 4) < 0.05


def distance_share(start: float, apart: float, seconds: float) -> float:
    """The share of its way that the distance has gone after a face was suddenly elsewhere."""
    subject = viewer()
    subject.viewpoints(record(apart=start), 0, 0)
    steps = round(seconds * 240)
    for k in range(1, steps + 1):
        subject.viewpoints(record(apart=apart), k * S // 240, k * S // 240)
    return (subject._apart_px - start) / (apart - start)


def test_depth_follows_a_distance_in_a_quarter_second_and_noise_in_a_second() -> None:
    """Time constants: 1 - 1/e of the way."""
    share = 1 - 1 / math.e
    assert distance_share(60.0, 61.0, 1.0) == pytest.approx(share, abs=0.01), "noise: 2 % or less"
    # beyond 2 % it is quick; then its rest is as slow as noise
    assert distance_share(60.0, 30.0, 0.25) == pytest.approx(share, abs=0.01)


@given(
    rows=st.integers(1, 17),
    cols=st.integers(1, 17),
    t_s=st.floats(0, 1e5),
    at=st.tuples(*[st.floats(0, 1)] * 3),
)
def test_idle_motion_stays_in_the_grid(
    rows: int, cols: int, t_s: float, at: tuple[float, float, float]
) -> None:
    """Wherever the last viewer left the picture."""
    row, first, second = (
        share * (size - 1) for share, size in zip(at, (rows, cols, cols), strict=True)
    )
    place = idle_place((row, min(first, second), max(first, second)), (rows, cols), t_s)
    assert 0 <= place[0] <= rows - 1
    assert all(0 <= col <= cols - 1 for col in place[1:])
