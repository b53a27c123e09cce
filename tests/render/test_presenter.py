"""Presenter: composition, submission and reports of pictures, on displays without output."""

from unittest.mock import Mock

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Config
from lfpipe.host.presentation import Presented
from lfpipe.render.choice import DisplayTime, EyesSource
from lfpipe.render.display.display import Display
from lfpipe.render.display.refresh import Refresh, ScreenRefresh
from lfpipe.render.presenter import HANDOVER, REPLACED, Presentation, Presenter
from lfpipe.render.synthesis.pair_layout import Pair
from lfpipe.render.ui.pages import draw_glasses_test, glasses_test
from lfpipe.render.viewer.mouse_look import MouseLook
from lfpipe.transport.clock import now_ns
from lfpipe.transport.ring import Stamp
from tests.render.rendered import record, viewer

REFRESH_NS = 1_000_000_000 // 60


class Screen(Display):
    """Keeps pictures, and reports vblanks as the test requests."""

    def __init__(self, vblank_source: str = "") -> None:
        self.pictures: list[NDArray[np.uint8]] = []
        self.reports: list[Presented] = []
        self._by = vblank_source

    @property
    def vblank_source(self) -> str:
        return self._by

    def show(self, picture: NDArray[np.uint8], pair: Pair | None = None, how: str = "") -> int:
        self.pictures.append(picture.copy())
        return now_ns()

    def presented(self) -> list[Presented]:
        taken, self.reports = self.reports, []
        return taken

    def nominal_hz(self) -> float:
        return 60.0


class World:
    """A Presenter without a process."""

    def __init__(self, vblank_source: str = "", on_camera: bool = False) -> None:
        self.viewer = viewer()
        self.source = EyesSource()
        self.display = Screen(vblank_source)
        self.handed: list[Presentation] = []
        self.known: list[Presentation] = []
        self.listener = Mock(handed_over=self.handed.append, presented=self.known.append)
        self.refresh = (ScreenRefresh if vblank_source else Refresh)(60.0, now_ns())
        self.presenter = Presenter(
            viewer=self.viewer,
            source=self.source,
            mouse=MouseLook(Config(), self.viewer, None),
            display=self.display,
            refresh=None if on_camera else self.refresh,
            listeners=[self.listener],
            seq=7,
        )
        self.on_camera = on_camera

    def show(self, *, x: float = 320.0) -> Presentation:
        """Shows a picture for eyes of now."""
        t_ns = now_ns()
        self.source.update(record(x), Stamp(1, 1, 0, t_ns, t_ns, t_ns, 0))
        on_vblanks = bool(self.display.vblank_source)
        refresh_ns = 0 if self.on_camera else REFRESH_NS
        self.presenter.show(DisplayTime.of(t_ns + refresh_ns, refresh_ns, on_vblanks=on_vblanks))
        return self.handed[-1]


def test_presenter_composes_only_what_differs_from_the_screen() -> None:
    world = World()
    assert [world.show().composed for _ in range(3)] == [True, False, False]
    world.presenter.redraw()
    assert world.show().composed
    assert any(world.show(x=400).composed for _ in range(120)), "the eyes moved"
    known = world.known
    assert len(world.display.pictures) == sum(presentation.composed for presentation in known)
    assert [presentation.seq for presentation in known] == list(range(7, 7 + len(known)))


def test_presenter_on_the_cameras_clock_shows_every_frame() -> None:
    world = World(on_camera=True)
    assert [world.show().number for _ in range(3)] == [1, 2, 3]
    assert all(presentation.due_ns == 0 for presentation in world.known)


def test_presenter_draws_the_glasses_test_instead_of_the_scene() -> None:
    world = World()
    world.show()
    world.presenter.draw_by(draw_glasses_test)
    world.show()
    expected, _ = glasses_test(world.viewer.config.render, (16, 16))
    assert world.presenter.picture is not None
    assert np.array_equal(world.display.pictures[-1], expected)
    assert np.array_equal(world.presenter.picture, expected)


def test_presenter_reports_pictures_in_order_of_their_vblanks() -> None:
    world = World(vblank_source="vblanks")
    first = world.show()
    stayed = world.show()
    assert not stayed.composed and world.known == []
    world.presenter.redraw()
    second = world.show()
    late_ns = second.due_ns + 2 * REFRESH_NS
    world.display.reports = [Presented(1, first.due_ns, REFRESH_NS), Presented(2, late_ns, 0)]
    world.presenter.take_reports()
    assert [presentation.seq for presentation in world.known] == [
        7,
        8,
        9,
    ] and world.known == world.handed
    assert [presentation.by for presentation in world.known] == ["vblanks"] * 3
    assert stayed.t_presented_ns == stayed.due_ns
    assert (first.juddered, second.juddered) == (False, True)


def test_presenter_reports_the_last_pictures_at_the_end() -> None:
    world = World(vblank_source="vblanks")
    first = world.show()
    world.presenter.redraw()
    second = world.show()
    world.display.reports = [Presented(1, 0, 0)]
    world.presenter.take_reports()
    assert [presentation.by for presentation in world.known] == [REPLACED] and first.juddered
    world.presenter.close()
    assert second.by == HANDOVER and second.t_presented_ns == second.t_handed_ns
    assert world.listener.close.called
