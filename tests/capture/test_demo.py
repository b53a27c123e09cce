"""The demo's viewer: at the stated position, detected on every frame, endless."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe import config
from lfpipe.capture.demo import demo_eyes_px
from lfpipe.capture.open_source import open_source
from lfpipe.track.litert_engine import LitertEngine


@given(st.floats(0, 1e5), st.floats(1e-4, 0.05))
def test_the_path_is_smooth(t_s: float, step_s: float) -> None:
    moved = np.linalg.norm(demo_eyes_px(t_s + step_s) - demo_eyes_px(t_s), axis=1)
    assert moved.max() <= 110 * step_s + 1e-6


@given(st.floats(0, 1e5), st.sampled_from([(640, 480), (1280, 720), (320, 240)]))
def test_both_eyes_stay_in_the_frame_and_apart(t_s: float, size: tuple[int, int]) -> None:
    eyes = demo_eyes_px(t_s, *size)
    assert (eyes > 0.1 * np.array(size)).all() and (eyes < 0.9 * np.array(size)).all()
    assert eyes[0, 0] > eyes[1, 0]  # the sitter's own left eye stands at larger x
    scale = min(size[0] / 640, size[1] / 480)
    assert 60 * scale < np.linalg.norm(eyes[0] - eyes[1]) < 70 * scale


@pytest.mark.parametrize("size", [(640, 480), (320, 240)])
def test_the_face_is_found_where_it_is_on_every_frame(size: tuple[int, int]) -> None:
    source = open_source("demo", config.Camera(width_px=size[0], height_px=size[1], rate_hz=30.0))
    engine = LitertEngine()
    out = np.zeros((size[1], size[0], 3), np.uint8)
    errors = []
    for k in range(90):
        frame = source.read(out)
        for _ in range(4):  # every fifth frame: 15 s of the path
            source.read(out)
        observed = engine.detect(out)
        assert observed is not None, f"no face in frame {frame.source_seq}"
        errors.append(observed.eyes_px - demo_eyes_px((5 * k + 4) / 30, *size))
    engine.close()
    apart = 65 * size[0] / 640
    assert np.linalg.norm(errors, axis=-1).mean() < 0.04 * apart


def test_due_times_and_numbers() -> None:
    source = open_source("demo", config.Camera(width_px=64, height_px=48, rate_hz=60.0))
    out = np.zeros((48, 64, 3), np.uint8)
    frames = [source.read(out) for _ in range(100)]
    assert [frame.source_seq for frame in frames] == list(range(100))
    gaps = [later.t_sensor_ns - earlier.t_sensor_ns for earlier, later in pairwise(frames)]
    assert set(gaps) == {16_666_666, 16_666_667}
    assert sum(gaps) == 99 * 10**9 // 60


def test_it_is_drawn_into_slots_of_another_size_too() -> None:
    source = open_source("demo", config.Camera())
    memory = np.zeros((3, 240, 320, 3), np.uint8)
    source.read(memory[1])
    assert memory[1].std() > 30 and not memory[[0, 2]].any()
