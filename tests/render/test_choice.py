"""Choice: which eyes, which moment, which picture."""

import pytest

from lfpipe.render.presenter import DisplayTime, EyesSource, choose
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
    resting = choose(viewer(alpha_px=20.0), source.at(S), DisplayTime(S))[0].eyes_px
    for device_latency_ns in (0, 80 * MS):
        display_time = DisplayTime(S + 20 * MS, REFRESH_NS, device_latency_ns)
        assert display_time.seen_ns == S + 20 * MS + device_latency_ns + REFRESH_NS // 2
        eyes_px = choose(viewer(alpha_px=20.0), source.at(S + 10 * MS), display_time)[0].eyes_px
        lit_s = [(20 * MS + device_latency_ns + REFRESH_NS * k / 100) / S for k in range(101)]
        errors = [eyes_px[0] - resting[0] - velocity_px_s * t_s for t_s in lit_s]
        assert sum(errors) / len(errors) == pytest.approx(0, abs=0.01)


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
