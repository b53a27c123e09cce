"""Choice: which eyes, which moment, which picture."""

import pytest

from lfpipe.config import Config
from lfpipe.render.choice import DisplayTime, EyesSource, choose
from lfpipe.render.display.display import Pointer
from lfpipe.render.viewer.mouse_look import MouseLook
from lfpipe.transport.ring import Stamp
from tests.render.rendered import S, record, viewer

MS = S // 1000
REFRESH_NS = S // 60


def stamp(t_ns: int, seq: int = 1, epoch: int = 0) -> Stamp:
    return Stamp(seq, seq, epoch, t_ns, t_ns, t_ns, 0)


def test_moment_is_the_middle_of_the_refresh_after_the_loop() -> None:
    """Of a head at constant speed, the mean error over the refresh is then zero."""
    source = EyesSource()
    velocity_px_s = 240.0
    source.update(record(velocity_px_s=[[velocity_px_s, 0.0]] * 2), stamp(S))
    resting = choose(viewer(alpha_px=20.0), source.at(S), DisplayTime.of(S)).viewpoints.eyes_px
    for device_latency_ns in (0, 80 * MS):
        display_time = DisplayTime.of(S + 20 * MS, REFRESH_NS, device_latency_ns)
        assert display_time.seen_ns == S + 20 * MS + device_latency_ns + REFRESH_NS // 2
        eyes_px = choose(
            viewer(alpha_px=20.0), source.at(S + 10 * MS), display_time
        ).viewpoints.eyes_px
        lit_s = [(20 * MS + device_latency_ns + REFRESH_NS * k / 100) / S for k in range(101)]
        errors = [eyes_px[0] - resting[0] - velocity_px_s * t_s for t_s in lit_s]
        assert sum(errors) / len(errors) == pytest.approx(0, abs=0.01)


def test_moment_without_a_refresh_is_the_hand_over() -> None:
    assert DisplayTime.of(S).seen_ns == S


# whether it is a replay, when eyes came and of which epoch, and whether a face is there later
GIVEN: dict[str, tuple[bool, list[tuple[int, int]], list[tuple[int, int | None]]]] = {
    "nobody yet": (False, [], [(S, None)]),
    "half a second after the last eyes": (
        False,
        [(S, 0)],
        [(S, 1), (S + 490 * MS, 1), (S + 510 * MS, 0), (6 * S, 0)],
    ),
    "a tracker that is back": (False, [(S, 0), (9 * S, 1)], [(9 * S + 30 * MS, 1)]),
    # one frame a second is no death
    "slow frames": (
        False,
        [(S, 0), (2 * S, 0)],
        [(2 * S + 2900 * MS, 1), (2 * S + 3100 * MS, 0)],
    ),
    # it computes as slowly as it must
    "a replay": (True, [(S, 0), (2 * S, 0)], [(2 * S + 2900 * MS, 1), (2 * S + 3100 * MS, 1)]),
}


@pytest.mark.parametrize("kind", GIVEN)
def test_eyes_source_gives_nobody_once_its_tracker_has_died(kind: str) -> None:
    lossless, updates, seen = GIVEN[kind]
    source = EyesSource(lossless)
    for k, (t_ns, epoch) in enumerate(updates):
        source.update(record(), stamp(t_ns, k + 1, epoch))
    for t_ns, face in seen:
        eyes = source.at(t_ns)
        assert (None if eyes is None else eyes.record.face) == face, t_ns
        assert eyes is None or eyes.t_ns == (updates[-1][0] if face else t_ns)
        assert eyes is None or eyes.stamp.t_sensor_ns == updates[-1][0]


def test_eyes_source_takes_the_mouse_while_its_right_button_is_held() -> None:
    subject = viewer(alpha_px=20.0)
    mouse = MouseLook(Config(), subject, None)
    source = EyesSource()
    source.update(record(), stamp(S))
    camera = source.at(S, mouse)
    assert camera is not None and camera.t_ns == S
    choose(subject, camera, DisplayTime.of(S, REFRESH_NS))
    mouse.move(Pointer(1.0, 0.5, right=True), S)
    source.at(S, mouse)
    held = source.at(S + 100 * MS, mouse)
    assert held is not None and held.t_ns == S + 100 * MS
    assert held.record.filtered_px[0] < camera.record.filtered_px[0]
    assert held.stamp == stamp(S)


def test_choose_gives_eyes_at_rest_one_key() -> None:
    subject = viewer(alpha_px=20.0)
    source = EyesSource()
    keys = set()
    for k in range(120):
        t_ns = S + k * REFRESH_NS
        source.update(record(), stamp(t_ns, k + 1))
        keys.add(choose(subject, source.at(t_ns), DisplayTime.of(t_ns, REFRESH_NS)).key)
    assert len(keys) == 1
