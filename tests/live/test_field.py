"""The newest frame of a live light field, and what render shows while its disparity is late."""

from unittest.mock import Mock

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import LiveSource, Render
from lfpipe.live.field import Estimator, LiveViews, summary_of
from lfpipe.live.records import pairs_in_need
from lfpipe.render.live_input import LiveInput
from lfpipe.render.plan import psnr_db
from lfpipe.render.synthesis.compositor import Compositor
from lfpipe.scene.lightfield import UNKNOWN, LightField
from lfpipe.transport.ring import MS_NS, SECOND_NS, Stamp
from tests.live import made
from tests.render import rendered

MIDDLE = ((0.0, 0.5),)
FRAME_NS = SECOND_NS // 30


def record_of(frame: NDArray[np.uint8], live: LiveSource) -> NDArray[np.void]:
    """The record of a frame, as the disparity stage writes it."""
    return Estimator(live, aligns=False).estimate(frame, pairs_in_need(live, MIDDLE))


def scene(scale: float = 2.0) -> tuple[LightField, NDArray[np.uint8], LiveSource]:
    field = rendered.field(1, 2, 96, 128, scale=scale)
    return field, made.frame_of(field), made.source()


def test_show_draws_views_between_those_of_the_frame() -> None:
    exact, frame, live = scene()
    shown = LiveViews(live, "demo").show(frame, [(0, 0), (0, 1)], record_of(frame, live), 0)
    assert shown.needs_eyes and summary_of(live, "demo").needs_eyes
    how = Render(method="warp2", anaglyph="colour", zero_plane_px=0.0)
    picture, wanted = (
        Compositor(field, how).compose((0, 0.3), (0, 0.7)).astype(float) for field in (shown, exact)
    )
    inside = np.s_[:, 8:-8]
    assert psnr_db(float(np.mean((picture - wanted)[inside] ** 2))) > 30


def test_show_with_last_is_unknown_where_the_picture_has_changed() -> None:
    _, frame, live = scene()
    views = LiveViews(live, "demo")
    views.show(frame, [(0, 0), (0, 1)], record_of(frame, live), 0)
    changed = frame.copy()
    changed[40:60, 30:50] = 255 - changed[40:60, 30:50]
    field = views.show_with_last(changed, [(0, 0), (0, 1)])
    assert field.disparity is not None
    unknown = field.disparity[0, 0, 0] == UNKNOWN
    assert unknown[22:28, 17:23].all() and not unknown[:16].any() and not unknown[:, 40:].any()
    np.testing.assert_array_equal(field.views[0, 0, 0, 1], changed[:, :128, 1])


class Ring:
    """An input of a stage whose slots a test gives."""

    def __init__(self) -> None:
        self.slots: list[tuple[Stamp, np.ndarray]] = []

    def take(self, out: np.ndarray) -> Stamp | None:
        if not self.slots:
            return None
        stamp, payload = self.slots.pop(0)
        out[...] = payload
        return stamp


class Input:
    """A LiveInput without processes."""

    def __init__(self) -> None:
        self.field, self.frame, live = scene()
        self.record = record_of(self.frame, live)
        self.views, self.disparity = Ring(), Ring()
        rings = {"views": self.views, "disparity": self.disparity}
        self.input = LiveInput(Mock(input=rings.__getitem__), live, "demo")

    def stamp(self, k: int) -> Stamp:
        t_ns = SECOND_NS + k * FRAME_NS
        return Stamp(k + 1, k, 0, t_ns, t_ns, t_ns, 0)

    def step(self, k: int, disparity_of: int | None, later_ns: int = 0) -> LightField | None:
        """A new frame k, and disparity of frame disparity_of."""
        self.views.slots.append((self.stamp(k), self.frame))
        if disparity_of is not None:
            self.disparity.slots.append((self.stamp(disparity_of), self.record))
        return self.input.read(MIDDLE, self.stamp(k).t_publish_ns + later_ns)


def test_live_input_shows_a_frame_when_its_disparity_is_there() -> None:
    subject = Input()
    assert subject.step(0, None) is None
    assert subject.step(1, 0) is not None and subject.input.own_disparity
    assert subject.input.stamp is not None and subject.input.stamp.source_seq == 0
    assert subject.step(2, 2) is not None and subject.input.stamp.source_seq == 2
    assert subject.step(3, 1) is None, "a newer one is shown"


def test_live_input_shows_late_frames_with_the_last_disparity() -> None:
    subject = Input()
    subject.step(0, 0)
    shown = [subject.step(k, None) for k in range(1, 6)]
    assert shown[0] is None and shown[-1] is not None and shown[-2] is not None
    assert not subject.input.own_disparity
    assert subject.input.stamp is not None and subject.input.stamp.source_seq == 5
    assert subject.step(6, 3) is not None and not subject.input.own_disparity
    assert subject.input.stamp.source_seq == 6
    for k in range(7, 200):  # nothing grows while disparity is gone
        subject.step(k, None, 10 * MS_NS)
    assert subject.step(200, 200) is not None and subject.input.own_disparity
