"""Names of views: whatever people call them, the two numbers that span a grid are found, and no
file is dropped in silence.
"""

from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from lfpipe import config
from lfpipe.scene import layouts
from lfpipe.scene.layouts._likeness import find_columns
from lfpipe.scene.layouts._names import read_names
from tests.scene import made
from tests.support.examples import examples

AUTO = config.Scene()
GRID = made.views(3, 4, 48, 64)
PLACES = list(product(range(3), range(4)))
TEXTS = st.sampled_from(
    [
        "",
        "view",
        "IMG",
        "out put",
        "Original Camera",
        "2067",
        "light-field(1)",
        "a.b",
        "x264",
        "im",
        "K",
    ]
)
PAIRS = [
    ("_", "_"),
    ("-", "-"),
    ("_row", "_col"),
    ("_r", "c"),
    (" (", ","),
    ("_", "x"),
    (".", "."),
    ("_y", "_x"),
    ("t", "_s"),
    ("_u", "_v"),
]


@st.composite
def schemes(draw: st.DrawFn) -> tuple[dict[str, tuple[int, int]], list[str]]:
    """Names by (row, column) in some scheme, and names of other files beside them."""
    rows, cols = draw(st.integers(2, 6)), draw(st.integers(2, 6))
    text = draw(TEXTS)
    before, between = draw(st.sampled_from(PAIRS))
    width = draw(st.integers(1, 4))
    start = draw(st.tuples(st.integers(0, 12), st.integers(0, 12)))
    step = draw(st.sampled_from([1, 1, 1, 2, 5]))
    swapped, counter = draw(st.booleans()), draw(st.sampled_from(["", "front", "back"]))
    signed = between in ("_", ",") and draw(st.booleans())
    coordinates, suffix = draw(st.booleans()), draw(st.sampled_from(["", "_GT", "_full", "_1"]))
    names = {}
    for number, (row, col) in enumerate(product(range(rows), range(cols))):
        indices = [start[0] + step * row, start[1] + step * col]
        if signed:
            indices = [indices[0] - step - start[0], indices[1] - step - start[1]]
        first, second = (
            f"{n:+d}" if signed else f"{n:0{width}d}"
            for n in (indices[::-1] if swapped else indices)
        )
        front = f"_{number + 7:04d}" if counter == "front" else ""
        back = f"_{number + 100:03d}" if counter == "back" else ""
        where = (
            f"_{400 - 2.5 * row + 0.1 * (col % 3):.1f}_{1103.25 + 8.5 * col + 0.1 * (row % 2):.2f}"
            if coordinates
            else ""
        )
        names[f"{text}{front}{before}{first}{between}{second}{where}{back}{suffix}.png"] = (
            row,
            col,
        )
    return names, draw(st.sampled_from([[], ["thumbs.png"], ["all views 12.jpg", "depth.png"]]))


@examples(300)
@given(schemes())
def test_row_and_column_are_found_in_any_scheme(
    scheme: tuple[dict[str, tuple[int, int]], list[str]],
) -> None:
    names, others = scheme
    numbered = read_names(tuple(sorted([*names, *others])))
    assert numbered is not None and not numbered.runs
    placed = {name: index for index, name in numbered.views.items()}
    assert placed == names or placed == {name: index[::-1] for name, index in names.items()}


@pytest.mark.parametrize(
    ("rows", "cols", "near_px", "order"),
    [(*shape, 2.0, order) for shape in ((16, 16), (2, 8), (1, 20)) for order in ("rows", "cols")]
    + [(1, 51, 0.25, "rows"), (1, 51, 1.0, "rows"), (1, 45, 2.0, "rows"), (1, 101, 1.0, "rows")],
)
def test_columns_of_a_likeness_number(rows: int, cols: int, near_px: float, order: str) -> None:
    views = made.views(rows, cols, 48, 64, near_px, -near_px / 2)[..., 1]
    places = (
        [(r, c) for c in range(cols) for r in range(rows)]
        if order == "cols"
        else list(product(range(rows), range(cols)))
    )
    line = [views[place] for place in places]
    run = find_columns(lambda k: line[k], [True] * len(line), None)
    shape = (cols, rows) if order == "cols" and rows > 1 else (rows, cols)
    assert run is not None and (run.rows, run.cols) == shape


def spread(text: str, rows: range, cols: range) -> list[str]:
    return [text.format(r=r, c=c, n=r * len(cols) + c) for r in rows for c in cols]


NINE, THREE = range(9), range(3)
REAL_NAMES = {  # names as data sets, programs and cameras write them, and what they say
    "HCI": (spread("input_Cam{n:03d}.png", NINE, NINE), "run of 81"),
    "HCI, with maps": (
        [*spread("input_Cam{n:03d}.png", NINE, NINE), "gt_disp_lowres.pfm.png", "mask_fine.png"],
        "run of 81, 81 of 83 files",
    ),
    "old HCI": (spread("{r:02d}_{c:02d}.png", THREE, THREE), "3x3"),
    "Stanford": (spread("out_{r:02d}_{c:02d}_-{r}01.5_{c}99.25_.png", NINE, NINE), "9x9"),
    "Stanford humvee": (spread("humvee-tree_{n:03d}.png", range(16), range(16)), "run of 256"),
    "Lytro by KAIST": (spread("2067_{r:02d}_{c:02d}.png", range(1, 10), range(1, 10)), "9x9"),
    "JPEG Pleno": (spread("{r:03d}_{c:03d}.ppm", range(15), range(15)), "15x15"),
    "PlenoptiCam": (spread("viewpoint_{r}_{c}.png", NINE, NINE), "9x9"),
    "Middlebury multiview": ([f"view{n}.png" for n in range(7)], "run of 7"),
    "Blender": (spread("render_y{r}_x{c}.png", THREE, range(5)), "3x5"),
    "a phone": ([f"IMG_20260704_15{n // 60:02d}{n % 60:02d}.jpg" for n in range(90)], "run of 90"),
    "a camera": ([f"DSC0{n}.JPG" for n in range(9994, 9999)], "run of 5"),
    "KITTI": ([f"{n:010d}.png" for n in range(20)], "run of 20"),
    "TUM": ([f"1305031102.{175304 + 33333 * n}.png" for n in range(9)], "run of 9"),
    "screenshots": ([f"Screenshot 2026-07-04 at 15.3{n}.0{n}.png" for n in range(6)], "run of 6"),
    "copies": (["photo.jpg", *(f"photo ({n}).jpg" for n in range(1, 9))], "run of 8, 8 of 9 files"),
    "rows in folders": (spread("row_{r}/{c:02d}.png", THREE, range(5)), "3x5"),
    "signs": (spread("im_{r:+d}_{c:+d}.png", range(-1, 2), range(-2, 3)), "3x5"),
    "views and frames": (
        [f"v{r}_{c}_frame{t}.png" for r in THREE for c in THREE for t in range(4)],
        "run of 36",
    ),
    "a burst's cover": (
        [f"IMG_BURST{n:03d}{'_COVER' * (n == 3)}.jpg" for n in NINE],
        "run of 9, 8 of 9 files",
    ),
    "half PNG, half JPEG": (
        [f"v_{r}_{c}.{'png' if (r + c) % 2 else 'jpg'}" for r in NINE for c in NINE],
        "9x9",
    ),
    "left and right cameras": (
        [f"{side} cam x {r:02d}_{c:02d}.png" for side in ("left", "right") for r, c in PLACES],
        "3x4, 12 of 24 files",
    ),
    "uneven steps": (
        [f"pos {100 * c // 8}% {100 * r // 8}%.png" for r in NINE for c in NINE],
        "9x9",
    ),
    "frames of a line": (
        [f"cam{c}_frame{f:03d}.png" for c in range(7) for f in THREE],
        "7x3",
    ),
    "exposures": ([f"{r}_{c}_ev{e}.png" for r, c in PLACES for e in (0, 1)], "run of 24"),
    "a copy is no cover": (
        [*(f"v_{n}.png" for n in NINE), "v_copy_3.png"],
        "run of 9, 9 of 10 files",
    ),
    "a folder per camera": ([f"cam{n:02d}/frame.jpg" for n in range(16)], "run of 16"),
    "three numbers alike": (
        [f"{r}_{c}_{f}.png" for r, c in PLACES for f in (0, 1)],
        "run of 24",
    ),
    "Roman numerals": (
        [f"view {n}.png" for n in ["I", "II", "III", "IV", "V", "VI", "VII", "VIII", "IX"]],
        "nothing",
    ),
    "beach, dog, house": (["beach.jpg", "dog.jpg", "house.jpg"], "nothing"),
    "a grid and previews": (
        [*spread("view_{r}_{c}.png", THREE, range(5)), "preview_1.png", "preview_2.png"],
        "3x5, 15 of 17 files",
    ),
}


def test_real_names_say_what_they_say() -> None:
    """One table, so that whoever changes a rule sees what else moves."""
    wrong = []
    for kind, (names, expected) in REAL_NAMES.items():
        numbered = read_names(tuple(names))
        reading = "nothing"
        if numbered is not None:
            shape = f"{numbered.rows}x{numbered.cols}"
            reading = f"run of {numbered.cols}" if numbered.runs else shape
            if len(numbered.views) < len(names):
                reading += f", {len(numbered.views)} of {len(names)} files"
        if reading != expected:
            wrong.append(f"{kind}: {reading}, expected {expected}")
    assert not wrong, "\n".join(wrong)


def taken(path: Path, view: np.ndarray, second: float) -> None:
    """A photograph of that time."""
    exif = Image.Exif()
    times = exif.get_ifd(0x8769)
    times[0x9003] = f"2026:07:04 15:30:{int(second):02d}"
    times[0x9291] = f"{round(100 * (second % 1)):02d}"
    Image.fromarray(view).save(path, quality=95, exif=exif)


def test_a_line_of_photographs_is_in_the_order_of_their_times(tmp_path: Path) -> None:
    numbers = [9997, 9998, 9999, 1, 2]
    line = made.views(1, 5, 144, 192)[0]
    for at, number in enumerate(numbers):
        taken(tmp_path / f"DSC_{number:04d}.JPG", line[at], 8 + 0.5 * at)
    source = layouts.describe(tmp_path, AUTO)
    assert [int(path.stem[4:]) for path in source.files] == numbers
    assert (
        "DSC_9997.JPG, DSC_9998.JPG" in source.notes[0]
        and "takes that of their names" in source.notes[0]
    )
    stated = layouts.describe(tmp_path, config.Scene(grid="1x5"))
    assert [int(path.stem[4:]) for path in stated.files] == sorted(numbers)
    Image.fromarray(line[4]).save(tmp_path / "DSC_0002.JPG")  # edited: not all have a time
    source = layouts.describe(tmp_path, AUTO)
    assert [int(path.stem[4:]) for path in source.files] == sorted(numbers)
