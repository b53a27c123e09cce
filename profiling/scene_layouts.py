"""What sets of many kinds open as: right, undecided, with a note, or refused.

    python -m profiling.scene_layouts --out profiling/results/layouts.md --before EARLIER.md

Every set of ../shared/data/lightfields, light fields under many names and in many files, and what
is none. "right": the expected grid, with every view where it belongs. "undecided": the program says
that it cannot tell. "note": the program says that the views hardly fit together. "WRONG": sure, and
not right. Last, the sets of tests/scene/people_sets.py: "right" as the table there expects it;
"REFUSED" and "OPENED": against expectation. --before: an
earlier result, whose words stand in a column of their own.
"""

import re
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from itertools import product
from pathlib import Path

import attrs
import numpy as np
from PIL import Image

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene.analysis import analyse_scene
from lfpipe.scene.lightfield import HARDLY_FIT
from profiling.arguments import parser_of
from tests.scene import made, people_sets, test_pictures, test_plausibility, writers

Make = Callable[[Path], Path]
SAMPLES = {
    "atlas_jarabo_toys_9x9": (9, 9),
    "hci_antinous": (9, 9),
    "hci_old_monasroom_2x2": (2, 2),
    "hci_old_stillLife_3x3": (3, 3),
    "hci_style_vr_newshot01": (9, 9),
    "lfvideo_airplane_8x8": (8, 8),
    "lytro_2067": (9, 9),
    "lytro_illum_field": (9, 9),
    "quilt_4x8": (1, 32),
    "stanford_lego_knights_17x17": (17, 17),
}
NAMES = {
    "row and column": "view_{r:02d}_{c:02d}.png",
    "a counter before": "IMG_{n:04d}_001_{r:02d}_{c:02d}.png",
    "coordinates behind": "Camera_{r:02d}_{c:02d}_{y:.1f}_{x:.1f}_30_36.png",
    "signs": "image_{sr:+d}_{sc:+d}.png",
    "words around": "im_t{r:03d}_s{c:03d}_GT.png",
    "column first": "x{c}_y{r}.png",
    "no separator": "v{r}{c}.png",
    "1-based, wide": "scene-r{r1:04d}-c{c1:04d}.png",
    "running": "lowtoys{n:03d}.png",
    "folders": "row {r}/{c}.png",
    "times": "Screenshot 2026-07-04 at 15.{m:02d}.{s:02d}.png",
    "line breaks": "v\n{r}\n{c}.png",
    "half PNG, half JPEG": "v_{r}_{c}.{end}",
    "AVIF": "v_{r}_{c}.avif",
    "GIF": "v_{r}_{c}.gif",
    "one folder down": "a/{r}_{c}.png",
    "left cameras beside right ones": "left cam {r:02d}_{c:02d}.png",
}


@attrs.frozen(eq=False)
class Case:
    """make writes it below a folder and returns its path. grid: expected rows and columns, None for
    what is no light field.
    true: views in canonical order, where they are compared.
    """

    group: str
    kind: str
    make: Make
    grid: tuple[int, int] | None
    true: np.ndarray | None = None


def written(folder: Path, grid: np.ndarray, name: str) -> Path:
    for n, (r, c) in enumerate(product(*map(range, grid.shape[:2]))):
        words: dict[str, object] = {
            "r": r,
            "c": c,
            "n": n,
            "r1": r + 1,
            "c1": c + 1,
            "sr": r - 2,
            "sc": c - 2,
        }
        words |= {
            "y": 400 + 2.5 * r,
            "x": 369.2 - 1.5 * c,
            "m": 30 + n // 12,
            "s": 5 * (n % 12),
            "end": ("png", "jpg")[n % 2],
        }
        path = folder / name.format(**words)
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(grid[r, c]).save(path, quality=95)
        if name.startswith("left"):
            made.write(
                path.with_name(path.name.replace("left", "right")), np.roll(grid[r, c], 3, 1)
            )
    return folder


def depth(name: str, values: np.ndarray) -> Make:
    def make(folder: Path) -> Path:
        made.write(folder / "car.jpg", test_pictures.PICTURE)
        made.write(folder / name, values)
        return folder

    return make


def sample(name: str) -> Make:
    return lambda _: made.SAMPLES / name


def among_unknown(picture: np.ndarray) -> Make:
    def make(folder: Path) -> Path:
        for number in range(289):
            (folder / f"{number}.xyz").write_bytes(b"x")
        made.write(folder / "a.png", picture)
        return folder

    return make


def cases() -> Iterator[Case]:
    for name, grid in SAMPLES.items():
        if (made.SAMPLES / name).is_dir():
            yield Case("sample sets", name, sample(name), grid)
    scene = made.views(5, 6, 96, 128)
    for kind, name in NAMES.items():
        yield Case("names", kind, partial(written, grid=scene, name=name), (5, 6), scene)
    for rows, cols in ((1, 9), (1, 51), (1, 101), (3, 17), (16, 16), (17, 17)):
        views = made.views(rows, cols, 48, 64, 1.0, -0.5)
        yield Case(
            "a running number",
            f"{rows}x{cols}",
            partial(written, grid=views, name="t{n:03d}.png"),
            (rows, cols),
            views,
        )
    for cols, rows in ((4, 8), (5, 9), (6, 10), (8, 6)):
        line = made.views(1, cols * rows, 150, 200, 0.5, -0.3)
        quilt = made.mosaic(line[0].reshape(rows, cols, 150, 200, 3)[::-1])
        yield Case(
            "quilts without a name",
            f"{cols}x{rows}",
            writers.one("45_01.png", quilt),
            (1, cols * rows),
            line,
        )
    for rows, cols in ((5, 5), (9, 5), (3, 8)):
        views = made.views(rows, cols, 150, 200)
        yield Case(
            "mosaics",
            f"{rows}x{cols}",
            writers.one("lf.png", made.mosaic(views)),
            (rows, cols),
            views,
        )
    pair = np.stack([test_pictures.LEFT, test_pictures.RIGHT])[None]
    for kind, make in test_pictures.PAIRS.items():
        yield Case("stereo", kind, make, (1, 2), pair)
    for kind, make in test_pictures.WITH_DEPTH.items():
        yield Case("picture and depth", kind, make, (5, 9))
    metres = (1000 * np.linspace(4, 1, 96)[:, None] * np.ones(128)).astype(np.uint16)
    metres[20:30, 40:60] = 0
    yield Case(
        "picture and depth", "millimetres, 0 not measured", depth("car_depth.png", metres), (5, 9)
    )
    yield Case(
        "picture and depth",
        "black is near",
        depth("car_depth.png", 255 - test_pictures.FLOOR),
        (5, 9),
    )
    yield Case(
        "one picture",
        "289 unknown files and a picture",
        among_unknown(scene[0, 0]),
        (1, 1),
    )
    for kind, views in test_plausibility.NO_LIGHT_FIELDS.items():
        yield Case(
            "none",
            kind,
            partial(
                made.write_grid,
                grid=views,
                name="v_{r}_{c:02d}.png" if len(views) > 1 else "v{c:02d}.png",
            ),
            None,
        )
    portraits = [
        made.read(path)
        for path in sorted((made.SAMPLES.parent / "faces" / "imm").glob("*-1m.jpg"))[:9]
    ]
    if portraits:
        yield Case(
            "none",
            "nine portraits",
            writers.numbered(portraits, "{}.jpg"),
            None,
        )
    inwards, quilt = (
        test_plausibility.LIGHT_FIELDS["looking inwards"],
        made.views(1, 32, 150, 200, 1.5, -0.3),
    )
    yield Case(
        "sample sets", "looking inwards", partial(made.write_grid, grid=inwards), (5, 5), inwards
    )
    tiles = made.mosaic(quilt.reshape(8, 4, 150, 200, 3)[::-1])
    yield Case("sample sets", "a quilt", writers.one("x_qs4x8.png", tiles), (1, 32), quilt)


def verdict(case: Case, path: Path) -> tuple[str, str]:
    """(word, what it opened as or why not)."""
    try:
        found = analyse_scene(path, config.Scene())
    except UserError as error:
        return (
            "refused" if case.grid is None else "WRONG"
        ), f"{error.message} ({error.remedy})".replace(str(path), "")
    source = found.source
    turn = found.orientation.turn
    rows, cols = turn.grid(source.rows, source.cols)
    what = f"{source.layout} {rows}x{cols}"
    if HARDLY_FIT in source.notes:
        return "note", what
    right = (rows, cols) == case.grid
    if right and case.true is not None:
        places = [
            (r, c, turn.file_index(r, c, rows, cols)) for r in (0, rows - 1) for c in (0, cols - 1)
        ]
        right = all(near(source.read(0, *at), case.true[r, c], case.true) for r, c, at in places)
    if found.orientation.undecided:
        return "undecided", f"{what}; {found.orientation.undecided.split(';')[0]}"
    return ("right" if right else "WRONG"), what


def near(view: np.ndarray, true: np.ndarray, grid: np.ndarray) -> bool:
    """Whether a view is the true one, and not the opposite one."""
    if view.shape != true.shape:
        return False
    off = [
        float(np.abs(view.astype(int) - other).mean())
        for other in (true, *grid[(0, 0, -1, -1), (0, -1, 0, -1)])
    ]
    return off[0] <= min(off) + 1e-9 and off[0] < 12


def results() -> Iterator[tuple[str, str, str, str, str]]:
    """(group, kind, what is expected, word, what it opened as) of every set."""
    for case in cases():
        with tempfile.TemporaryDirectory() as folder:
            found = verdict(case, case.make(Path(folder)))
        expected = "no light field" if case.grid is None else f"{case.grid[0]}x{case.grid[1]}"
        yield (case.group, case.kind, expected, *found)
    for group, sets in people_sets.SETS.items():
        for people in sets:
            with tempfile.TemporaryDirectory() as folder:
                found = people_sets.verdict(people, people.make(Path(folder)))
            yield (group, people.kind, people.opens or f"refused: {people.text}", *found)


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--out", type=Path, default=Path("profiling/results/layouts.md"))
    parser.add_argument("--before", type=Path)
    options = parser.parse_args()
    earlier = re.findall(
        r"^\| ([^|]*) \| ([^|]*) \| [^|]* \| (?:[^|]* \| )?(\w+) \| [^|]* \|$",
        options.before.read_text() if options.before else "",
        re.MULTILINE,
    )
    before = {(group, kind): word for group, kind, word in earlier}
    counts: Counter[str] = Counter()
    rows = []
    for group, kind, expected, word, what in results():
        counts[word] += 1
        cells = (group, kind, expected, before.get((group, kind), ""), word, what[:170])
        rows.append("| " + " | ".join(cells).replace("\n", " ") + " |")
        print(rows[-1], flush=True)
    total = ", ".join(f"{word} {count}" for word, count in sorted(counts.items()))
    head = [
        "# What sets of many kinds open as",
        "",
        f"`python -m profiling.scene_layouts`: {total}.",
        "",
        "| group | kind | expected | before | result | what it opened as, or why not |",
        "|---|---|---|---|---|---|",
    ]
    options.out.write_text("\n".join([*head, *rows]) + "\n")
    print(total)


if __name__ == "__main__":
    main()
