"""The camera reader of a calibration, beside its window."""

import numpy as np
import pytest

from lfpipe import config
from lfpipe.capture.frame_source import Frame, SourceInfo, as_read, orient
from lfpipe.errors import UserError
from lfpipe.observe.loop_calibration import CameraWatch
from lfpipe.transport.ring import StampKind


class Stamped:
    """40 frames; one in `every` has no stamp of the driver."""

    info = SourceInfo("camera:made", 64, 48, 30.0, live=True)

    def __init__(self, every: int) -> None:
        self._every, self._count = every, 0

    def read(self, out: np.ndarray) -> Frame | None:
        self._count += 1
        out[:] = np.arange(out.size).reshape(out.shape) % 251
        kind = StampKind.READ if self._count % self._every == 0 else StampKind.END_OF_FRAME
        return Frame(self._count, self._count * 33_000_000, 0, stamp=kind) if self._count <= 40 else None

    def close(self) -> None:
        pass


@pytest.mark.parametrize(("every", "stamped", "kept"), [(99, True, 40), (20, True, 38), (2, False, 20), (1, False, 0)])
def test_single_frames_without_a_stamp_are_left_out(every: int, stamped: bool, kept: int) -> None:
    watch = CameraWatch(Stamped(every), (64, 48))
    watch.start()
    watch.join(10)
    assert watch.stamped == stamped and len(watch.frames(0)[0]) == kept
    assert isinstance(watch.failure, UserError) and "ended" in watch.failure.message
    watch.close()


@pytest.mark.parametrize(("rotate", "mirror"), [(0, True), (90, False), (180, True), (270, True)])
def test_rows_of_a_turned_camera_are_those_that_its_sensor_reads(rotate: int, mirror: bool) -> None:
    camera = config.Camera(width_px=64, height_px=48, rotate=rotate, mirror=mirror)  # type: ignore[arg-type]
    upright = np.empty((*camera.frame_px[::-1], 3), np.uint8)
    orient(Stamped(9), camera).read(upright)
    plain = np.empty((48, 64, 3), np.uint8)
    Stamped(9).read(plain)
    np.testing.assert_array_equal(as_read(upright[None, ..., 0], camera)[0], plain[..., 0])
