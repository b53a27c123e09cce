"""The protocol of papers on angular super-resolution: keep the corners of 7x7 views, synthesise the 45 others and compare.

PSNR and SSIM of luma are averaged over the synthesised views of a scene. The 7x7 views are the central ones of 9x9 (DistgASR) or
the top left ones (LFASR-geo, ELFR). Smaller grids use the largest square that fits; the table notes it.
"""

import html
import json
import math
import time
import tracemalloc
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.holdout import ViewRenderer, subsample
from lfpipe.bench.page import markdown_table
from lfpipe.bench.page import table as html_table
from lfpipe.bench.style import STYLE
from lfpipe.config.quality import METHODS, WARPS
from lfpipe.errors import UserError, plain
from lfpipe.files.output import check_output
from lfpipe.host.files import exists
from lfpipe.scene.lightfield import LightField

SIDE = 7  # views per side in the printed protocol
PASSES = 3  # timed passes over all synthesised views
FILE = "table.jsonl"
PEAK, BEST_DB = 255.0, 100.0  # of PSNR; BEST_DB for identical pictures
LUMA, BLACK = np.array([65.481, 128.553, 24.966]) / 255, 16.0  # ITU-R BT.601, 16 to 235, as MATLAB's rgb2ycbcr
SIGMA_PX, WINDOW_PX, K1, K2 = 1.5, 11, 0.01, 0.03  # Wang, Bovik, Sheikh, Simoncelli, IEEE TIP 2004
Say = Callable[[str, int, int], None]
Float = NDArray[np.float64]

# Printed means (PSNR in dB, SSIM) of methods that were not run here. Tables disagree about the same method, by up to 5 dB.
SETS = ("HCI new", "HCI old", "30scenes")
TEST_SCENES = {  # by lower-case name; 30scenes are numbered photographs and not known by name
    "HCI new": ("bedroom", "bicycle", "dishes", "herbs"),
    "HCI old": ("buddha", "buddha2", "monasroom", "papillon", "stilllife"),
}
_DISTG, _ELFR = "table of DistgASR, Wang et al. 2022", "table of ELFR, 2023"
PRINTED = (
    ("Kalantari 2016", "32.85 / 0.909", "38.58 / 0.944", "41.40 / 0.982", _DISTG),
    ("Yeung 2018", "32.30 / 0.900", "39.69 / 0.941", "42.77 / 0.986", _DISTG),
    ("LFASR-geo", "34.60 / 0.937", "40.84 / 0.960", "42.53 / 0.985", _DISTG),
    ("FS-GAF", "37.14 / 0.966", "41.80 / 0.974", "42.75 / 0.986", _DISTG),
    ("DistgASR", "34.70 / 0.974", "42.18 / 0.978", "43.67 / 0.995", _DISTG),
    ("ELFR", "38.81 / 0.973", "42.85 / 0.982", "42.90 / 0.987", _ELFR),
)
ABOUT_PRINTED = "Printed by others for the test scenes of each set, PSNR / SSIM, not run here"
HEAD = ("scene", "views", "method", "PSNR, dB", "worst view, dB", "SSIM", "ms a picture", "MB", "disparity, s")


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


def studio_luma(planes: NDArray[np.generic]) -> Float:
    """Luma, float64 (h, w), 16 to 235, of planar RGB (3, h, w) or grey (1, h, w) with values 0 to 255. Not rounded."""
    weights = LUMA if len(planes) == 3 else LUMA.sum(keepdims=True)
    return np.asarray(np.tensordot(weights, np.asarray(planes, np.float64), 1) + BLACK, np.float64)


def shaved(picture: Float, border_px: int) -> Float:
    """The picture without border_px on each side. Raises ValueError if the rest is too small for SSIM."""
    height, width = picture.shape
    if min(height, width) - 2 * border_px < WINDOW_PX:
        raise ValueError(f"a view of {width}x{height} px is too small for a border of {border_px} px")
    return picture[border_px : height - border_px, border_px : width - border_px]


def psnr_db(a: Float, b: Float) -> float:
    """Peak signal-to-noise ratio in dB, peak 255; BEST_DB if a equals b."""
    square = float(np.mean(np.square(a - b)))
    return BEST_DB if square == 0 else min(BEST_DB, 10 * math.log10(PEAK**2 / square))


def ssim(a: Float, b: Float) -> float:
    """Mean structural similarity: Gaussian window of 11x11 with sigma 1.5, population covariance, peak 255.

    The mean is over the windows that lie within the picture, as in the authors' code and in scikit-image.
    """

    def mean(values: Float) -> Float:
        return cv2.GaussianBlur(values, (WINDOW_PX, WINDOW_PX), SIGMA_PX, borderType=cv2.BORDER_REFLECT)  # type: ignore[return-value]

    mean_a, mean_b = mean(a), mean(b)
    var_a, var_b, both = mean(a * a) - mean_a**2, mean(b * b) - mean_b**2, mean(a * b) - mean_a * mean_b
    c1, c2 = (K1 * PEAK) ** 2, (K2 * PEAK) ** 2
    found = (2 * mean_a * mean_b + c1) * (2 * both + c2) / ((mean_a**2 + mean_b**2 + c1) * (var_a + var_b + c2))
    pad = WINDOW_PX // 2
    return float(found[pad:-pad, pad:-pad].mean())


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
        for name in (FILE, "table.md", "table.html"):
            check_output(out / name)
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


def cells(line: Line) -> tuple[str, ...]:
    """A row of the table."""
    if line.left_out:
        return (line.scene, line.grid, plain(f"left out: {line.left_out}", 300), *[""] * 6)
    cost = (f"{line.ms:.2f}" if math.isfinite(line.ms) else "", f"{line.mb:.1f}", f"{line.prepare_s:.1f}")
    return (line.scene, line.grid, line.method, f"{line.psnr_db:.2f}", f"{line.worst_db:.2f}", f"{line.ssim:.4f}", *cost)


def set_means(lines: Sequence[Line]) -> list[tuple[str, ...]]:
    """Means over a published set, for methods that were measured on all of its test scenes and with the printed grid."""
    rows: list[tuple[str, ...]] = []
    for name, scenes in TEST_SCENES.items():
        for method in dict.fromkeys(line.method for line in lines if not line.left_out):
            of = {line.scene.lower(): line for line in lines if line.method == method and line.scene.lower() in scenes}
            if set(of) == set(scenes) and all(line.grid == "2x2 -> 7x7" for line in of.values()):
                db, worst, structure, ms = np.array([(one.psnr_db, one.worst_db, one.ssim, one.ms) for one in of.values()]).T
                figures = (f"{db.mean():.2f}", f"{worst.min():.2f}", f"{structure.mean():.4f}", f"{ms.mean():.2f}")
                rows.append((f"mean of {name}", "2x2 -> 7x7", method, *figures, "", ""))
    return rows


def markdown(lines: Sequence[Line], protocol: Protocol) -> str:
    """The table, and the printed results in a separate table."""
    about = (
        f"{protocol.keep}x{protocol.keep} views kept of the {protocol.crop} 7x7, the others made. Luma of BT.601 in studio range,"
        f" peak 255, {protocol.border_px} px shaved off each side; SSIM with a Gaussian of sigma 1.5; mean over the made views."
        " Disparity is of the kept views alone (time: last column). ms a picture: one view in colour, one core."
    )
    text = f"{about}\n\n{markdown_table(HEAD, [*map(cells, lines), *set_means(lines)])}"
    return text + (f"\n{ABOUT_PRINTED}:\n\n{markdown_table(('method', *SETS, 'from'), PRINTED)}" if protocol.keep == 2 else "")


def write(lines: Sequence[Line], protocol: Protocol, out: Path) -> Path:
    """Writes table.md and table.html to out; returns the path of the page. Raises UserError."""
    body = html_table(HEAD, [*map(cells, lines), *set_means(lines)])
    if protocol.keep == 2:
        body += f"<h2>{ABOUT_PRINTED}</h2>" + html_table(("method", *SETS, "from"), PRINTED)
    text = markdown(lines, protocol)
    try:
        (out / "table.md").write_text(f"<!-- written by lfpipe -->\n{text}")
        page = out / "table.html"
        page.write_text(
            '<!doctype html><!-- written by lfpipe --><html lang="en">'
            '<head><meta charset="utf-8"><title>lfpipe bench table</title><style>'
            f"{STYLE}</style></head><body><h1>Views between: quality over time</h1><p>"
            f"{html.escape(text.partition(chr(10))[0])}</p>{body}</body></html>"
        )
        return page
    except OSError as error:
        raise UserError(f"{out}: cannot be written: {error.strerror}", "choose another folder with --out DIR") from None
