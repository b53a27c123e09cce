"""What other programs receive, against their own definitions: opentrack's formulas, OSC's time tag,
XDF's words for gaze.
"""

import math
import os
import struct
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.extras.share import output
from lfpipe.extras.share.output import Sample, clock_offset_s, opentrack_datagram, osc_datagram
from lfpipe.extras.share.target import Target
from lfpipe.eyes import SHOWN
from lfpipe.track.eye_tracker import Head
from lfpipe.transport.ring import now_ns
from tests.extras.share.receivers import lsl_environment
from tests.support.examples import examples
from tests.track.test_head import rotation

LSL_NAME = f"outputs{os.getpid()}"
STATES = ["no face", "face found", "face"]
HEAD = Head(
    left_mm=(-40.0, 5.0, 600.0),
    right_mm=(23.0, 4.0, 598.0),
    position_mm=(-8.5, 4.5, 599.0),
    yaw_deg=1.0,
    pitch_deg=2.0,
    roll_deg=3.0,
)
# From our axes (x right, y up, z to the viewer) to those of opentrack's neuralnet tracker (x ahead
# of the viewer, y up, z right)
OPENTRACK_WORLD = np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])


def neuralnet(turned: np.ndarray, position_mm: np.ndarray) -> list[float]:
    """opentrack's pose of a head, by the formulas of NeuralNetTracker::data in
    tracker-neuralnet/ftnoir_tracker_neuralnet.cpp.
    """
    r = OPENTRACK_WORLD @ turned @ OPENTRACK_WORLD.T
    t = OPENTRACK_WORLD @ position_mm
    mx, my, mz = r.T
    yaw = math.atan2(mx[2], mx[0])
    pitch = -math.atan2(-mx[1], math.hypot(mx[2], mx[0]))
    roll = math.atan2(mz[1], my[1])
    return [-t[2] * 0.1, t[1] * 0.1, -t[0] * 0.1, *np.degrees((yaw, pitch, roll)).tolist()]


@examples(50)
@given(
    st.tuples(st.floats(-300, 300), st.floats(-200, 200), st.floats(300, 1500)),
    st.tuples(st.floats(-60, 60), st.floats(-40, 40), st.floats(-60, 60)),
)
def test_opentrack_gets_the_pose_that_its_own_tracker_would_send(
    position: tuple[float, float, float], turn_deg: tuple[float, float, float]
) -> None:
    yaw_deg, pitch_deg, roll_deg = turn_deg
    head = Head(
        left_mm=position,
        right_mm=position,
        position_mm=position,
        yaw_deg=yaw_deg,
        pitch_deg=pitch_deg,
        roll_deg=roll_deg,
    )
    sent = struct.unpack("<6d", opentrack_datagram(Sample(0, 0, 0, head)))
    np.testing.assert_allclose(sent, neuralnet(rotation(*turn_deg), np.array(position)), atol=1e-9)


def test_a_bundle_has_the_time_of_its_eyes(monkeypatch: pytest.MonkeyPatch) -> None:
    from pythonosc.osc_bundle import OscBundle

    monkeypatch.setattr(output, "now_ns", lambda: 50 * 10**9)
    monkeypatch.setattr(time, "time_ns", lambda: 1_700_000_000 * 10**9)
    for age_ns in (0, 40_000_000, 3_000_000_000):
        bundle = OscBundle(osc_datagram(Sample(7, 0, 50 * 10**9 - age_ns, HEAD)))
        assert bundle.timestamp == pytest.approx(1_700_000_000 - age_ns / 1e9, abs=1e-6)
        assert [message.address for message in bundle] == [
            "/lfpipe/frame",
            "/lfpipe/eyes",
            "/lfpipe/head",
        ]


@pytest.fixture
def lsl(tmp_path: Path) -> Any:
    """An output with pictures, and inlets of its three streams."""
    pylsl = pytest.importorskip("pylsl")
    os.environ |= lsl_environment(tmp_path)
    from lfpipe.extras.share.output import LslOutput, source_id

    outlet = LslOutput(Target(kind="lsl", name=LSL_NAME), "unit", 30.0, True)
    inlets = {}
    for stream in ("eyes", "pictures", "markers"):
        (info,) = pylsl.resolve_byprop(
            "source_id", source_id("unit", f"{LSL_NAME}-{stream}"), 1, 60
        )
        inlets[stream] = pylsl.StreamInlet(info)
        inlets[stream].open_stream(20)
    yield outlet, inlets
    for inlet in inlets.values():
        inlet.close_stream()
    outlet.close()


def test_the_state_is_repeated_every_second_and_the_confidence_is_sent(lsl: Any) -> None:
    outlet, inlets = lsl
    begin_ns = now_ns()
    for k in range(81):  # 30 Hz: 0.3 s without a face, 2 s with one, 0.4 s without
        face = 10 <= k < 70
        outlet.send(
            Sample(k, 0, begin_ns + k * 33_400_000, HEAD if face else None, 0.75 if face else 0.0)
        )
    markers = []
    while (marker := inlets["markers"].pull_sample(timeout=0.5))[1] is not None:
        markers.append(marker[0][0])
    assert markers in ([*STATES, "face lost"], [*STATES, "face", "face lost"])
    rows = [inlets["eyes"].pull_sample(timeout=60)[0] for _ in range(81)]
    assert (
        rows[20][15] == 0.75
        and rows[0][15] == 0
        and math.isnan(rows[0][0])
        and rows[20][:3] == [-40.0, 5.0, 600.0]
    )


def test_lsl_pictures_have_the_time_at_which_they_appeared(lsl: Any) -> None:
    outlet, inlets = lsl
    record = np.zeros((), SHOWN)
    shown_ns = now_ns() - 700_000_000
    record["t_presented_ns"] = shown_ns
    outlet.show(7, record)
    values, stamp_s = inlets["pictures"].pull_sample(timeout=60)
    offset_s = clock_offset_s()
    assert values[0] == 7
    assert stamp_s == pytest.approx(shown_ns / 1e9 + offset_s, abs=0.05), "not that of sending"
