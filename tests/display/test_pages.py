"""The page of a session's window that measures the camera, by keys alone."""

import tomllib

import attrs
import pytest

from lfpipe.render.display.overlay import Overlay
from lfpipe.render.display.window_system import pygame
from lfpipe.render.ui.calibration import Distance, calibration_page
from lfpipe.render.ui.overlay_view import ItemPanel, text_panel
from tests.support.finger import Finger
from tests.support.world import World, write_scene
from tests.support.xvfb_screen import Screen, needs_xdotool, outline

HINTS = "(h shows the keys, g tests your glasses)"
OTHER = 60  # of 255: more than the picture shines through, less than a letter that is off


@attrs.define
class Pages:
    """The pages of a window, compared with what is on the screen."""

    finger: Finger

    @classmethod
    def of(cls, world: World, screen: Screen, name: str) -> "Pages":
        finger = Finger(world, screen, f"lfpipe: {name} {HINTS}", frozenset({"choose"}))
        world.wait_for(
            lambda: outline(finger.title, screen.name) and len(screen.shown()), "a picture in it"
        )
        return cls(finger)

    def shows(self, panel: ItemPanel) -> bool:
        """Whether the items of that panel are on the screen."""
        drawn = pygame.surfarray.pixels3d(panel.surface).swapaxes(0, 1)
        left, top = (a + b for a, b in zip(self.finger.place, panel.at, strict=False))
        seen = self.finger.screen.picture()[top:, left:]
        cells = [
            (slice(rect.top, rect.bottom), slice(rect.left, rect.right)) for _, rect in panel.cells
        ]
        return not any(
            (abs(drawn[cell].min(axis=-1).astype(int) - seen[cell].min(axis=-1)) > OTHER).any()
            for cell in cells
        )

    def wait_for(self, panel: ItemPanel, what: str) -> ItemPanel:
        self.finger.world.wait_for(lambda: self.shows(panel), what)
        return panel

    def calibration(self, mm: float, is_stored: bool = False) -> ItemPanel:
        """The page, once it offers to accept that distance, or has stored it."""
        page = calibration_page(Distance(f"{mm:g}"), True, True, is_stored)
        size_px = self.finger.size_px
        shown = Overlay(lines=page.lines, items=page.items)
        panel = text_panel(shown, self.finger.bar().at[1], size_px, self.finger.text_px)
        return self.wait_for(panel, f"{mm:g} mm")


@pytest.fixture
def pages(world: World, screen: Screen) -> Pages:
    """Those of a session in a window, whose scene is "grid" and whose viewer is recorded."""
    world.env["DISPLAY"] = screen.name
    pygame.font.init()
    _chosen_glasses(world)
    world.up(write_scene(world.root / "grid", 3, 3), display="window")
    return Pages.of(world, screen, "grid")


def _chosen_glasses(world: World) -> None:
    """Else the window begins with the question about them."""
    settings = world.root / "settings" / "lfpipe" / "config.toml"
    settings.parent.mkdir(parents=True)
    settings.write_text('[render]\nanaglyph = "dubois"\n')


def _focal_px(world: World) -> float | str:
    focal_px: float | str = world.monitor()["config"]["camera"]["focal_px"]
    return focal_px


def _stored(world: World) -> dict[str, float]:
    cameras = world.root / "settings" / "lfpipe" / "cameras.toml"
    found: dict[str, float] = tomllib.loads(cameras.read_text())["demo"]
    return found


@needs_xdotool
def test_calibrate_asks_the_open_window_and_is_done_by_keys_alone(
    world: World, pages: Pages
) -> None:
    settings = world.root / "settings" / "lfpipe" / "config.toml"
    settings.write_text(settings.read_text() + "[camera]\nfocal_px = 999.0  # mine\n")
    for _ in "ab":  # the second time it only sets the distance
        said = world.done("calibrate", "--distance", "700", "--session", world.name).stdout
        assert "in the open window" in said
        pages.calibration(700)
    other = "calibrate", "--camera", "file:me.mp4", "--session", world.name
    assert f"`lfpipe ctl --session {world.name} viewer file:me.mp4`" in world.refused(*other)
    world.xdotool("key", "6", "1", "BackSpace", "0", "0")
    pages.calibration(600)
    world.xdotool("key", "minus", "Right")
    pages.calibration(600)
    world.xdotool("key", "Return")
    pages.calibration(600, is_stored=True)
    assert _focal_px(world) == _stored(world)["focal_px"]
    assert "focal_px" not in settings.read_text() and "dubois" in settings.read_text()
    world.xdotool("key", "Prior")
    first = pages.calibration(600)
    world.xdotool("key", "Escape")
    world.wait_for(lambda: not pages.shows(first), "the scene")
    world.xdotool("key", "k")
    pages.calibration(600)
    world.xdotool("key", "q")
