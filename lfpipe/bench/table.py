"""The protocol of papers on angular super-resolution: keep the corners of 7x7 views, synthesise the 45 others and compare.

PSNR and SSIM of luma are averaged over the synthesised views of a scene. The 7x7 views are the central ones of 9x9 (DistgASR) or
the top left ones (LFASR-geo, ELFR). Smaller grids use the largest square that fits; the table notes it.
"""

import json
import time
import tracemalloc
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import attrs
import numpy as np

from lfpipe.bench.holdout import ViewRenderer, subsample
from lfpipe.bench.metrics import psnr_db, shaved, ssim, studio_luma
from lfpipe.config.quality import METHODS, WARPS
from lfpipe.errors import UserError
from lfpipe.host.paths import exists
from lfpipe.scene.lightfield import LightField

SIDE = 7  # views per side in the printed protocol
PASSES = 3  # timed passes over all synthesised views
FILE = "table.jsonl"
Say = Callable[[str, int, int], None]


@attrs.frozen
class Protocol:
    """keep: kept views per side. crop: "central" or "top-left". border_px: shaved off each side before comparing."""

    keep: int = 2
    crop: str = "central"
    border_px: int = 22


@attrs.frozen
class Line:
    """One method on one scene. prepare_s: disparity from the kept views. mb: kept views, their disparity and the buffers."""

    scene: str
    method: str
    grid: str
    psnr_db: float = float("nan")
    ssim: float = float("nan")
    worst_db: float = float("nan")
    ms: float = float("nan")
    mb: float = float("nan")
    prepare_s: float = 0.0
    left_out: str = ""


def axis(count: int, keep: int, crop: str) -> tuple[int, int]:
    """(first view, step between kept views) along an axis of `count` views; step 0 for a single view.

    Raises ValueError if no view lies between the kept ones.
    """
    if count == 1:
        return 0, 0
    side = min(SIDE, count)
    step = (side - 1) // (keep - 1)
    if step < 2:
        raise ValueError(f"{count} views in a line: none lies between {keep} kept ones")
    span = step * (keep - 1)
    return ((count - 1 - span) // 2 if crop == "central" else 0), step


def grid_of(field: LightField, protocol: Protocol) -> tuple[tuple[int, int], tuple[int, int], int]:
    """((first row, kept rows), (first column, kept columns), step). Raises ValueError as `axis`."""
    found = [axis(count, protocol.keep, protocol.crop) for count in (field.rows, field.cols)]
    steps = [step for _, step in found if step]
    if not steps:
        raise ValueError("one view: nothing lies between")
    step = min(steps)  # the same on both axes, as disparity is per step of the grid
    return (found[0][0], protocol.keep if found[0][1] else 1), (found[1][0], protocol.keep if found[1][1] else 1), step


def measure_scene(
    field: LightField, scene: str, protocol: Protocol, done: Sequence[str], say: Say, timed: bool = True
) -> Iterator[Line]:
    """One line for each method not in done; failed ones have a reason. timed: also ms a picture."""
    try:
        (row, rows), (col, cols), step = grid_of(field, protocol)
        made = [
            (r, c)
            for r in range((rows - 1) * step + 1)
            for c in range((cols - 1) * step + 1)
            if (r % step or c % step) and field.present[row + r, col + c]
        ]
        kept_rows, kept_cols = ([start + k * step for k in range(n)] for start, n in ((row, rows), (col, cols)))
        if not field.present[np.ix_(kept_rows, kept_cols)].all():
            raise ValueError("one of the kept views is missing")
        views = np.asarray(field.views[0])
        truth = {p: shaved(studio_luma(views[row + p[0], col + p[1]]), protocol.border_px) for p in made}
        started = time.perf_counter()
        part = subsample(field, kept_rows, kept_cols)
        prepare_s = time.perf_counter() - started
    except ValueError as error:
        yield Line(scene, "all", f"{field.rows}x{field.cols}", left_out=str(error))
        return
    grid = f"{rows}x{cols} -> {(rows - 1) * step + 1}x{(cols - 1) * step + 1}"
    for method in reversed(METHODS):
        warps = method in WARPS
        if method in done or (warps and part.disparity is None):
            continue
        tracemalloc.start()
        renderer = ViewRenderer(part, method)
        figures = []
        for k, place in enumerate(made):
            luma = shaved(studio_luma(renderer.at((place[0] / step, place[1] / step))), protocol.border_px)
            figures.append((psnr_db(truth[place], luma), ssim(truth[place], luma)))
            say(f"{scene}, {method}", k + 1, len(made))
        buffers = tracemalloc.get_traced_memory()[0]
        tracemalloc.stop()
        stored = part.views.nbytes + (part.disparity.nbytes if warps and part.disparity is not None else 0)
        db, structure = (np.array(values) for values in zip(*figures, strict=True))
        ms = _median_ms(renderer, made, step) if timed else float("nan")
        yield Line(
            scene, method, grid, float(db.mean()), float(structure.mean()), float(db.min()), ms,
            (stored + buffers) / 1e6, prepare_s if warps else 0.0,
        )  # fmt: skip


def _median_ms(renderer: ViewRenderer, made: Sequence[tuple[int, int]], step: int) -> float:
    """Median time to draw one view in colour, over PASSES passes over the synthesised views."""
    times = []
    for _ in range(PASSES):
        for row, col in made:
            start = time.perf_counter_ns()
            renderer.draw((row / step, col / step))
            times.append((time.perf_counter_ns() - start) / 1e6)
    return float(np.median(times))


def measure(
    scenes: Sequence[tuple[Path, Callable[[], LightField]]],
    protocol: Protocol,
    identity: str,
    out: Path,
    say: Say,
    timed: bool = True,
) -> list[Line]:
    """Measures what is missing in out/FILE, appends a line for each result, and returns all lines of these scenes.

    scenes: (path, function that opens it). identity: hash of the code and its versions; other lines of the file are kept but not
    used. A scene that cannot be opened is a line with the reason. Raises UserError if out cannot be written.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        file = out / FILE
        old = [line for line in file.read_text().splitlines() if line.endswith("}")] if exists(file) else []
        known = {key: Line(**line) for key, line in map(_parsed, old)}
        lines: list[Line] = []
        with file.open("a") as target:
            if file.stat().st_size and not file.read_text().endswith("\n"):
                target.write("\n")  # the last run was killed while writing a line
            for path, open_field in scenes:
                try:
                    field = open_field()
                except UserError as error:
                    lines.append(Line(path.name, "all", "", left_out=str(error)))
                    continue
                about = json.dumps([identity, field.manifest.get("key", ""), attrs.astuple(protocol), timed])
                had = {method: known[about + method] for method in reversed(METHODS) if about + method in known}
                for line in measure_scene(field, field.name, protocol, list(had), say, timed):
                    if not line.left_out:
                        target.write(json.dumps({"key": about + line.method, **attrs.asdict(line)}) + "\n")
                        target.flush()
                    had[line.method] = line
                lines += had.values()
        return lines
    except OSError as error:
        raise UserError(f"{out}: cannot be written: {error.strerror}", "choose another folder with --out DIR") from None


def _parsed(text: str) -> tuple[str, dict[str, Any]]:
    """A line of FILE as (key, fields); an unreadable one gets the key "" and is measured again."""
    try:
        values = json.loads(text)
        key = str(values.pop("key"))
        Line(**values)
    except (ValueError, TypeError, KeyError, AttributeError):
        return "", {"scene": "", "method": "", "grid": ""}
    return key, values
