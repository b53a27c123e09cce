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
from lfpipe.scene.demo import NAMES, demo_scene
from tests.world import private_world
from tests.xvfb_screen import Screen, x_server

ROOT = Path(__file__).resolve().parents[1]
SIDE_PX, COLOURS = 320, 160


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
        env = world.env | {"DISPLAY": name, "XDG_CACHE_HOME": str(cache_dir(Scene()).parent)}
        scenes = [str(demo_scene(cache_dir(Scene()), name=scene)) for scene in NAMES]
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
        settings = Path(world.env["XDG_CONFIG_HOME"]) / "lfpipe" / "config.toml"  # no question about glasses
        settings.parent.mkdir(parents=True)
        settings.write_text('[render]\nanaglyph = "dubois"\n')
        session = subprocess.Popen(command, env=env, cwd=folder)
        while not screen.picture().any():  # the first time it packs the scene
            time.sleep(0.5)
        time.sleep(2.0)

        def do(*words: str, wait_s: float = 1.0) -> None:
            subprocess.run(["xdotool", *words], env=env, check=True)
            time.sleep(wait_s)

        for keys in (["Tab"], ["Tab", "m", "p"], ["p", "m", "g"]):
            for key in keys:
                do("key", key)
            time.sleep(14.0 * (keys == ["Tab"]))  # the packer reads pictures of scenes
            if "g" not in keys and "m" in keys:
                do("mousemove", "600", "400", "mousemove", "640", "420", wait_s=0.8)
            elif "g" in keys:
                time.sleep(4.0)  # the bar has gone
            seen.append(cv2.resize(screen.shown(), (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_AREA))
        session.terminate()
        session.wait(30)
    whole = cv2.cvtColor(np.hstack(seen), cv2.COLOR_BGR2RGB)
    Image.fromarray(whole).quantize(COLOURS, dither=Image.Dither.NONE).save(out, optimize=True)
    print(f"{out}: {out.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
