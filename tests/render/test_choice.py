"""Choice: which eyes, which moment, which picture."""

import pytest

from lfpipe.render.presenter import EyesSource
from lfpipe.transport.ring import Stamp
from tests.render.rendered import S, record

MS = S // 1000


def stamp(t_ns: int, seq: int = 1, epoch: int = 0) -> Stamp:
    return Stamp(seq, seq, epoch, t_ns, t_ns, t_ns, 0)


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
