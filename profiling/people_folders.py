"""What folders open as that people name, order and keep in ways of their own; how often what is reported as sure is right.

    uv run python -m profiling.people_folders --out profiling/results/people_folders.md

"right": each view is where it belongs (of all orders of the true grid, the true one fits best). "WRONG": opened otherwise without
a word. "REFUSED": a light field that should have opened. The scenes: people_scenes, people_litter.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from profiling.arguments import parser_of
from profiling.people_habits import drawn_habits, kept
from profiling.people_litter import littered, no_light_fields
from profiling.people_scenes import Case, drawn, real, reordered
from tests.scene import made

CHILD = """
import json, sys, time
import numpy as np
from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene import layouts
from lfpipe.scene.orientation import orient
from lfpipe.scene.plausibility import plausible
path, wanted, out, start = sys.argv[1], sys.argv[2], {}, time.process_time()
try:
    source = layouts.describe(path, config.Scene())
    source = source if source.certain else plausible(source, False)
    found = orient(source, config.Scene())
    out["seconds"] = time.process_time() - start
    rows, cols = found.turn.grid(source.rows, source.cols)
    out |= {"layout": source.layout, "grid": f"{rows}x{cols}", "sure": found.sure, "undecided": found.undecided}
    if wanted != "-":
        true = np.load(wanted)[..., 1].astype(np.int16)[:, :, ::2, ::2]
        out["right"] = False
        if (rows, cols) == true.shape[:2]:
            at = [[found.turn.file_index(r, c, rows, cols) for c in range(cols)] for r in range(rows)]
            seen = lambda i: source.read(0, *i)[::2, ::2]
            here = np.array([[true[r, c] if at[r][c] in source.missing else (seen(at[r][c]) if source.read(0, *at[r][c]).ndim == 2
                              else seen(at[r][c])[..., 1]) for c in range(cols)] for r in range(rows)])
            others = [true, true[::-1], true[:, ::-1], true[::-1, ::-1]]
            if rows == cols: others += [o.swapaxes(0, 1) for o in others]
            off = [float(np.abs(o - here).mean()) for o in others] if here.shape == true.shape else [99.0]
            out["right"] = off[0] <= min(off) + 1e-9 and off[0] < 8
except UserError as error:
    out = {"refused": error.message, "remedy": error.remedy}
out["mb"] = int(open("/proc/self/status").read().split("VmHWM:")[1].split()[0]) / 1024  # ru_maxrss would be the parent's
print(json.dumps(out))
"""


def cases(seed: int) -> Iterator[Case]:
    """Seed 0: the first set, which rules were made for. Others: what no rule was made for, by names, habits and random draws."""
    if not seed:
        yield from littered(made.views(5, 5, 150, 200))
        yield from no_light_fields()
    else:
        yield from drawn_habits(seed)
        yield from kept(seed)
    number = 10_000 * seed
    for path in sorted(made.SAMPLES.glob("*")):
        for _ in range(4 if seed else 10):
            grid = real(path.name)
            sizes = ["1xN"] if len(grid) == 1 else ["all"] if len(grid) < 4 else ["all", "3x5", "5x3", "4x4", "1xN", "Nx1"]
            yield reordered("real", path.name, grid, number, sizes)
            number += 1
    for kind, grid in drawn():
        for _ in range(2 if seed else 4):
            yield reordered("drawn", kind, grid, 1000 + number, ["all"])
            number += 1


def tried(case: Case) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "scene").mkdir()
        path, wanted = case.make(Path(folder) / "scene"), "-"
        if case.true is not None:
            wanted = f"{folder}/true.npy"
            np.save(wanted, case.true)
        done = subprocess.run([sys.executable, "-c", CHILD, str(path), wanted], capture_output=True, text=True, check=False)
        if done.returncode:
            return {"crashed": done.stderr[-300:]}
        out: dict[str, Any] = json.loads(done.stdout)
        return json.loads(json.dumps(out).replace(folder, ""))


def verdict(found: dict[str, Any], case: Case) -> str:
    if "crashed" in found:
        return "WRONG"
    if "refused" in found:
        return "refused" if case.true is None else "REFUSED"
    if found["undecided"]:
        return "undecided"
    return "right" if case.true is not None and found["right"] else "WRONG"


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--out", type=Path, default=Path("profiling/results/people_folders.md"))
    parser.add_argument("--only", default="", help="groups or kinds that contain this word")
    parser.add_argument("--seed", type=int, default=0, help="of what is drawn; 0: those of the first run")
    chosen = parser.parse_args()
    cv2.setNumThreads(1)
    counts: dict[str, int] = {}
    rows: list[str] = []
    sure: list[bool] = []
    memory = seconds = 0.0
    with ThreadPoolExecutor(min(2, os.cpu_count() or 1)) as pool:
        every = [case for case in cases(chosen.seed) if chosen.only in f"{case.group}: {case.kind}"]
        for case, found in zip(every, pool.map(tried, every), strict=True):
            word = verdict(found, case)
            counts[word] = counts.get(word, 0) + 1
            if word in ("right", "WRONG") and found.get("sure", 1.0) >= 0.9:
                sure.append(word == "right")
            if "refused" in found:
                what = f"{found['refused']} | {found['remedy']}".replace("/scene", "").strip(": ")[:220]
                memory = max(memory, found["mb"])
            else:
                what = (
                    found.get("crashed")
                    or f"{found['layout']} {found['grid']}, {found['sure']:.0%} sure | {found['undecided'][:90]}"
                )
            seconds = max(seconds, found.get("seconds", 0.0))
            rows.append(f"| {case.group} | {case.kind} | {word} | {what} |".replace("\n", " "))
            print(rows[-1], flush=True)
    total = ", ".join(f"{word}: {count}" for word, count in sorted(counts.items()))
    most = f"Most memory of a refusal: {memory:.0f} MB; most processor time of an opened one: {seconds:.1f} s."
    first = "The first run, before anything was changed for it: right 93, undecided 61, refused 17 light fields, WRONG 9;"
    seed = f" --seed {chosen.seed}" if chosen.seed else ""
    head = ["# Folders as people keep them", "", f"`uv run python -m profiling.people_folders{seed}`", ""]
    head += [f"{total}. Of {len(sure)} reported as 90 % sure or more, {sum(sure)} are right. {most}", ""]
    if not chosen.seed:
        head += [f"{first} of 76 reported as 90 % sure or more, 70 were right.", ""]
    head += ["| group | kind | result | what it opened as, or why not | undecided, or the remedy |", "|---|---|---|---|---|"]
    chosen.out.write_text("\n".join([*head, *rows]) + "\n")
    print(head[4])


if __name__ == "__main__":
    main()
