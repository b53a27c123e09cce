"""The demo's viewer: at the stated position, detected on every frame, endless."""

from typing import Literal

import numpy as np
import pytest

from lfpipe import config
from lfpipe.capture.frame_source import OrientedSource
from lfpipe.capture.recordings import DemoSource


@pytest.mark.parametrize(("rotate", "mirror"), [(90, False), (180, True), (270, False), (0, True)])
def test_a_camera_mounted_otherwise_is_set_right(
    rotate: Literal[0, 90, 180, 270], mirror: bool
) -> None:
    camera = config.Camera(rotate=rotate, mirror=mirror)
    plain = np.empty((480, 640, 3), np.uint8)
    out = np.empty((camera.frame_px[1], camera.frame_px[0], 3), np.uint8)
    DemoSource(camera).read(plain)
    source = OrientedSource(DemoSource(camera), camera)
    source.read(out)
    turned = np.rot90(plain, -rotate // 90)
    np.testing.assert_array_equal(out, turned[:, ::-1] if mirror else turned)
    assert source.info.size_px == camera.frame_px
