"""Pictures of the window's pages at one size of the screen, opened and closed by taps alone.

    uv run python -m tools.window_pages [--size 800x600] [--out FOLDER]

Needs Xvfb, openbox and xdotool. Each page is a PNG of the whole screen; window_pages-SIZE.jpg holds
all, as in profiling/results.
"""

import argparse
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

from lfpipe.config import Render, Scene
from lfpipe.render.display.display import HELP, Event, Item, Menu, Overlay
from lfpipe.render.display.panels import EDGE_PX, Panel, menu_panel, text_panel, top_px
from lfpipe.render.display.window_system import pygame
from lfpipe.render.ui.pages import Distance, calibration_page, glasses_menu, instructions
from lfpipe.render.ui.scenes import OPEN
from lfpipe.scene.pack import DEMOS, cache_dir, demo_scene
from tests.support.finger import Finger
from tests.support.world import World, private_world, until
from tests.support.xvfb_screen import Screen, outline, x_server

FIRST_TITLE = "lfpipe: {} (h shows the keys, g tests your glasses)"
SETTLE_S = 1.5  # then a page is there, with what it reads
SHEET_COLS, SHEET_PX, QUALITY = 3, 640, 75


def _menu(finger: Finger, menu: Menu) -> Panel:
    return menu_panel(menu, 0, (finger.size_px[0], finger.bar().at[1]), finger.text_px)


def _text(finger: Finger, text: Overlay) -> Panel:
    shown = Overlay(title=text.title, lines=text.lines, items=text.items)
    top = EDGE_PX if text.items else top_px(finger.text_px)
    return text_panel(shown, finger.bar().at[1], finger.size_px, finger.text_px, top)


def _test(finger: Finger) -> Panel:
    return _text(finger, instructions(Render(**finger.world.monitor()["config"]["render"])))


def walk(finger: Finger, scenes: Sequence[Path]) -> Iterator[str]:
    """Opens and closes every page by taps; yields the name of what is on the screen."""
    yield "which-glasses"
    finger.touch(_menu(finger, glasses_menu("dubois")), "wear", "dubois")
    yield "glasses-test"
    finger.touch(_test(finger), "swap")
    yield "eyes-swapped"
    finger.touch(_test(finger), "swap")
    finger.touch(_test(finger), "close")
    yield "closed"
    finger.tap(5, 5)
    yield "bar"
    finger.use_bar("choose")
    yield "scenes"
    tiles = [Item(scene.name, Event("load", str(scene))) for scene in scenes]
    looks = Item("Viewer", Event("who"), row=True)
    menu = Menu("Choose a scene", (OPEN, looks, Item("Demos", row=True), *tiles))
    finger.touch(_menu(finger, menu), "load", str(scenes[1]))
    finger.title = f"lfpipe: {scenes[1].name}"
    until(lambda: outline(finger.title, finger.screen.name), "second scene")
    yield "another-scene"
    finger.use_bar("help")
    yield "help"
    finger.touch(_text(finger, Overlay(title="Keys and mouse", lines=HELP)), "close")
    finger.use_bar("overlay")
    time.sleep(3.0)  # the bar goes
    yield "metrics"
    finger.use_bar("overlay")
    finger.use_bar("freeze")
    yield "paused"
    finger.use_bar("freeze", paused=True)
    finger.use_bar("record")
    time.sleep(3.0)
    yield "recording"
    finger.use_bar("record", recording=True)
    yield "recorded"
    finger.use_bar("invert-depth")
    yield "near-and-far"
    finger.use_bar("open")
    time.sleep(3.0)
    yield "folder"
    finger.world.ask(cmd="action", name="calibrate", value=600.0)
    time.sleep(3.0)
    yield "calibrate"
    finger.touch(_text(finger, calibration_page(Distance(60), True, True, False)), "enter")
    time.sleep(3.0)
    yield "calibrated"
    finger.touch(_text(finger, calibration_page(Distance(60), True, True, True)), "close")
    finger.use_bar("fullscreen")
    yield "full-screen"
    finger.use_bar("which")
    yield "full-screen-glasses"
    finger.touch(_menu(finger, glasses_menu("dubois")), "close")
    finger.use_bar("fullscreen")
    yield "window-again"


def sheet(pictures: Sequence[np.ndarray], names: Sequence[str]) -> np.ndarray:
    """All pictures with their names, SHEET_COLS in a row."""
    cells = []
    for picture, name in zip(pictures, names, strict=True):
        height_px = round(picture.shape[0] * SHEET_PX / picture.shape[1])
        small = cv2.resize(picture, (SHEET_PX, height_px), interpolation=cv2.INTER_AREA)
        cell = cv2.copyMakeBorder(small, 28, 4, 4, 4, cv2.BORDER_CONSTANT, value=(255, 255, 255))
        cv2.putText(cell, name, (6, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (0, 0, 0), 1, cv2.LINE_AA)
        cells.append(cell)
    cells += [np.full_like(cells[0], 255)] * (-len(cells) % SHEET_COLS)
    rows = (np.hstack(cells[at : at + SHEET_COLS]) for at in range(0, len(cells), SHEET_COLS))
    return np.vstack(list(rows))


def pages(world: World, screen: Screen, out: Path) -> tuple[list[np.ndarray], list[str]]:
    """Runs a session, and stores the picture of each page in out."""
    cache = cache_dir(Scene())
    scenes = [demo_scene(cache, name=name) for name in DEMOS]
    world.env |= {"DISPLAY": screen.name, "XDG_CACHE_HOME": str(cache.parent)}
    process = world.start("up", *scenes, "--camera", "demo", "--session", world.name)
    finger = Finger(world, screen, FIRST_TITLE.format(scenes[0].name))
    until(lambda: outline(finger.title, screen.name), "window")
    pictures, names = [], []
    for number, name in enumerate(walk(finger, scenes), 1):
        time.sleep(SETTLE_S)
        pictures.append(screen.picture())
        names.append(f"{number:02d} {name}")
        cv2.imwrite(str(out / f"{number:02d}-{name}.png"), pictures[-1])
        print(names[-1], flush=True)
    world.ctl("stop")
    world.ended(process)
    return pictures, names


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", default="1280x800", metavar="WIDTHxHEIGHT")
    parser.add_argument("--out", type=Path, default=Path("window_pages"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    pygame.font.init()
    with (
        private_world() as world,
        tempfile.TemporaryDirectory() as folder,
        x_server(
            ["Xvfb", "-screen", "0", f"{options.size}x24", "-fbdir", folder], Path(folder)
        ) as name,
        subprocess.Popen(["openbox"], env={**world.env, "DISPLAY": name}) as manager,
    ):
        time.sleep(1.0)  # else the window is there before its frame
        found = pages(world, Screen(name, Path(folder) / "Xvfb_screen0"), options.out)
        manager.terminate()
    path = options.out / f"window_pages-{options.size}.jpg"
    cv2.imwrite(str(path), sheet(*found), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])


if __name__ == "__main__":
    main()
