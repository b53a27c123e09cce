"""The pictures of README and docs: anaglyph_modes.png of the demo scene; anaglyph.png, view_grid.png, monitor.png and page.png
of a running demo.

    uv run python tools/make_docs_pictures.py [FOLDER]

page.png needs chromium and chromedriver, and is left as it is without them.
"""

import argparse
import asyncio
import base64
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from rich.console import Console

ROOT = Path(__file__).resolve().parents[1]
LARGEST_BYTES = 300_000
BACK, FORE, DIM = (18, 22, 27), (223, 229, 236), (139, 151, 166)
INKS = {"green": (139, 226, 139), "yellow": (255, 196, 107), "cyan": (79, 214, 232), "red": (255, 107, 107)}
COLUMNS, FONT_PX = 80, 17
TILE_PX, LABEL_PX = 256, 22


def save(path: Path, picture: NDArray[np.uint8]) -> None:
    """A PNG of BGR, made smaller until it is small enough."""
    while True:
        cv2.imwrite(str(path), picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])
        if path.stat().st_size < LARGEST_BYTES:
            print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")
            return
        picture = cv2.resize(picture, None, fx=0.9, fy=0.9, interpolation=cv2.INTER_AREA).astype(np.uint8)


def terminal(text: object) -> NDArray[np.uint8]:
    """A rich text as a terminal of COLUMNS shows it, BGR."""
    console = Console(width=COLUMNS, color_system="truecolor", force_terminal=True, no_color=False)
    lines = console.render_lines(text, pad=True)  # type: ignore[arg-type]
    fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    plain, bold = (ImageFont.truetype(str(fonts / name), FONT_PX) for name in ("DejaVuSansMono.ttf", "DejaVuSansMono-Bold.ttf"))
    cell, step = plain.getlength("x"), FONT_PX + 5
    image = Image.new("RGB", (round(cell * COLUMNS) + 24, step * len(lines) + 20), BACK)
    draw = ImageDraw.Draw(image)
    for row, line in enumerate(lines):
        column = 0
        for segment in line:
            style = segment.style
            ink = INKS.get(style.color.name if style and style.color else "", DIM if style and style.dim else FORE)
            for character in segment.text.rstrip("\n"):
                place = (12 + column * cell, 10 + row * step)
                draw.text(place, character, ink, bold if style and style.bold else plain)
                column += 1
    return cv2.cvtColor(np.asarray(image), cv2.COLOR_RGB2BGR).astype(np.uint8)


def page(url: str, out: Path, profile: Path) -> None:
    """The page in a browser, where there is one."""
    sys.path.insert(0, str(ROOT))
    from tests.web.browser import Browser, missing

    if why := missing():
        print(f"{out} left as it is: {why}")
        return
    with Browser(profile) as browser:
        browser.open(url)
        time.sleep(12)
        browser.screenshot(profile / "page.png")
    picture = cv2.imread(str(profile / "page.png"))
    assert picture is not None
    save(out, picture.astype(np.uint8))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, nargs="?", default=ROOT / "docs")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        modes(out, folder)
        os.environ["XDG_RUNTIME_DIR"] = folder
        for name in ("DISPLAY", "WAYLAND_DISPLAY"):
            os.environ.pop(name, None)
        session = subprocess.Popen([sys.executable, "-m", "lfpipe", "up", "--demo", "--display", "none", "--session", "docs"])
        try:
            asyncio.run(take(out, Path(folder)))
        finally:
            session.send_signal(signal.SIGTERM)
            session.wait()


def modes(out: Path, folder: str) -> None:
    """The same viewpoint of the demo scene in every anaglyph mode."""
    from lfpipe.config import Render, Scene
    from lfpipe.config.tree import choices
    from lfpipe.render.compositor import Compositor
    from lfpipe.scene.demo import demo_scene
    from lfpipe.scene.open_scene import open_scene

    field = open_scene(demo_scene(Path(folder), size_px=TILE_PX), Scene(cache_dir=folder))
    middle, tiles = (field.rows - 1) / 2, []
    for mode in choices("render.anaglyph"):
        compositor = Compositor(field, Render(method="warp2", anaglyph=mode))  # type: ignore[arg-type]
        label = np.full((LABEL_PX, TILE_PX, 3), 255, np.uint8)
        cv2.putText(label, mode, (4, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1, cv2.LINE_AA)
        tiles.append(np.vstack([label, compositor.compose((middle, middle - 1.5), (middle, middle + 1.5))]))
    save(out / "anaglyph_modes.png", np.vstack([np.hstack(tiles[k : k + 5]) for k in range(0, len(tiles), 5)]))


async def take(out: Path, folder: Path) -> None:
    from lfpipe.observe.page_feed import Feed
    from lfpipe.observe.session_commands import ask
    from lfpipe.observe.session_reader import FollowingReader
    from lfpipe.observe.state_text import screen_text

    feed, follower, text = Feed("docs"), FollowingReader("docs"), None
    jpegs: dict[bytes, bytes] = {}
    started = time.monotonic()
    async for sample in feed.events():
        if (state := follower.read()) is not None:
            text = screen_text(state, ask("docs", {"cmd": "hello"}), "")
        jpegs = dict(event.split(b"\ndata: ") for event in sample.split(b"event: ")[1:])
        if time.monotonic() - started > 25:
            break
    assert text is not None, "the demo does not run"
    save(out / "monitor.png", terminal(text))
    for name, which in (("anaglyph", b"picture"), ("view_grid", b"camera")):
        picture = cv2.imdecode(np.frombuffer(base64.b64decode(jpegs[which]), np.uint8), cv2.IMREAD_COLOR)
        assert picture is not None
        save(out / f"{name}.png", picture.astype(np.uint8))
    follower.close()
    await feed.end()
    command = [sys.executable, "-m", "lfpipe", "monitor", "--session", "docs", "--web", ":0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        page(server.stdout.readline().split()[3], out / "page.png", folder)
        server.terminate()


if __name__ == "__main__":
    main()
