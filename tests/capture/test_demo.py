"""The demo's viewer: at the stated position, detected on every frame, endless."""

from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe import config
from lfpipe.capture.demo import DemoSource, demo_eyes_px
from lfpipe.capture.frame_source import orient
from lfpipe.capture.open_source import open_source
from lfpipe.track.litert_engine import LitertEngine


@given(
    st.floats(0, 1e5), st.floats(1e-4, 0.05), st.sampled_from([(640, 480), (1280, 720), (320, 240)])
)
def test_the_path_is_smooth_and_both_eyes_stay_in_the_frame(
    t_s: float, step_s: float, size: tuple[int, int]
) -> None:
    eyes = demo_eyes_px(t_s, *size)
    scale = min(size[0] / 640, size[1] / 480)
    moved = np.linalg.norm(demo_eyes_px(t_s + step_s, *size) - eyes, axis=1)
    assert moved.max() <= scale * 110 * step_s + 1e-6
    assert (eyes > 0.1 * np.array(size)).all() and (eyes < 0.9 * np.array(size)).all()
    assert eyes[0, 0] > eyes[1, 0]  # the sitter's own left eye stands at larger x
    assert 60 * scale < np.linalg.norm(eyes[0] - eyes[1]) < 70 * scale


def test_the_face_is_found_where_it_is_on_every_frame() -> None:
    source = open_source("demo", config.Camera(width_px=320, height_px=240, rate_hz=30.0))
    engine = LitertEngine()
    out = np.zeros((240, 320, 3), np.uint8)
    errors = []
    for k in range(450):  # 15 s of the path
        source.read(out)
        if k % 5 == 0:
            face = engine.detect(out)
            assert face is not None, f"no face in frame {k}"
            errors.append(face.eyes_px - demo_eyes_px(k / 30, 320, 240))
    assert np.linalg.norm(errors, axis=-1).mean() < 0.04 * 65 / 2


@pytest.mark.parametrize(("rotate", "mirror"), [(90, False), (180, True), (270, False), (0, True)])
def test_a_camera_mounted_otherwise_is_set_right(
    rotate: Literal[0, 90, 180, 270], mirror: bool
) -> None:
    camera = config.Camera(rotate=rotate, mirror=mirror)
    plain = np.empty((480, 640, 3), np.uint8)
    out = np.empty((camera.frame_px[1], camera.frame_px[0], 3), np.uint8)
    DemoSource(camera).read(plain)
    source = orient(DemoSource(camera), camera)
    source.read(out)
    turned = np.rot90(plain, -rotate // 90)
    np.testing.assert_array_equal(out, turned[:, ::-1] if mirror else turned)
    assert source.info.size_px == camera.frame_px
