"""The pictures of README and docs/: look_around.webp, live.webp, monitor.svg, page.png, window.png
and timeline.svg; and the window's thumbnails of the demo's scenes.

    uv run python -m tools.make_docs_pictures [--out docs] [NAME ...]

animation: the red/cyan picture of the demo's scene, what the glasses show of it, and what the
paper's method shows, by their measured lags; below, the head moves.
live: a moving scene, whose two views and disparity are those of a session, through the red and
through the cyan filter, from two places of the head.
monitor: the terminal and the page (which needs chromium and chromedriver) of a running demo.
window: under Xvfb (with xdotool): the bar, and the choice of scenes (key Tab), side by side; and
the pictures of three camera frames from its trace.
interface: docs/pictures.json, digests of what these show; a test fails where they are old.
thumbnails: of the demo's scenes, for the window. Nothing named: all.
"""

import argparse
import hashlib
import io
import itertools
import json
import math
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from PIL import Image, ImageDraw, ImageFont
from rich.console import Console

import lfpipe
from lfpipe.config import LiveSource, Scene
from lfpipe.extras.web.server import STATIC
from lfpipe.live.field import Estimator, LiveViews
from lfpipe.live.records import pairs_in_need, views_of
from lfpipe.monitor.monitor import screen_view
from lfpipe.monitor.session_reader import Follower, Sample
from lfpipe.render.display.display import HELP, Overlay, bar_items
from lfpipe.render.display.look import NO_HIGHLIGHT
from lfpipe.render.display.panels import bar_panel, menu_panel, text_panel
from lfpipe.render.display.window_system import FONT, pygame
from lfpipe.render.ui.pages import glasses_menu
from lfpipe.render.ui.scenes import THUMBNAILS
from lfpipe.scene.demo_drawing import draw_view
from lfpipe.scene.layouts.demo import solids_of
from lfpipe.scene.pack import DEMO, DEMO_SIZE_PX, DEMOS, cache_dir, demo_scene
from lfpipe.supervisor.metrics import session_metrics
from lfpipe.supervisor.process_table import CORE, METRICS
from lfpipe.transport.ring import MS_NS
from lfpipe.transport.status import ROW, SESSION
from tests.support.browser import Browser, missing
from tests.support.world import World, private_world
from tests.support.xvfb_screen import Screen, x_server

# of the animation: a head goes and comes back, as people do; three panels, the floor with the head
PERIOD_S, LOOK_STEP_MS, LOOK_QUALITY = 2.4, 60, 58
LOOK_PX, GAP_PX, FLOOR_PX, HEAD_PX = 392, 12, 140, 104
WIDTH_PX = 3 * LOOK_PX + 2 * GAP_PX
LAG_S = {"lfpipe": 0.039, "paper": 0.123}  # docs/figures.md
# of the live scene: milliseconds between frames, width of a panel
STEP_MS, PANEL_PX = 100, 300
# of the live scene: frames, seconds from its first to its last moment, columns of the demo's grid
# that its two cameras stand at, and columns of both eyes, from the first camera to the second
LIVE_FRAMES, LIVE_TRACK, LIVE_COLS, LIVE_QUALITY, LABEL_PX = 20, 2.0, (-1.0, 1.0), 40, 22
HEADS = {"left": (-0.5, 0.1), "right": (0.9, 1.5)}
FILTERS = {"red": (0, 0, 1), "cyan": (1, 1, 0)}  # channels that pass, BGR
INK = (87, 96, 106)
FLOOR = (246, 248, 250)
SKIN, SHADE, HAIR = (241, 212, 184), (222, 186, 154), (78, 58, 46)
RED = (216, 52, 59)
CYAN = (0, 165, 181)
SIDE_PX, WINDOW_COLOURS, THUMBNAIL_PX = 640, 255, 320
ROWS = (
    "camera, driver, decoding",
    "tracking",
    "waiting for its turn",
    "composing",
    "waiting for vblank",
    "screen to light",
)
ROW_COLOURS = ("#56b4e9", "#009e73", "#d0d7de", "#e69f00", "#d0d7de", "#cc79a7")
STAMPS = (
    "t_sensor_ns",
    "t_read_ns",
    "t_tracked_ns",
    "t_started_ns",
    "t_composed_ns",
    "t_presented_ns",
)
# lines that a session takes to find its pace; drawn behind the present, not in the trace
SETTLED, DEVICE_LATENCY_MS = 60, 45.0


def panel(picture: np.ndarray, width_px: int = PANEL_PX) -> Image.Image:
    """A BGR picture at the width of a panel."""
    height = round(picture.shape[0] * width_px / picture.shape[1])
    return Image.fromarray(
        cv2.resize(picture, (width_px, height), interpolation=cv2.INTER_AREA)[..., ::-1]
    )


def head(size_px: int) -> Image.Image:
    """A face with red/cyan glasses, seen from the screen, with transparency."""
    unit = 4 * size_px / 100  # drawn four times as large, for smooth edges
    picture = Image.new("RGBA", (4 * size_px, 4 * size_px))
    draw = ImageDraw.Draw(picture)

    def box(x0: float, y0: float, x1: float, y1: float) -> tuple[float, float, float, float]:
        return x0 * unit, y0 * unit, x1 * unit, y1 * unit

    draw.ellipse(box(18, 2, 82, 74), fill=HAIR)
    for x in (16, 74):
        draw.ellipse(box(x, 40, x + 10, 60), fill=SHADE)  # ears
    draw.ellipse(box(22, 10, 78, 96), fill=SKIN)
    draw.pieslice(box(20, 4, 80, 58), 180, 360, fill=HAIR)
    draw.polygon(
        [(47 * unit, 62 * unit), (50 * unit, 46 * unit), (53 * unit, 62 * unit)], fill=SHADE
    )
    draw.arc(box(38, 62, 62, 80), 25, 155, fill=INK, width=round(2 * unit))  # mouth
    draw.rectangle(box(22, 40, 78, 43), fill=INK)  # of the glasses
    # seen from the front, the viewer's left eye is on the right
    for x, colour in ((27, CYAN), (53, RED)):
        draw.rounded_rectangle(
            box(x, 39, x + 20, 53), 3 * unit, fill=colour, outline=INK, width=round(1.6 * unit)
        )
    return picture.resize((size_px, size_px), Image.Resampling.LANCZOS)


def frame(field: lfpipe.LightField, t_s: float) -> Image.Image:
    """One picture of the animation at a time: the screen, what lfpipe shows through the glasses,
    and what the paper's method shows.
    """

    def turn(at_s: float) -> float:
        return math.sin(2 * math.pi * at_s / PERIOD_S)

    def col(at_s: float) -> float:
        return (field.cols - 1) / 2 + ((field.cols - 1) / 2 - 1) * turn(at_s)

    row = (field.rows - 1) / 2
    here = col(t_s - LAG_S["lfpipe"])
    late = col(t_s - LAG_S["paper"])
    shown = {
        "on the screen": lfpipe.render_anaglyph(field, (row, here - 1.0), (row, here + 1.0)),
        "through the glasses, by lfpipe": lfpipe.render_view(field, row, here),
        "by the paper's method": lfpipe.render_view(field, row, late, method="nearest"),
    }
    canvas = Image.new("RGB", (WIDTH_PX, LOOK_PX + FLOOR_PX), FLOOR)
    draw = ImageDraw.Draw(canvas)
    letters = ImageFont.truetype(str(FONT), 17)
    for k, (text, picture) in enumerate(shown.items()):
        x = k * (LOOK_PX + GAP_PX)
        canvas.paste(panel(picture, LOOK_PX), (x, 0))
        draw.text((x + 4, LOOK_PX + 8), text, fill=INK, font=letters)
    face = head(HEAD_PX)
    x = round(WIDTH_PX / 2 - 0.3 * WIDTH_PX * turn(t_s) - HEAD_PX / 2)  # a mirror of the viewer
    canvas.paste(face, (x, LOOK_PX + FLOOR_PX - HEAD_PX - 2), face)
    return canvas


def animation(out: Path) -> None:
    field = lfpipe.open_scene()
    count = round(PERIOD_S * 1e3 / LOOK_STEP_MS)
    pictures = [frame(field, index * LOOK_STEP_MS / 1e3) for index in range(count)]
    _save_film(pictures, out / "look_around.webp", LOOK_STEP_MS, LOOK_QUALITY)


def _save_film(pictures: Sequence[Image.Image], path: Path, step_ms: int, quality: int) -> None:
    pictures[0].save(
        path,
        save_all=True,
        append_images=pictures[1:],
        duration=step_ms,
        loop=0,
        quality=quality,
        method=6,
    )


def live_frames(phases: Sequence[float]) -> Iterator[Image.Image]:
    """Pictures of a scene that a pair of cameras passes. phases: 0 to 1, from one side to the other
    and back; in order, because disparity starts from the frame before.
    """
    source = LiveSource(
        source="demo", rows=1, cols=2, tiles_across=2, frame_px=(2 * DEMO_SIZE_PX, DEMO_SIZE_PX)
    )
    estimator, views = Estimator(source, aligns=False), LiveViews(source, "demo")
    pair = pairs_in_need(source, [(0.0, 0.5)])
    for number, phase in enumerate(phases):
        passed = LIVE_TRACK * math.cos(2 * math.pi * phase)
        taken = np.hstack([draw_view(solids_of(DEMO), passed + col, 0.0)[0] for col in LIVE_COLS])
        picture = np.ascontiguousarray(taken[..., ::-1])
        record = estimator.estimate(picture, pair)
        field = views.show(picture, views_of(pair), record, number * STEP_MS * MS_NS)
        canvas = Image.new("RGB", (2 * PANEL_PX + 12, 2 * (PANEL_PX + LABEL_PX)), FLOOR)
        draw = ImageDraw.Draw(canvas)
        for k, (head, cols) in enumerate(HEADS.items()):
            shown = lfpipe.render_anaglyph(field, *((0.0, col) for col in cols))
            for eye, (glass, seen) in enumerate(FILTERS.items()):
                place = eye * (PANEL_PX + 12), k * (PANEL_PX + LABEL_PX)
                canvas.paste(panel(shown * np.array(seen, np.uint8)), place)
                text = f"head on the {head}, through the {glass} filter"
                draw.text((place[0] + 6, place[1] + PANEL_PX + 5), text, fill=INK)
        yield canvas


def live(out: Path) -> None:
    pictures = list(live_frames([index / LIVE_FRAMES for index in range(LIVE_FRAMES)]))
    _save_film(pictures, out / "live.webp", STEP_MS, LIVE_QUALITY)


def started(world: World, *words: str, **env: str) -> "subprocess.Popen[bytes]":
    """A session of the demo's scene and face."""
    more = {"XDG_CACHE_HOME": str(cache_dir(Scene()).parent), **env}
    command = [
        sys.executable,
        "-m",
        "lfpipe",
        "up",
        "--camera",
        "demo",
        "--session",
        world.name,
        *words,
    ]
    # no question about glasses
    settings = Path(world.env["XDG_CONFIG_HOME"]) / "lfpipe" / "config.toml"
    settings.parent.mkdir(parents=True)
    settings.write_text('[render]\nanaglyph = "dubois"\n')
    return subprocess.Popen(command, env=world.env | more, cwd=world.root)


def monitor(out: Path) -> None:
    with private_world() as world, tempfile.TemporaryDirectory() as folder:
        world.name = "default"
        session = started(world, str(demo_scene(cache_dir(Scene()))), "--display", "none")
        follower = Follower(world.name)
        text = None
        for _ in range(100):
            time.sleep(0.25)
            if (state := follower.read()) is not None:
                text = screen_view(world.name, state)
        follower.close()
        assert text is not None, "the demo does not run"
        console = Console(width=80, record=True, file=io.StringIO())
        console.print(text)
        svg = re.sub(
            r"@font-face \{.*?\}\s*",
            "",
            console.export_svg(title="lfpipe monitor"),
            flags=re.DOTALL,
        )
        (out / "monitor.svg").write_text(svg)  # without fonts from elsewhere
        if why := missing():
            print(f"page.png left as it is: {why}")
        else:
            command = [
                sys.executable,
                "-m",
                "lfpipe",
                "monitor",
                "--session",
                world.name,
                "--web",
                ":0",
            ]
            with (
                subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server,
                Browser(Path(folder)) as browser,
            ):
                assert server.stdout is not None
                browser.open(server.stdout.readline().split()[3])
                time.sleep(12)
                browser.screenshot(Path(folder, "page.png"))
                server.terminate()
            page = Image.open(Path(folder, "page.png")).convert("RGB")
            page.quantize(256, dither=Image.Dither.NONE).save(out / "page.png", optimize=True)
        session.terminate()
        session.wait(30)


def window(out: Path) -> None:
    seen = []
    with (
        private_world() as world,
        tempfile.TemporaryDirectory() as folder,
        x_server(["Xvfb", "-screen", "0", "1280x1024x24", "-fbdir", folder], Path(folder)) as name,
    ):
        screen = Screen(name, Path(folder) / "Xvfb_screen0")
        trace = Path(folder) / "trace.jsonl"
        scenes = [str(demo_scene(cache_dir(Scene()), name=scene)) for scene in DEMOS]
        session = started(
            world, *scenes, "--display", "window", "--trace", str(trace), DISPLAY=name
        )
        while not screen.picture().any():  # the first time it packs the scene
            time.sleep(0.5)
        time.sleep(8.0)
        lines = trace.read_text().splitlines()[:-1]
        move = ["mousemove", "600", "400", "mousemove", "640", "420"]
        for words, wait_s in ((["key", "y", *move], 1.0), (["key", "Tab"], 14.0)):
            subprocess.run(["xdotool", *words], env={**world.env, "DISPLAY": name}, check=True)
            time.sleep(wait_s)
            side = (SIDE_PX, SIDE_PX)
            seen.append(cv2.resize(screen.shown(), side, interpolation=cv2.INTER_AREA))
        session.terminate()
        session.wait(30)
    whole = Image.fromarray(cv2.cvtColor(np.hstack(seen), cv2.COLOR_BGR2RGB))
    whole.quantize(WINDOW_COLOURS, dither=Image.Dither.NONE).save(out / "window.png", optimize=True)
    timeline([json.loads(line) for line in lines], out)


def digests() -> dict[str, str]:
    """Of what window.png, page.png and monitor.svg show, and the version that drew the window."""
    size_px = (920, 690)
    pygame.font.init()
    panels = (
        bar_panel(bar_items(0.15, False, False, frozenset()), NO_HIGHLIGHT, size_px, 18),
        menu_panel(glasses_menu("dubois"), 0, size_px, 18),
        text_panel(Overlay(lines=HELP), size_px[1], size_px, 18),
    )
    rows = {name: np.zeros((), ROW) for name in CORE}
    state = session_metrics("default", rows, METRICS, np.zeros((), SESSION), 0)
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(screen_view("default", Sample(state)))
    page = [(STATIC / name).read_bytes() for name in ("index.html", "page.css")]
    parts = {
        "window": [pygame.image.tobytes(panel.surface, "RGB") for panel in panels],
        "page": page,
        "monitor": [re.sub(r"\d+", "0", console.export_text()).encode()],
    }
    sums = {name: hashlib.sha256(b"".join(part)).hexdigest() for name, part in parts.items()}
    return {"pygame-ce": pygame.version.ver, **sums}


def interface(out: Path) -> None:
    (out / "pictures.json").write_text(json.dumps(digests(), indent=1) + "\n")


def thumbnails(_out: Path) -> None:
    """The middle views of the demo's scenes, for the window."""
    for name in DEMOS:
        field = lfpipe.open_scene(demo_scene(cache_dir(Scene()), name=name))
        view = lfpipe.render_view(field, (field.rows - 1) / 2, (field.cols - 1) / 2)
        small = cv2.resize(view, (THUMBNAIL_PX, THUMBNAIL_PX), interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(THUMBNAILS / f"{name}.jpg"), small, [cv2.IMWRITE_JPEG_QUALITY, 88])


def timeline(lines: Sequence[dict[str, Any]], out: Path, frames: int = 3) -> None:
    """The first pictures of a few frames in a row: those whose age is most usual."""
    new = [
        line
        for before, line in itertools.pairwise(lines)
        if line["source_seq"] != before["source_seq"] and line["composed"]
    ]
    first = new[SETTLED:]
    ages = [line["t_presented_ns"] - line["t_sensor_ns"] for line in first]
    middle = sorted(ages)[len(ages) // 2]
    best = min(
        range(len(first) - frames + 1),
        key=lambda k: max(abs(age - middle) for age in ages[k : k + frames]),
    )
    pictures = first[best : best + frames]
    with mpl.rc_context(
        {"svg.hashsalt": "lfpipe", "font.family": "DejaVu Sans", "svg.fonttype": "path"}
    ):
        metric = Figure(figsize=(10, 4.2), layout="constrained")
        axes = metric.subplots()
        high = 0.8 / len(pictures)  # each frame has a lane of its own in every row
        for number, picture in enumerate(pictures):
            times = [(picture[name] - pictures[0]["t_sensor_ns"]) / 1e6 for name in STAMPS]
            for row, (start, end) in enumerate(
                itertools.pairwise([*times, times[-1] + DEVICE_LATENCY_MS])
            ):
                lane = row - 0.4 + (number + 0.5) * high
                axes.barh(
                    lane,
                    max(end - start, 0.15),
                    left=start,
                    height=0.9 * high,
                    color=ROW_COLOURS[row],
                )
                axes.text(end + 0.5, lane, f"{end - start:.1f} ms", va="center", fontsize=7)
        axes.set_yticks(range(len(ROWS)), ROWS, fontsize=9)
        axes.invert_yaxis()
        axes.set_xlabel("ms after the stamp of the first frame", fontsize=9)
        axes.spines[["top", "right"]].set_visible(False)
        metric.savefig(
            out / "timeline.svg", metadata={"Date": None, "Creator": "tools/make_docs_pictures.py"}
        )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs")
    parser.add_argument("names", nargs="*", metavar="NAME")
    options = parser.parse_args()
    makers = {
        "animation": animation,
        "live": live,
        "monitor": monitor,
        "window": window,
        "thumbnails": thumbnails,
        "interface": interface,
    }
    for name in options.names or makers:
        makers[name](options.out)


if __name__ == "__main__":
    main()
