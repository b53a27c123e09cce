"""What scenes of many kinds open as: in order, undecided, or refused; and the memory that it takes.

    uv run python -m profiling.scene_layouts --out profiling/results/layouts.md

Each kind is written to a folder of its own and opened by a child process. "right": every view is where it belongs, and so are
near and far. "undecided": the program says that it cannot tell. "refused": with the message. "WRONG": none of these.
"""

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path

import cv2
import numpy as np

from lfpipe.scene.source import Turn
from profiling.arguments import parser_of
from tests.scene import made, test_orientation, test_plausibility, test_rgbd, test_slide, test_stereo

Make = Callable[[Path], Path]
CHILD = """
import json, sys
import numpy as np
from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene import layouts
from lfpipe.scene.orientation import orient
from lfpipe.scene.plausibility import plausible
path, wanted, out = sys.argv[1], sys.argv[2], {}
try:
    source = layouts.describe(path, config.Scene())
    source = source if source.certain else plausible(source, False)
    found = orient(source, config.Scene())
    rows, cols = found.turn.grid(source.rows, source.cols)
    out = {"layout": source.layout, "grid": f"{rows}x{cols}", "sure": found.sure, "undecided": found.undecided}
    out["turn"] = [found.turn.rows, found.turn.cols, found.turn.transpose]
    if wanted != "-":
        true = np.load(wanted)
        out["right"] = (rows, cols) == true.shape[:2] and all(
            (at := found.turn.file_index(r, c, rows, cols)) in source.missing
            or float(np.abs(source.read(0, *at).astype(int) - true[r, c]).mean()) < 6 for r in range(rows) for c in range(cols))
except UserError as error:
    out = {"refused": error.message, "remedy": error.remedy}
out["mb"] = int(open("/proc/self/status").read().split("VmHWM:")[1].split()[0]) / 1024  # ru_maxrss would be the parent's
print(json.dumps(out))
"""
TURNS = [Turn(*flags) for flags in product((False, True), repeat=3)]
NAMES = {
    "view_00_00": "view_{r:02d}_{c:02d}.png", "counter before": "IMG_{n:04d}_001_{r:02d}_{c:02d}.png",
    "coordinates behind": "Camera_{r:02d}_{c:02d}_{y:.1f}_{x:.1f}_30_36.png", "signs": "image_{sr:+d}_{sc:+d}.png",
    "words around": "im_t{r:03d}_s{c:03d}_GT.png", "column first": "x{c}_y{r}.png", "no separator": "v{r}{c}.png",
    "letters": "{letter}{c}.png", "decimals": "cam {fr:.1f} {fc:.1f}.png", "dots": "a.{r:02d}.{c:02d}.png",
    "1-based, wide": "scene-r{r1:04d}-c{c1:04d}.png", "running": "lowtoys{n:03d}.png", "running, from 7": "IMG {n7} x.png",
}  # fmt: skip


def turned(grid: np.ndarray, turn: Turn) -> np.ndarray:
    grid = grid[::-1] if turn.rows else grid
    grid = grid[:, ::-1] if turn.cols else grid
    return grid.swapaxes(0, 1) if turn.transpose else grid


def written(folder: Path, grid: np.ndarray, name: str, leave_out: Callable[[int, int], bool] = lambda r, c: False) -> Path:
    for r, c in product(range(grid.shape[0]), range(grid.shape[1])):
        n = r * grid.shape[1] + c
        words = {
            "r": r,
            "c": c,
            "n": n,
            "n7": n + 7,
            "r1": r + 1,
            "c1": c + 1,
            "sr": r - 2,
            "sc": c - 2,
            "letter": chr(ord("a") + r),
        }
        words |= {"y": 400.0 + 2.5 * r, "x": 369.2 - 1.5 * c, "fr": r / 10, "fc": c / 10 - 0.2}
        if not leave_out(r, c):
            made.write(folder / name.format(**words), grid[r, c])
    return folder


def one(name: str, picture: np.ndarray) -> Make:
    def make(folder: Path) -> Path:
        made.write(folder / name, picture)
        return folder / name

    return make


def cases() -> Iterator[tuple[str, str, Make, np.ndarray | None]]:
    """(group, kind, how to write it, the true views in canonical order or None)."""
    scene = made.views(5, 6, 96, 128)
    for number, (kind, name) in enumerate(NAMES.items()):
        grid = turned(scene, TURNS[(3 * number + 1) % 8])
        yield "names", kind, (lambda folder, grid=grid, name=name: written(folder, grid, name)), scene
    large = made.views(16, 16, 48, 64)
    yield "names", "running, 256 files", (lambda folder: written(folder, large, "t{n:03d}.png")), large
    yield "gaps", "one view missing", (lambda f: written(f, scene, "v_{r}_{c}.png", lambda r, c: (r, c) == (2, 2))), scene
    square = made.views(9, 9, 96, 128)
    yield "gaps", "cross", (lambda f: written(f, square, "v_{r}_{c}.png", lambda r, c: r != 4 and c != 4)), square[4:5]
    extra = "one file too many"
    yield "gaps", extra, (lambda f: [written(f, scene, "v{n:02d}.png"), made.write(f / "v30.png", scene[2, 2])][0]), scene
    yield (
        "gaps",
        "an odd picture",
        (lambda f: [written(f, scene, "v{n:02d}.png"), made.write(f / "all.jpg", scene[0, 0, :50])][0]),
        scene,
    )
    for kind, grid in test_plausibility.NO_LIGHT_FIELDS.items():
        yield (
            "no light field",
            kind,
            (lambda f, grid=grid: made.write_grid(f, grid, "v_{r:02d}_{c:02d}.png" if len(grid) > 1 else "v{c:02d}.png")),
            None,
        )
    pair = np.stack([test_stereo.LEFT, test_stereo.RIGHT])[None]
    for kind, make in test_stereo.FORMS.items():
        yield "stereo", kind, make, pair
    yield "stereo", "side by side, unnamed", one("x.png", test_stereo.BESIDE), pair
    anaglyph = np.dstack([test_stereo.LEFT[..., 0], test_stereo.RIGHT[..., 0], test_stereo.RIGHT[..., 0]])
    yield "refused by kind", "anaglyph", one("x.png", anaglyph), None
    for name in ("a.lfp", "a.heic", "a.gif", "a.zip"):
        yield "refused by kind", name, (lambda f, name=name: [(f / name).write_bytes(b"x"), f / name][1]), None
    for kind, make in test_rgbd.FORMS.items():
        yield "picture and depth", kind, make, None
    for cols, rows in ((4, 8), (5, 9), (6, 10), (8, 6)):
        line = made.views(1, cols * rows, 150, 200, 0.5, -0.3)
        quilt = made.mosaic(line[0].reshape(rows, cols, 150, 200, 3)[::-1])
        yield "quilts without a name", f"{cols}x{rows}", one("45_01.png", quilt), line
    for path in sorted(made.SAMPLES.glob("*")):
        yield "sample scenes", path.name, (lambda folder, path=path: path), None


def tried(make: Make, true: np.ndarray | None) -> dict[str, object]:
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "scene").mkdir()
        path, wanted = make(Path(folder) / "scene"), "-"
        if true is not None:
            wanted = f"{folder}/true.npy"
            np.save(wanted, true)
        start = time.monotonic()
        done = subprocess.run([sys.executable, "-c", CHILD, str(path), wanted], capture_output=True, text=True, check=False)
        out: dict[str, object] = (
            json.loads(done.stdout) if done.returncode == 0 else {"refused": done.stderr[-200:], "crashed": True}
        )
    return out | {"seconds": time.monotonic() - start}


def verdict(found: dict[str, object], group: str, kind: str, true: np.ndarray | None) -> str:
    if "refused" in found:
        return (
            "WRONG" if found.get("crashed") or true is not None or group in ("sample scenes", "picture and depth") else "refused"
        )
    if group in ("no light field", "refused by kind"):
        return "WRONG"
    if found["undecided"]:
        return "undecided"
    if kind in test_orientation.SCENES:
        layout, _, _, turn = test_orientation.SCENES[kind]
        return "right" if (found["layout"], found["turn"]) == (layout, [turn.rows, turn.cols, turn.transpose]) else "WRONG"
    return "right" if true is None or found["right"] else "WRONG"


def slides() -> Iterator[str]:
    from lfpipe.errors import UserError

    clips = {"shaken": (test_slide.shaken(test_slide.SLID, 0.6), ""), **test_slide.CLIPS}
    for kind, (views, _) in clips.items():
        with tempfile.TemporaryDirectory() as folder:
            try:
                done = test_slide.slide(Path(folder), list(views))
                what = f"{done.residual_px:.2f} px up and down (95 %), {done.spread_px:.0f} px parallax"
                yield f"| {kind} | {done.views} views | {what} |"
            except UserError as error:
                yield f"| {kind} | refused | {error.message.split(': ', 1)[1]} |"


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--out", type=Path, default=Path("profiling/results/layouts.md"))
    out = parser.parse_args().out
    cv2.setNumThreads(1)
    counts: dict[str, int] = {}
    rows, most_mb = [], 0.0
    for group, kind, make, true in cases():
        found = tried(make, true)
        word = verdict(found, group, kind, true)
        counts[word] = counts.get(word, 0) + 1
        what = str(found.get("refused") or f"{found['layout']} {found['grid']}, {found['sure']:.0%} sure")
        if word == "refused":
            most_mb = max(most_mb, float(str(found.get("mb", 0))))
            what = what.split(": ", 1)[-1][:150]
        rows.append(f"| {group} | {kind} | {word} | {what} | {float(str(found.get('mb', 0))):.0f} |")
        print(rows[-1], flush=True)
    total = ", ".join(f"{word}: {count}" for word, count in sorted(counts.items()))
    head = [
        "# Scenes of many kinds",
        "",
        "`uv run python -m profiling.scene_layouts`: each kind opened by a process of its own.",
        "",
    ]
    head += [f"{total}. Most memory of a refusal: {most_mb:.0f} MB.", ""]
    head += ["| group | kind | result | what it opened as, or why not | MB |", "|---|---|---|---|---|"]
    tail = ["", "## Clips of a camera slid by hand (`scene make`)", "", "| clip | result | |", "|---|---|---|", *slides()]
    out.write_text("\n".join([*head, *rows, *tail]) + "\n")


if __name__ == "__main__":
    main()
