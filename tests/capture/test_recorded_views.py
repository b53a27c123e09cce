"""Recorded views between the viewer's frames: in the order of the recording, and when due."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from lfpipe.capture.recorded_views import RecordedViews
from lfpipe.config.modes import Lossless
from lfpipe.sequence.folder import VIEWS, SequenceWriter
from lfpipe.sequence.views import about_grid, open_views
from lfpipe.transport.clock import MS_NS
from tests.live import made

LIVE = made.source(1, 2, 48, 64)


class Output:
    """A ring's end that keeps what is published."""

    def __init__(self) -> None:
        self.published: list[tuple[int, int]] = []
        self._slot = np.zeros((48, 128, 3), np.uint8)

    def begin(self) -> np.ndarray:
        return self._slot

    def publish(self, source_seq: int, t_sensor_ns: int, _t_read_ns: int) -> None:
        assert self._slot.max() == self._slot.min() == source_seq
        self.published.append((source_seq, t_sensor_ns))


def recorded(folder: Path, stamps: list[int], **more: Any) -> Path:
    folder.mkdir()
    writer = SequenceWriter(folder, "demo", LIVE.frame_px, 30.0, **more)
    for seq, t_ns in enumerate(stamps):
        writer.append(np.full((48, 128, 3), seq, np.uint8).tobytes(), "raw", seq, 0, t_ns, t_ns)
    writer.complete()
    return folder


@pytest.mark.parametrize("stretch", [1, 3])
def test_views_come_before_the_frame_that_follows_them_in_the_recording(
    tmp_path: Path, stretch: int
) -> None:
    viewer = [ms * MS_NS for ms in (1000, 1030, 1060, 1090)]
    views = [ms * MS_NS for ms in (990, 1010, 1020, 1060, 1070, 1100)]
    recording = recorded(tmp_path / "rec", viewer)
    recorded(recording / VIEWS, views, **about_grid(LIVE))
    output = Output()
    options = SimpleNamespace(clock=Lossless(lock_step=True))
    context = cast(Any, SimpleNamespace(options=options, output=lambda _: output))
    opened = open_views(recording)
    assert opened is not None
    player = RecordedViews(context, opened[1])
    for index, count in enumerate((1, 3, 4, 5)):
        player.publish_before(index, 50_000 + stretch * (viewer[index] - viewer[0]))
        assert [seq for seq, _ in output.published] == list(range(count))
    # the last one came after the last frame
    due = [50_000 + (t - viewer[0]) * (stretch if t > viewer[0] else 1) for t in views[:5]]
    assert [t_ns for _, t_ns in output.published] == due
