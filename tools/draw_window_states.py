"""What the window shows besides the scene, from a running demo under Xvfb: docs/window.png.

    uv run python -m tools.draw_window_states [OUT]

Side by side: thumbnails (key Tab), a change and a pause (keys m, p), the glasses test (key g). Needs xdotool.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from lfpipe.config import Scene
from lfpipe.scene.cache import cache_dir
from lfpipe.scene.demo import demo_scene
from tests.world import private_world
from tests.xvfb_screen import Screen, x_server

ROOT = Path(__file__).resolve().parents[1]
SIDE_PX, COLOURS, STARTED_S = 320, 96, 12.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", nargs="?", type=Path, default=ROOT / "docs" / "window.png")
    out = parser.parse_args().out
    seen = []
    with (
        private_world() as world,
        tempfile.TemporaryDirectory() as folder,
        x_server(["Xvfb", "-screen", "0", "1280x800x24", "-fbdir", folder], Path(folder)) as name,
    ):
        screen = Screen(name, Path(folder) / "Xvfb_screen0")
        env = {key: value for key, value in world.env.items() if key != "XDG_CACHE_HOME"} | {"DISPLAY": name}
        scenes = [str(demo_scene(cache_dir(Scene()), *size)) for size in ((), (5, 256))]
        command = [
            sys.executable,
            "-m",
            "lfpipe",
            "up",
            *scenes,
            "--camera",
            "demo",
            "--display",
            "window",
            "--session",
            world.name,
        ]
        session = subprocess.Popen(command, env=env, cwd=folder)
        time.sleep(STARTED_S)
        for keys in (["Tab"], ["Tab", "m", "p"], ["p", "m", "g"]):
            subprocess.run(["xdotool", "key", "--delay", "400", *keys], env=env, check=True)
            time.sleep(1.0)
            seen.append(cv2.resize(screen.shown(), (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_AREA))
        session.terminate()
        session.wait(30)
    whole = cv2.cvtColor(np.hstack(seen), cv2.COLOR_BGR2RGB)
    Image.fromarray(whole).quantize(COLOURS, dither=Image.Dither.NONE).save(out, optimize=True)
    print(f"{out}: {out.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
