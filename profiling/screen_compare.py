"""Two builds in one window on one screen, in turns: age of pictures at the blank that showed them, judder, and CPU of render.

    python -m profiling.screen_compare --before CHECKOUT SCENE [--seconds 20] [--rounds 3] [--system wayland|x]

The blanks of a build that does not know them are asked for by this build's code: a hook put beside the imports of its window.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median

import numpy as np

from tests.sway_screen import sway
from tests.xvfb_screen import x_server

HERE = Path(__file__).parents[1]
HOOK = """
import atexit, importlib.abc, importlib.util, json, os, sys
HERE, LOG = {here!r}, os.environ.get("SCREEN_LOG", "")

def load(name):
    spec = importlib.util.spec_from_file_location("lfpipe." + name, HERE + "/lfpipe/" + name.replace(".", "/") + ".py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module

def measured(window_module):
    load("host.presentation"), load("host.wayland_presentation"), load("host.x_presentation")
    system = load("render.window_system")
    class Measured(window_module.Window):
        def __init__(self, *a, **k):
            super().__init__(*a, **k)
            self.log, self.count, self.who = open(LOG, "w"), 0, system.open_presentation(self._window)
        def show(self, picture):
            self.count += 1
            self.who.expect(self.count)
            t_ns = super().show(picture)
            self.who.handed_over(self.count)
            self.log.write(json.dumps([self.count, t_ns, 0]) + "\\n")
            return t_ns
        def events(self):
            found = super().events()
            for each in self.who.take():
                self.log.write(json.dumps([each.serial, 0, each.t_ns]) + "\\n")
            return found
        def close(self):
            self.log.close()
            self.who.close()
            super().close()
    window_module.Window = Measured

class Finder(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name != "lfpipe.render.window":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        run = spec.loader.exec_module
        spec.loader.exec_module = lambda module: (run(module), measured(module))
        return spec

if LOG:
    sys.meta_path.insert(0, Finder())
"""


@contextmanager
def screen(system: str, rate_hz: float, size: str) -> Iterator[dict[str, str]]:
    """The environment of a window on a server of its own."""
    width, height = (int(part) for part in size.split("x"))
    if system == "wayland":
        with sway(width, height, rate_hz) as name:
            yield {"WAYLAND_DISPLAY": name, "SDL_VIDEODRIVER": "wayland", "DISPLAY": ""}
    else:
        with (
            tempfile.TemporaryDirectory() as folder,
            x_server(["Xvfb", "-screen", "0", f"{width}x{height}x24"], Path(folder)) as name,
        ):
            yield {"DISPLAY": name, "WAYLAND_DISPLAY": "", "SDL_VIDEODRIVER": "x11"}


def run(build: Path, scene: Path, seconds: float, env: dict[str, str], how: list[str], hooked: bool) -> dict[str, float]:
    """One session; its figures."""
    with tempfile.TemporaryDirectory() as folder:
        trace, log = Path(folder) / "trace.jsonl", Path(folder) / "screen.jsonl"
        paths = [str(build)]
        if hooked:
            (Path(folder) / "sitecustomize.py").write_text(HOOK.format(here=str(HERE)))
            paths.insert(0, folder)
        env = os.environ | env | {"PYTHONPATH": ":".join(paths), "SCREEN_LOG": str(log) if hooked else ""}
        command = [sys.executable, "-m", "lfpipe", "up", str(scene), "--camera", "demo", "--display", "window"]
        command += ["--duration", f"{seconds:g}", "--trace", str(trace), "--session", "screen", *how]
        subprocess.run(command, env=env, cwd=folder, check=True, capture_output=True)
        lines = [json.loads(line) for line in trace.read_text().splitlines()]
        if hooked:
            handed: dict[int, int] = {}
            blanks: dict[int, int] = {}
            for count, t_handed_ns, t_blank_ns in map(json.loads, log.read_text().splitlines()):
                if t_handed_ns:
                    handed[count] = t_handed_ns
                elif t_blank_ns:
                    blanks[count] = t_blank_ns
            shown = {t_ns: blanks.get(count, 0) for count, t_ns in handed.items()}
            for line in lines:
                line["t_presented_ns"] = shown.get(line["t_presented_ns"], 0) if line["composed"] else 0
        return figures(lines[len(lines) // 4 :])  # the lead is learnt by then


def figures(lines: list[dict[str, object]]) -> dict[str, float]:
    """Of the first picture that shows each frame: its age at the blank. Judder: composed pictures that no blank showed, and
    blanks passed over between two composed pictures in a row."""
    for line in lines:
        if line.get("presented_by") in ("handover", "replaced"):
            line["t_presented_ns"] = 0
    composed = [line for line in lines if line["composed"]]
    first: dict[object, float] = {}
    for line in composed:
        if line["t_presented_ns"]:
            first.setdefault(line["source_seq"], (line["t_presented_ns"] - line["t_sensor_ns"]) / 1e6)  # type: ignore[operator]
    ages = np.array(list(first.values()))
    by_seq = {line["seq"]: line for line in lines}
    steps = [
        (line["t_presented_ns"] - by_seq[line["seq"] - 1]["t_presented_ns"]) / 1e6  # type: ignore[operator]
        for line in composed
        if line["seq"] - 1 in by_seq  # type: ignore[operator]
        and by_seq[line["seq"] - 1]["composed"]  # type: ignore[operator]
        and line["t_presented_ns"]
        and by_seq[line["seq"] - 1]["t_presented_ns"]  # type: ignore[operator]
    ]
    period_ms = float(np.median(steps))
    unseen = sum(not line["t_presented_ns"] for line in lines if line["composed"])
    odd = sum(abs(round(step / period_ms) - 1) for step in steps)
    p50, p95 = np.percentile(ages, [50, 95])
    judder = 100 * (unseen + odd) / max(len(steps), 1)
    return {
        "p50_ms": float(p50),
        "p95_ms": float(p95),
        "period_ms": period_ms,
        "judder_percent": judder,
        "n": len(ages),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--before", type=Path, required=True)
    parser.add_argument("--seconds", type=float, default=20)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--system", choices=("wayland", "x"), default="wayland")
    parser.add_argument("--rate", type=float, default=60)
    parser.add_argument("--size", default="1920x1080")
    parser.add_argument("--set", action="append", default=[])
    arguments = parser.parse_args()
    how = [word for value in arguments.set for word in ("--set", value)]
    found: dict[str, list[dict[str, float]]] = {"before": [], "now": []}
    with screen(arguments.system, arguments.rate, arguments.size) as env:
        for number in range(arguments.rounds):
            turns = [("before", arguments.before, True), ("now", HERE, False)]
            for name, build, hooked in turns if number % 2 == 0 else turns[::-1]:
                found[name].append(run(build, arguments.scene.resolve(), arguments.seconds, env, how, hooked))
                print(name, {key: round(value, 2) for key, value in found[name][-1].items()}, flush=True)
    for name, rounds in found.items():
        print(name, {key: round(median(each[key] for each in rounds), 2) for key in rounds[0]})


if __name__ == "__main__":
    main()
