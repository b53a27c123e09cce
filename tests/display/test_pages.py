"""Two pages of a session's window, by the mouse alone and by keys alone: one measures the camera,
one opens scenes from a disk.
"""

import tomllib
from pathlib import Path

import attrs
import pytest

from lfpipe.render.display.overlay import Menu, Overlay
from lfpipe.render.display.window_system import pygame
from lfpipe.render.ui.calibration import Distance, calibration_page
from lfpipe.render.ui.folders import folder_menu
from lfpipe.render.ui.overlay_view import ItemPanel, menu_panel, text_panel
from lfpipe.scene.demo import NAME
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

    def folder(self, menu: Menu, at: int | None = None) -> ItemPanel:
        """The page with the content of a folder, and that item selected."""
        area = self.finger.size_px[0], self.finger.bar().at[1]
        panel = menu_panel(menu, menu.at if at is None else at, area, self.finger.text_px)
        return self.wait_for(panel, menu.title)


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
def test_calibrate_opens_a_window_and_is_done_by_the_mouse_alone(
    world: World, screen: Screen
) -> None:
    world.env["DISPLAY"] = screen.name
    pygame.font.init()
    _chosen_glasses(world)
    world.make_demos_small()
    process = world.start(
        "calibrate", "--camera", "demo", "--distance", "560", "--session", world.name
    )
    pages = Pages.of(world, screen, NAME)
    finger = pages.finger
    finger.touch(pages.calibration(560), "alpha+")
    finger.touch(pages.calibration(570), "enter")
    stored = pages.calibration(570, is_stored=True)
    focal_px = _focal_px(world)
    assert isinstance(focal_px, float) and _stored(world) == {"focal_px": focal_px, "width_px": 640}
    finger.touch(stored, "previous")
    finger.touch(pages.calibration(570), "alpha-")
    finger.touch(pages.calibration(560), "enter")
    stored = pages.calibration(560, is_stored=True)
    finger.touch(stored, "close")
    world.wait_for(lambda: not pages.shows(stored), "the scene")
    assert (
        _focal_px(world) == _stored(world)["focal_px"] == pytest.approx(focal_px * 560 / 570, 0.02)
    )
    world.xdotool("key", "q")
    world.ended(process)


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


def _name(world: World) -> str:
    name: str = world.ask(cmd="hello")["options"]["scene"]["name"]
    return name


def _tree(root: Path) -> tuple[Path, Menu, Menu]:
    """A folder with a scene and a file, and what the page shows of both."""
    shelf = root / "shelf"
    scene = write_scene(shelf / "box", 1, 3)
    (shelf / "clip.mp4").write_bytes(b"no video")
    (shelf / "notes.txt").write_text("no scene")
    views = sorted(path.name for path in scene.iterdir() if path.suffix == ".png")
    return shelf, folder_menu(shelf, ["box"], ["clip.mp4"]), folder_menu(scene, [], views)


@needs_xdotool
def test_a_scene_is_opened_from_a_folder_by_the_mouse_alone(world: World, pages: Pages) -> None:
    shelf, outer, inner = _tree(world.root)
    root = folder_menu(world.root, *_listed(world.root))  # where the scene on the screen lies
    finger = pages.finger
    finger.use_bar("open")
    finger.touch(pages.folder(root), "enter-folder", str(shelf))
    finger.touch(pages.folder(outer), "enter-folder", str(shelf / "box"))
    finger.touch(pages.folder(inner), "enter-folder", str(shelf))
    finger.touch(pages.folder(outer), "enter-folder", str(shelf / "box"))
    finger.touch(pages.folder(inner), "load", str(shelf / "box"))
    world.wait_for(lambda: _name(world) == "box", "the chosen scene")
    world.xdotool("key", "q")


@needs_xdotool
def test_a_scene_is_opened_from_a_folder_by_keys_alone(world: World, pages: Pages) -> None:
    _, outer, inner = _tree(world.root)
    folders, files = _listed(world.root)
    root = folder_menu(world.root, folders, files)
    world.xdotool("key", "l")
    pages.folder(root)
    world.xdotool("key", *["Right"] * (2 + folders.index("shelf") - root.at), "Return")
    pages.folder(outer)
    world.xdotool("key", "Right", "Right", "Return")
    pages.folder(inner)
    world.xdotool("key", "Return")
    world.wait_for(lambda: _name(world) == "box", "the chosen scene")
    pages.finger.title = "lfpipe: box"
    world.wait_for(lambda: outline(pages.finger.title, pages.finger.screen.name), "its title")
    world.xdotool("key", "i")
    pages.folder(inner)
    world.xdotool("key", "q")


def _listed(root: Path) -> tuple[list[str], list[str]]:
    """The folders and films of a folder, as the page lists them."""
    entries = sorted(path for path in root.iterdir() if not path.name.startswith("."))
    return [path.name for path in entries if path.is_dir()], []
