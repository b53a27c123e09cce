"""Exposure, gain, mains frequency, dynamic frame rate: applied, limited, reported, restored."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe import config
from lfpipe.capture.camera_list import (
    AUTO_EXPOSURE,
    AUTO_GAIN,
    DYNAMIC_FRAMERATE,
    EXPOSURE,
    GAIN,
    CameraControls,
)
from lfpipe.errors import UserError
from tests.capture.fake_camera import FakeCamera, FakeControl, source
from tests.support.world import until


def webcam(**more: Any) -> FakeCamera:
    return FakeCamera(
        controls={
            AUTO_EXPOSURE: FakeControl(0, 3, 3),
            EXPOSURE: FakeControl(3, 2047, 333),
            AUTO_GAIN: FakeControl(0, 1, 1),
            GAIN: FakeControl(0, 100, 20, 5),
            DYNAMIC_FRAMERATE: FakeControl(0, 1, 1),
        },
        **more,
    )


def values(device: FakeCamera) -> dict[int, int]:
    return {key: control.value for key, control in device.controls.items()}


SETTINGS = {
    "exposure": st.one_of(st.just("auto"), st.floats(0.01, 1000)),
    "gain": st.one_of(st.just("auto"), st.floats(0, 65535)),
    "dynamic_framerate": st.sampled_from(["off", "on", "auto"]),
}


@given(st.fixed_dictionaries(SETTINGS))
def test_values_are_in_range_while_it_runs_and_as_before_afterwards(
    settings: dict[str, Any],
) -> None:
    failing = webcam(frames=[TimeoutError()])
    with pytest.raises(UserError):
        source(failing, **settings)
    device = webcam()
    before = values(device)
    camera = source(device, **settings)
    for control in device.controls.values():
        assert (
            control.low <= control.value <= control.high
            and (control.value - control.low) % control.step == 0
        )
    camera.close()
    assert values(device) == values(failing) == before and failing.closed


FAILS = "camera.{}: the camera does not take it"
# settings, controls that fail, values that change, and what is noted
NOTED: dict[str, tuple[dict[str, Any], set[int], dict[int, int], list[str]]] = {
    "all automatic": ({"dynamic_framerate": "auto"}, set(), {}, []),
    "as configured": ({}, set(), {DYNAMIC_FRAMERATE: 0}, ["dynamic frame rate switched off"]),
    "manual values switch the automatics off": (
        {"exposure": 8.0, "gain": 50, "dynamic_framerate": "off"},
        set(),
        {AUTO_EXPOSURE: 1, EXPOSURE: 80, AUTO_GAIN: 0, GAIN: 50, DYNAMIC_FRAMERATE: 0},
        ["dynamic frame rate switched off"],
    ),
    "beyond what is possible": (
        {"exposure": 500.0, "gain": 70.0, "dynamic_framerate": "auto"},
        set(),
        {AUTO_EXPOSURE: 1, EXPOSURE: 2047, AUTO_GAIN: 0, GAIN: 70},
        ["camera.exposure = 500 ms: using 204.7 (0.3 to 204.7 ms possible)"],
    ),
    "controls that fail": (
        {"exposure": 8.0},
        {EXPOSURE, DYNAMIC_FRAMERATE},
        {AUTO_EXPOSURE: 1},
        [FAILS.format(key) for key in ("exposure", "dynamic_framerate")],
    ),
}


@pytest.mark.parametrize("kind", NOTED)
def test_controls_are_set_and_noted(kind: str) -> None:
    settings, refused, changed, notes = NOTED[kind]
    device = webcam()
    device.refused = refused
    wanted = values(device) | changed
    found = source(device, **settings).info.notes[1:]
    assert values(device) == wanted
    assert sorted(found) == [note for note in sorted(found) if any(word in note for word in notes)]
    assert len(found) == len(notes)


def test_the_exposure_is_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfpipe.capture.camera_list.CHECK_S", 0.01)
    device = webcam()
    controls = CameraControls(device, config.Camera(dynamic_framerate="auto"))
    for value in (20, 40):
        device.controls[EXPOSURE].value = value
        until(lambda value=value: controls.exposure_ns == value * 100_000, "exposure")
    controls.end(5)
    assert not controls.is_alive()
