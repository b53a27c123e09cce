"""More habits of naming and keeping views, with random draws of their own: a set that no rule was made for.

Names as phones, gantries, renderers and data sets write them; folders per camera, eye or frame; pairs and maps beside views.
"""

from collections.abc import Callable, Iterator
from functools import partial
from itertools import product
from pathlib import Path

import cv2
import numpy as np

from profiling.people_litter import beside, for_each, grey_map, small
from profiling.people_scenes import DISTURBED, TURNS, Case, Grid, Make, disturbed, part, real, turned, written
from tests.scene import made

NAMES: dict[str, Callable[..., str]] = {
    "Samsung burst": lambda r, c, n: f"20260704_153000_{n + 1:03d}.jpg",
    "Pixel burst": lambda r, c, n: f"{n:05d}IMG_{n:05d}_BURST20260704153000{100 + 33 * n:03d}" + "_COVER" * (n == 4) + ".jpg",
    "Huawei burst": lambda r, c, n: f"IMG_20260704_153000_BURST{n + 1:03d}" + "_COVER" * (n == 0) + ".jpg",
    "action camera": lambda r, c, n: f"G00{10123 + n}.JPG",
    "edited on a phone": lambda r, c, n: f"IMG_{'E' * (n == 3)}{1234 + n}.JPG",
    "screenshots": lambda r, c, n: f"Screenshot 2026-07-04 at 15.{30 + n // 12:02d}.{5 * (n % 12):02d}.png",
    "frames of ffmpeg": lambda r, c, n: f"out-{n + 1:06d}.png",
    "three.js": lambda r, c, n: f"capture_x{0.25 * c - 0.5:.2f}_y{0.5 - 0.25 * r:.2f}.png",
    "three.js, integers": lambda r, c, n: f"cam({c - 2},{2 - r}).png",
    "data set": lambda r, c, n: f"input_Cam{n:03d}.png",
    "gantry, no coordinates": lambda r, c, n: f"rectified_{r:02d}_{c:02d}.png",
    "decoded Lytro": lambda r, c, n: f"IMG_0042__Decoded_{r + 4:02d}_{c + 4:02d}.png",
    "viewpoints": lambda r, c, n: f"{r}_{c}.tiff",
    "frame in front": lambda r, c, n: f"frame_0001_cam_{r:02d}_{c:02d}.png",
    "Blender frame": lambda r, c, n: f"LF_{n:03d}_0001.png",
    "scene1.row": lambda r, c, n: f"scene1.row{r + 1}.col{c + 1}.ppm",
    "no separator, x": lambda r, c, n: f"{r}x{c}.jpg",
    "minus sign between": lambda r, c, n: f"{r + 1}-{c + 1}.jpg",
    "letter rows": lambda r, c, n: f"{chr(65 + r)}{c + 1}.jpg",
    "letter rows, apart": lambda r, c, n: f"pos_{chr(65 + r)}_{c + 1:02d}.jpg",
    "words": lambda r, c, n: f"Zeile {r + 1}, Spalte {c + 1}.jpg",
    "umlauts": lambda r, c, n: f"Küche Süd – {n + 1:02d}.JPG",
    "Japanese": lambda r, c, n: f"視点{r:02d}-{c:02d}.png",
    "Cyrillic": lambda r, c, n: f"Снимок {n + 1}.jpg",
    "emoji": lambda r, c, n: f"🌻 {r + 1} {c + 1}.png",
    "assignments": lambda r, c, n: f"s={r},t={c}.png",
    "percent": lambda r, c, n: f"pos {100 * c // 8}% {100 * r // 8}%.png",
    "steps of ten": lambda r, c, n: f"cam_{10 * r:03d}_{10 * c:03d}.png",
    "coordinates only": lambda r, c, n: f"view_{-12.5 + 5 * r:.2f}_{3.25 + 5 * c:.2f}.png",
    "coordinates, upwards": lambda r, c, n: f"eye_x{30 * c - 60:+d}mm_y{60 - 30 * r:+d}mm.png",
    "version behind": lambda r, c, n: f"scene_v2_{r}_{c}_final.png",
    "resolution between": lambda r, c, n: f"{r:02d}_1024x768_{c:02d}.png",
    "ground truth": lambda r, c, n: f"{n:03d}_rgb_gt.png",
    "a folder per view": lambda r, c, n: f"cam_{r:02d}_{c:02d}/0001.png",
    "a folder per camera": lambda r, c, n: f"cam{n:02d}/frame.jpg",
    "a folder per row, its name before": lambda r, c, n: f"r{r}/r{r}_c{c}.jpg",
    "rows below a folder": lambda r, c, n: f"images/row{r}/{c:02d}.jpg",
}
_GRIDS = [name for name, make in NAMES.items() if make(1, 2, 7) != make(2, 1, 7)]


def drawn_habits(seed: int) -> Iterator[Case]:
    """Each name with real scenes, shapes, disturbances and turns drawn by seed."""
    rng = np.random.default_rng(seed)
    for kind, name in NAMES.items():
        for _ in range(3):
            scene = str(rng.choice(sorted(path.name for path in made.SAMPLES.glob("*"))))
            grid, number = real(scene), int(rng.integers(1 << 30))
            shape, how = str(rng.choice(["all", "3x5", "4x4", "1xN"])) if len(grid) > 3 else "all", str(rng.choice(DISTURBED))
            if "letter" in kind and shape == "all" and len(grid) > 9:
                shape = "4x4"
            true = disturbed(part(grid, shape, number), how, number)
            turn = TURNS[int(rng.integers(8))] if kind in _GRIDS else TURNS[0]
            files = turned(true, TURNS[0] if any(word in kind for word in ("row", "Zeile", "words")) else turn)
            about = f"{scene}, {true.shape[0]}x{true.shape[1]}, {how}; {kind}"
            yield Case("habits", about, partial(written, grid=files, name=name), true)


def _frames(grid: Grid, name: str) -> Make:
    """Three frames of every view, the later ones with a spot that moves."""

    def make(folder: Path) -> Path:
        for (r, c), f in product(np.ndindex(grid.shape[:2]), range(3)):
            view = grid[r, c].copy()
            if f:
                cv2.circle(view, (60 + 20 * f, 40), 12, (255, 255, 0), -1)
            made.write(folder / name.format(r=r, c=c, f=f + 1, n=r * grid.shape[1] + c), view)
        return folder

    return make


def _film(line: Grid) -> Make:
    def make(folder: Path) -> Path:
        height, width = line.shape[2:4]
        film = cv2.VideoWriter(str(folder / "slide.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 30, (width // 2 * 2, height // 2 * 2))
        for view in line[0]:
            film.write(cv2.cvtColor(view[: height // 2 * 2, : width // 2 * 2], cv2.COLOR_RGB2BGR))
        film.release()
        return folder / "slide.avi"

    return make


def kept(seed: int) -> Iterator[Case]:
    """Real views with what else people keep beside them, and in other forms."""
    rng = np.random.default_rng(seed)
    grid = real("hci_antinous")[2:7, 1:8]
    line = grid[2:3]
    middle = grid[2:3, 2:4]
    yield Case("kept", "frames behind", _frames(grid, "cam_{r}_{c}_{f:04d}.png"), grid)
    yield Case("kept", "frames in front", _frames(grid, "{f:04d}_{r}_{c}.png"), grid)
    yield Case("kept", "frames, named", _frames(grid, "f{f}_r{r}_c{c}.png"), grid)
    yield Case("kept", "frames of a line", _frames(line, "cam{c}_{f:04d}.png"), line)
    yield Case("kept", "frames as folders", _frames(grid, "frame_{f:04d}/{r:02d}_{c:02d}.png"), grid)
    yield Case("kept", "frames below cameras", _frames(grid, "cam_{r}_{c}/{f:04d}.png"), grid)
    masks = lambda view: (view[..., 1] > 128).astype(np.uint8) * 255  # noqa: E731
    extras: dict[str, Callable[[Path], None]] = {
        "thumbnails beside, uppercase": for_each(grid, "VIEW_{r:02d}_{c:02d}_THUMB.JPG", small),
        "maps of another kind": for_each(grid, "view_{r:02d}_{c:02d}.tif", grey_map),
        "masks below": for_each(grid, "masks/view_{r:02d}_{c:02d}.png", masks),
        "disparity as PFM": for_each(grid, "view_{r:02d}_{c:02d}.pfm", None),
        "alpha beside": for_each(grid, "alpha_{r:02d}_{c:02d}.png", masks),
        "results below": for_each(grid, "output/view_{r:02d}_{c:02d}.jpg", lambda v: 255 - v),
        "smaller copies below": for_each(grid, "half/view_{r:02d}_{c:02d}.jpg", small),
        "a mean picture": lambda f: made.write(f / "mean.jpg", grid.mean(axis=(0, 1)).astype(np.uint8)),
        "one truth": lambda f: made.write(f / "gt_disp.png", grey_map(grid[2, 3])),
        "backup": for_each(grid, "view_{r:02d}_{c:02d}.jpg.bak", None),
        "a script": lambda f: (f / "rename.py").write_text("print()") and None,
        "a video of it": lambda f: _film(line)(f) and None,
    }
    for kind, extra in extras.items():
        yield Case("kept", kind, beside(grid, extra), grid)
    for extra in ("depth", "mask", "out", "preview"):
        yield Case("kept", f"views and {extra}, each below", lambda f, extra=extra: [
            for_each(grid, "rgb/{r}_{c}.png", lambda v: v)(f), for_each(grid, extra + "/{r}_{c}.png", grey_map)(f),
            f][2], grid)  # fmt: skip
    for left, right in (("IMG_1_L.JPG", "IMG_1_R.JPG"), ("left/1.png", "right/1.png"), ("links.png", "rechts.png"),
                        ("cam_left_01.png", "cam_right_01.png"), ("im0.png", "im1.png"), ("l.jpg", "r.jpg"),
                        ("a1.jpg", "a2.jpg"), ("Bild links (1).jpg", "Bild rechts (1).jpg")):  # fmt: skip
        yield Case("pairs", f"{left} {right}", lambda f, a=left, b=right: [
            made.write(f / a, middle[0, 0]), made.write(f / b, middle[0, 1]), f][2], middle)  # fmt: skip
    yield Case("pairs", "with maps and calibration", lambda f: [
        made.write(f / "im0.png", middle[0, 0]), made.write(f / "im1.png", middle[0, 1]), (f / "calib.txt").write_text("x"),
        made.write(f / "disp0.png", grey_map(middle[0, 0])), f][4], middle)  # fmt: skip
    for name, low in (("im{n}.ppm", 0), ("view{n}.png", 0), ("image_{n}.png", 1)):
        yield Case("pairs", f"seven of them, {name}", lambda f, name=name, low=low: [
            [made.write(f / name.format(n=c + low), view) for c, view in enumerate(line[0])], f][1], line)  # fmt: skip
    yield Case("pairs", "nine with two maps", lambda f: [
        [made.write(f / f"im{c}.ppm", view) for c, view in enumerate(line[0])],
        [made.write(f / f"disp{c}.pgm", grey_map(line[0, c])) for c in (2, 6)], f][2], line)  # fmt: skip
    for gap in (2, 8):
        yield Case("containers", f"tiles with lines of {gap} px between", partial(_contact, grid=grid, gap=gap), grid)
    yield Case("containers", "tiles", lambda f: [made.write(f / "lf.png", made.mosaic(grid)), f / "lf.png"][1], grid)
    yield Case("containers", "tiles, a strip", lambda f: [made.write(f / "lf.png", made.mosaic(line)), f / "lf.png"][1], line)
    yield Case("containers", "tiles, a column", lambda f: [
        made.write(f / "lf.png", made.mosaic(line.swapaxes(0, 1))), f / "lf.png"][1], line)  # fmt: skip
    yield Case("containers", "film of a slider", _film(line), None)
    mixed = rng.permutation(grid.shape[0] * grid.shape[1])
    yield Case("order", "random", lambda f: [
        [made.write(f / f"{n}.png", grid[divmod(int(k), grid.shape[1])]) for n, k in enumerate(mixed)], f][1], None)  # fmt: skip
    for kind, name in (("two exposures", "{r}_{c}_ev{e}.png"), ("two exposures in front", "ev{e}_{r}_{c}.png")):
        yield Case("order", kind, lambda f, name=name: [
            [made.write(f / name.format(r=r, c=c, e=e), np.minimum(grid[r, c], 255 // (1 + e)) * (1 + e))
             for r, c in np.ndindex(grid.shape[:2]) for e in (0, 1)], f][1], grid)  # fmt: skip
    other = real("lytro_2067")[:5, :7]
    yield Case("order", "two scenes in one folder", lambda f: [
        for_each(grid, "garden_{r}_{c}.png", lambda v: v)(f), for_each(other, "hall_{r}_{c}.png", lambda v: v)(f),
        f][2], grid)  # fmt: skip


def _contact(folder: Path, grid: Grid, gap: int) -> Path:
    rows, cols, height, width = grid.shape[:4]
    sheet = np.full((rows * (height + gap) + gap, cols * (width + gap) + gap, 3), 255, np.uint8)
    for r, c in np.ndindex(rows, cols):
        top, left = gap + r * (height + gap), gap + c * (width + gap)
        sheet[top : top + height, left : left + width] = grid[r, c]
    made.write(folder / "sheet.png", sheet)
    return folder / "sheet.png"
