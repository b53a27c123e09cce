"""Names of views: whatever people call them, the two numbers that span a grid are found, and no file is dropped in silence."""

import re
from itertools import product
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from PIL import Image

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene import layouts
from lfpipe.scene.layouts._names import read_names
from lfpipe.scene.layouts._running import find_columns
from lfpipe.scene.layouts._views import GridViews, whole_part
from lfpipe.scene.packing import pack_scene
from tests.hostile_files import with_exif
from tests.scene import made

AUTO = config.Scene()
GRID = made.views(3, 4, 48, 64)
TEXTS = st.sampled_from(["", "view", "IMG", "out put", "Original Camera", "2067", "light-field(1)", "a.b", "x264", "im", "K"])
SEPARATORS = st.sampled_from(["_", "-", " ", "x", "_r", "__", "."])
PAIRS = [
    ("_", "_"), ("-", "-"), ("_row", "_col"), ("_r", "c"), (" (", ","), ("_", "x"), (".", "."), ("_y", "_x"),
    ("t", "_s"),
    ("_u", "_v"),
]  # fmt: skip


@st.composite
def schemes(draw: st.DrawFn) -> tuple[dict[str, tuple[int, int]], list[str]]:
    """Names by (row, column) in some scheme, and names of other files beside them."""
    rows, cols = draw(st.integers(2, 6)), draw(st.integers(2, 6))
    text, (before, between), width = draw(TEXTS), draw(st.sampled_from(PAIRS)), draw(st.integers(1, 4))
    start, step = draw(st.tuples(st.integers(0, 12), st.integers(0, 12))), draw(st.sampled_from([1, 1, 1, 2, 5]))
    swapped, counter = draw(st.booleans()), draw(st.sampled_from(["", "front", "back"]))
    signed = between in ("_", ",") and draw(st.booleans())
    coordinates, suffix = draw(st.booleans()), draw(st.sampled_from(["", "_GT", "_full", "_1"]))
    names = {}
    for number, (row, col) in enumerate(product(range(rows), range(cols))):
        shown = [start[0] + step * row, start[1] + step * col]
        if signed:
            shown = [shown[0] - step - start[0], shown[1] - step - start[1]]
        first, second = (f"{n:+d}" if signed else f"{n:0{width}d}" for n in (shown[::-1] if swapped else shown))
        front = f"_{number + 7:04d}" if counter == "front" else ""
        back = f"_{number + 100:03d}" if counter == "back" else ""
        where = f"_{400 - 2.5 * row + 0.1 * (col % 3):.1f}_{1103.25 + 8.5 * col + 0.1 * (row % 2):.2f}" if coordinates else ""
        names[f"{text}{front}{before}{first}{between}{second}{where}{back}{suffix}.png"] = (row, col)
    return names, draw(st.sampled_from([[], ["thumbs.png"], ["all views 12.jpg", "depth.png"]]))


@given(
    st.integers(2, 9), st.integers(2, 9), st.integers(-200, 200), st.integers(-200, 200),
    st.sampled_from([0.25, 0.5, 1.25, 2.5, 5, 10]), st.sampled_from([0.25, 0.5, 1.25, 2.5, 5, 10]),
    st.sampled_from(["view_{y:.2f}_{x:.2f}", "eye {y:.2f} {x:.2f} mm", "cam_y{y:.2f}_x{x:.2f}", "p_{y:+.2f}_{x:+.2f}"]),
)  # fmt: skip
def test_coordinates_of_any_sign_are_rows_and_columns(
    rows: int, cols: int, y0: int, x0: int, dy: float, dx: float, text: str
) -> None:
    index = {text.format(y=y0 / 4 + dy * r, x=x0 / 4 + dx * c) + ".png": (r, c) for r in range(rows) for c in range(cols)}
    found = read_names(tuple(sorted(index)))
    assert found is not None
    assert (found.rows, found.cols, found.runs, found.others) == (rows, cols, False, ())
    turns = [lambda r, c, down=down, across=across: (down(r), across(c))
             for down in (lambda r: r, lambda r: rows - 1 - r) for across in (lambda c: c, lambda c: cols - 1 - c)]  # fmt: skip
    # A sign before every number may be a separator, so the order is that of the files or its reverse.
    assert any(all(turn(*index[name]) == place for place, name in found.views.items()) for turn in turns)


@settings(max_examples=300)
@given(schemes())
def test_row_and_column_are_found_in_any_scheme(scheme: tuple[dict[str, tuple[int, int]], list[str]]) -> None:
    names, others = scheme
    found = read_names(tuple(sorted([*names, *others])))
    assert found is not None
    assert not found.runs
    assert set(found.others) == set(others)
    placed = {name: index for index, name in found.views.items()}
    assert placed == names or placed == {name: index[::-1] for name, index in names.items()}


@settings(max_examples=100)
@given(TEXTS, SEPARATORS, st.integers(1, 6), st.integers(0, 2000), st.integers(3, 130), st.sampled_from(["", "_GT", "_2"]))
def test_a_running_number_is_no_grid(text: str, mark: str, width: int, start: int, count: int, end: str) -> None:
    names = [f"{text}{mark}{number:0{width}d}{end}.jpg" for number in range(start, start + count)]
    assume(len(set(names)) == count)
    found = read_names(tuple(sorted(names)))
    assert found is not None
    assert found.runs
    assert [found.views[0, k] for k in range(count)] == names


REAL = {
    "counter before": [f"IMG_{2 + 4 * r + c:04d}_001_{r + 1:02d}_{c + 1:02d}.png" for r in range(3) for c in range(4)],
    "coordinates behind": [
        f"Original Camera_{r:02d}_{c:02d}_{400 + r / 2:.1f}_{369.2 - c:.1f}_{30 + r}_36.png" for r in range(3) for c in range(4)
    ],
    "signed": [f"image_{r - 1:+d}_{c - 3:+d}.png" for r in range(3) for c in range(4)],
    "words": [f"im_t{99 + r:03d}_s{100 + c:03d}_GT.png" for r in range(3) for c in range(4)],
    "no separator": [f"v{r}{c}.png" for r in range(3) for c in range(4)],
    "letters": [f"{'ABC'[r]}{c + 1}.png" for r in range(3) for c in range(4)],
    "running": [f"lowtoys{1 + 4 * r + c:03d}.png" for r in range(3) for c in range(4)],
}


@pytest.mark.parametrize("scheme", REAL)
def test_names_that_were_met(tmp_path: Path, scheme: str) -> None:
    for name, picture in zip(REAL[scheme], GRID.reshape(12, *GRID.shape[2:]), strict=True):
        made.write(tmp_path / name, picture)
    source = layouts.describe(tmp_path, AUTO)
    assert (source.rows, source.cols) == (3, 4)
    assert np.array_equal([[source.read(0, r, c) for c in range(4)] for r in range(3)], GRID)
    assert not any("files used" in note for note in source.notes)


PLACES = list(product(range(3), range(4)))
FOLDERS = {
    "rows": [f"row_{r + 1:02d}/img_{c + 1:02d}.png" for r, c in PLACES],
    "rows by bare numbers": [f"{r}/{c}.png" for r, c in PLACES],
    "rows of a camera": [f"Row {'ABC'[r]}/DSC{4711 + 4 * r + c:05d}.JPG" for r, c in PLACES],
    "columns": [f"col{c}/row{r}.png" for r, c in PLACES],
    "one inner folder": [f"images/v_{r}_{c}.png" for r, c in PLACES],
    "two folders down": [f"scan/png/v_{r}_{c}.png" for r, c in PLACES],
    "suffixes": [f"v_{r}_{c}." + ("jpg", "JPG", "jpeg", "Jpg")[c] for r, c in PLACES],
    "sums": [f"{r:02d}_{c:02d}_{(97 * r + c) * 2654435761 % 2**32:08x}.png" for r, c in PLACES],
    "copies, the first bare": ["a.png", *(f"a ({k}).png" for k in range(1, 12))],
    "copies of a Mac": ["shot.png", *(f"shot {k}.png" for k in range(2, 13))],
    "times": [f"WhatsApp Image 2026-07-04 at 15.{58 + k // 6}.{9 * (k % 6):02d}.jpeg" for k in range(12)][:6]
    + [f"WhatsApp Image 2026-07-04 at 16.00.{9 * k:02d}.jpeg" for k in range(6)],
    "times of a phone": [f"PXL_20260704_15{k // 6 + 30}{9 * (k % 6):02d}{371 * k % 1000:03d}.jpg" for k in range(12)],
}


@pytest.mark.parametrize("scheme", FOLDERS)
def test_names_and_folders_of_people(tmp_path: Path, scheme: str) -> None:
    for name, picture in zip(FOLDERS[scheme], GRID.reshape(12, *GRID.shape[2:]), strict=True):
        made.write(tmp_path / name, picture)
    for name in ("README.txt", "Thumbs.db", ".DS_Store", "__MACOSX/._a.jpg"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"x")
    source = layouts.describe(tmp_path, AUTO)
    grid = np.array([[source.read(0, r, c) for c in range(source.cols)] for r in range(source.rows)])
    assert grid.shape == GRID.shape
    assert np.abs(grid.astype(int) - GRID).mean() < 4
    assert source.path == tmp_path


def test_folders_of_two_scenes_are_named(tmp_path: Path) -> None:
    for name in ("garden", "kitchen"):
        made.write_grid(tmp_path / name, GRID)
    with pytest.raises(UserError, match="2 folders: garden, kitchen") as caught:
        layouts.describe(tmp_path, AUTO)
    assert str(tmp_path / "garden") in caught.value.remedy


@pytest.mark.parametrize("order", ["rows", "cols", "snake"])
@pytest.mark.parametrize(("rows", "cols"), [(16, 16), (5, 5), (2, 8), (1, 20)])
def test_columns_of_a_running_number(rows: int, cols: int, order: str) -> None:
    views = made.views(rows, cols, 48, 64)[..., 1]
    places = [(r, c) for c in range(cols) for r in range(rows)] if order == "cols" else list(product(range(rows), range(cols)))
    line = [views[r, cols - 1 - c if order == "snake" and r % 2 else c] for r, c in places]
    found = find_columns(lambda k: line[k], [True] * len(line))
    shape = (cols, rows) if order == "cols" and rows > 1 else (rows, cols)
    assert (found.rows, found.cols, found.snake) == (*shape, order == "snake" and rows > 1)


def test_one_file_too_many_is_left_out_and_named(tmp_path: Path) -> None:
    made.write_grid(tmp_path, made.views(5, 5, 48, 64), "v{n:02d}.png")
    made.write(tmp_path / "v25.png", made.views(5, 5, 48, 64)[2, 2])
    for scene in (AUTO, config.Scene(grid="5x5")):
        source = layouts.describe(tmp_path, scene)
        assert (source.rows, source.cols) == (5, 5)
        assert any("25 of 26 files used; the others are v25.png" in note for note in source.notes)


def test_an_odd_picture_among_the_views_is_named(tmp_path: Path) -> None:
    made.write_grid(tmp_path, GRID, "v{n:02d}.png")
    made.write(tmp_path / "v12.png", made.texture(80, 200, 1))  # all views in one, by its size
    made.write(tmp_path / "juntos.jpg", made.texture(80, 200, 1))
    source = layouts.describe(tmp_path, AUTO)
    assert (source.rows, source.cols) == (3, 4)
    assert any("12 of 14 files used; the others are juntos.jpg, v12.png (200x80 px)" in note for note in source.notes)


def test_a_missing_view_is_made_and_told(tmp_path: Path) -> None:
    views = made.views(5, 5, 96, 128)
    made.write_grid(tmp_path / "s", views, "v_{r}_{c}.png")
    (tmp_path / "s" / "v_2_2.png").unlink()
    field = pack_scene(tmp_path / "s", config.Scene(cache_dir=str(tmp_path / "cache")))
    assert any("1 of 5x5 views missing, made from others: row 2 column 2" in note for note in field.manifest["notes"])
    assert not field.present[2, 2]
    true, made_view, beside = (
        np.asarray(v, float) for v in (views[2, 2].transpose(2, 0, 1), field.views[0, 2, 2], field.views[0, 2, 3])
    )
    assert np.abs(made_view - true).mean() < 0.4 * np.abs(beside - true).mean()


CROSSES = {
    "star": (lambda r, c: r == 4 or c == 4 or r == c or r + c == 8, 9, (3, 3)),
    "cross": (lambda r, c: r == 4 or c == 4, 9, (1, 9)),
    "left half": (lambda r, c: c < 4 or (r, c) == (0, 8), 9, (9, 4)),
}


@pytest.mark.parametrize("shape", CROSSES)
def test_an_incomplete_grid_gives_its_largest_whole_part(shape: str) -> None:
    inside, side, expected = CROSSES[shape]
    views = {(r, c): f"{r}_{c}" for r in range(side) for c in range(side) if inside(r, c)}
    part = whole_part(GridViews(views, side, side))
    assert (part.rows, part.cols) == expected
    assert set(part.views) == set(product(range(part.rows), range(part.cols)))
    assert "views missing" in part.notes[0]
    lines = {tuple(map(int, name.split("_"))) for name in part.views.values()}
    assert len(lines) == part.rows * part.cols <= len(views)


def test_every_remedy_works_on_its_folder(tmp_path: Path) -> None:
    """Messages that name an option are run again with that option."""
    made.write_grid(tmp_path / "run", GRID, "v{n:02d}.png")
    made.write_grid(tmp_path / "grid", GRID)
    tries = [
        (tmp_path / "run", config.Scene(layout="rows-cols"), "use --layout numbered", config.Scene(layout="numbered")),
        (tmp_path / "run", config.Scene(grid="5x5"), "leave out --grid to have it detected", AUTO),
        (tmp_path / "grid", config.Scene(grid="4x4"), "leave out --grid; --layout numbered takes names in order", AUTO),
    ]
    for path, wrong, remedy, right in tries:
        with pytest.raises(UserError) as caught:
            layouts.describe(path, wrong)
        assert caught.value.remedy == remedy
        source = layouts.describe(path, right)
        assert (source.rows, source.cols) == (3, 4)


def test_a_folder_of_many_is_never_one_view(tmp_path: Path) -> None:
    for k, name in enumerate(["beach.png", "dog.png", "house.png"]):
        made.write(tmp_path / name, made.texture(48, 64, k))
    with pytest.raises(UserError, match=re.escape("beach.png")):
        layouts.describe(tmp_path, AUTO)


HABITS: dict[str, tuple[list[str], tuple[int, int, int]]] = {  # names, and rows, columns and views of them
    "a burst's cover": ([f"IMG_BURST{n:03d}{'_COVER' * (n == 3)}.jpg" for n in range(9)], (1, 9, 8)),
    "half PNG, half JPEG": ([f"v_{r}_{c}.{'png' if (r + c) % 2 else 'jpg'}" for r in range(5) for c in range(5)], (5, 5, 25)),
    "left and right cameras": (
        [f"{side} cam x {r:02d}_{c:02d}.png" for side in ("left", "right") for r in range(5) for c in range(5)],
        (5, 5, 25),
    ),
    "times": ([f"Screenshot 2026-07-04 at 15.{30 + n // 12}.{5 * (n % 12):02d}.png" for n in range(25)], (1, 25, 25)),
    "a line break": ([f"view\n{r}\n{c}.png" for r in range(3) for c in range(4)], (3, 4, 12)),
    "uneven steps": ([f"pos {100 * c // 8}% {100 * r // 8}%.png" for r in range(5) for c in range(5)], (5, 5, 25)),
    "frames behind": ([f"cam_{r}_{c}_{f:04d}.png" for r in range(3) for c in range(4) for f in (1, 2)], (3, 4, 12)),
    "frames of a line": ([f"cam{c}_frame{f:03d}.png" for c in range(7) for f in range(3)], (1, 7, 7)),
    "exposures": ([f"{r}_{c}_ev{e}.png" for r in range(3) for c in range(4) for e in (0, 1)], (3, 4, 12)),
    "a copy is no cover": ([f"v_{n}.png" for n in range(9)] + ["v_copy_3.png"], (1, 9, 9)),
}


@pytest.mark.parametrize("habit", HABITS)
def test_numbers_that_count_no_views_are_told_apart(habit: str) -> None:
    names, expected = HABITS[habit]
    found = read_names(tuple(names))
    assert found is not None
    assert (found.rows, found.cols, len(found.views)) == expected
    assert not found.clashes and not found.doubt


def test_three_numbers_alike_leave_a_doubt() -> None:
    found = read_names(tuple(f"{r}_{c}_{f}.png" for r in range(3) for c in range(4) for f in range(2)))
    assert found is not None and "frames" in found.doubt


def test_a_folder_per_camera_is_a_running_number() -> None:
    found = read_names(tuple(f"cam{n:02d}/frame.jpg" for n in range(16)))
    assert found is not None
    assert (found.rows, found.cols, found.runs) == (1, 16, True)


def test_twenty_thousand_unrelated_names_are_read_at_once() -> None:
    rng = np.random.default_rng(0)
    words = ["holiday", "beach", "cat", "dog", "DSC", "IMG", "scan", "photo", "final", "new", "copy"]
    names = {f"{'_'.join(rng.choice(words, 3, False))}_{rng.integers(10**6)}.{rng.choice(['jpg', 'png'])}" for _ in range(20_000)}
    found = read_names(tuple(sorted(names)))  # in a second; comparing each family with each other took minutes
    assert found is not None and len(found.views) < 100


def test_roman_numerals_are_no_single_letters() -> None:
    names = ["I", "II", "III", "IV", "V", "VI", "VII", "VIII", "IX"]
    assert read_names(tuple(f"view {name}.png" for name in names)) is None


def test_of_a_view_in_two_formats_the_lossless_one_in_colour_is_used(tmp_path: Path) -> None:
    made.write_grid(tmp_path / "a", GRID, "v_{r}_{c}.jpg")
    made.write_grid(tmp_path / "a", GRID, "v_{r}_{c}.png")
    made.write_grid(tmp_path / "b", GRID, "v_{r}_{c}.jpg")
    made.write_grid(tmp_path / "b", GRID[..., 1], "v_{r}_{c}.tif")
    for folder, end in (("a", ".png"), ("b", ".jpg")):
        source = layouts.describe(tmp_path / folder, AUTO)
        assert (source.rows, source.cols) == (3, 4) and {path.suffix for path in source.files} == {end}
        assert any("12 of 24 files used" in note for note in source.notes)


def test_folders_of_two_eyes_and_of_results(tmp_path: Path) -> None:
    for side, view in (("left", GRID[0, 0]), ("right", GRID[0, 1])):
        made.write(tmp_path / "eyes" / side / "1.png", view)
    source = layouts.describe(tmp_path / "eyes", AUTO)
    assert (source.layout, source.rows, source.cols) == ("stereo", 1, 2)
    made.write_grid(tmp_path / "scene" / "rgb", GRID)
    made.write_grid(tmp_path / "scene" / "out", GRID[..., 1])
    source = layouts.describe(tmp_path / "scene", AUTO)
    assert (source.rows, source.cols) == (3, 4)
    assert "the pictures are those of rgb; not used: out/" in source.notes


@pytest.mark.parametrize("name", ["v_{r}_{c}.avif", "v_{r}_{c}.gif", "project/export/final/views/{r}_{c}.png", "v\n{r}\n{c}.png"])
def test_formats_depths_and_line_breaks(name: str, tmp_path: Path) -> None:
    for r, c in PLACES:
        path = tmp_path / name.format(r=r, c=c)
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(GRID[r, c]).save(path, quality=95)
    source = layouts.describe(tmp_path, AUTO)
    assert (source.rows, source.cols) == (3, 4)
    assert np.abs(source.read(0, 1, 2).astype(int) - GRID[1, 2]).mean() < 8
    assert not any("\n" in note for note in source.notes)


@pytest.mark.parametrize("pictures", [1, 2])
def test_more_unknown_files_than_pictures_are_named(pictures: int, tmp_path: Path) -> None:
    for k in range(pictures):
        made.write(tmp_path / f"overview {k}.png", made.texture(48, 64, k))
    for k in range(289):
        (tmp_path / f"view_{k:03d}.xyz").write_bytes(b"x")
    with pytest.raises(UserError, match=r"289 of \d+ files are of a kind that is not read: view_000\.xyz") as caught:
        layouts.describe(tmp_path, AUTO)
    alone = tmp_path / "overview 0.png"
    assert str(alone) in caught.value.remedy and layouts.describe(alone, AUTO).layout == "picture"
    for k in range(289):
        (tmp_path / f"view_{k:03d}.xyz").rename(tmp_path / f"view_{k:03d}.txt")
    if pictures == 1:
        assert layouts.describe(tmp_path, AUTO).layout == "picture"


@pytest.mark.parametrize(("count", "near_px"), [(51, 0.25), (51, 1.0), (45, 2.0), (101, 1.0)])
def test_a_long_line_is_a_line(count: int, near_px: float) -> None:
    views = made.views(1, count, 96, 128, near_px, -near_px / 2)[0, ..., 1]
    found = find_columns(lambda k: views[k], [True] * count)
    assert (found.rows, found.cols) == (1, count)


@pytest.mark.parametrize("folders", [("images", "images_4", "images_8"), ("full", "half"), ("scale1", "scale2")])
def test_a_picture_beside_folders_of_one_scene_in_several_sizes(folders: tuple[str, ...], tmp_path: Path) -> None:
    for size, folder in enumerate(folders):
        for n, (r, c) in enumerate(np.ndindex(3, 4)):
            view = np.ascontiguousarray(made.views(3, 4, 96, 128)[r, c, :: 2**size, :: 2**size])
            made.write(tmp_path / folder / (f"image{n:03d}.png" if size else f"IMG_{4026 + n}.png"), view)
    (tmp_path / "sparse").mkdir()
    made.write(tmp_path / "trimesh.png", made.texture(60, 80, 1))
    source = layouts.describe(tmp_path, AUTO)
    assert (source.rows, source.cols, source.width_px) == (3, 4, 128)
    others = ", ".join(["trimesh.png", *(f"{folder}/" for folder in folders[1:])])
    assert f"the pictures are those of {folders[0]}; not used: {others}" in source.notes


@pytest.mark.parametrize("names", [("flowers", "knights"), ("a", "b"), ("scene 1", "scene 2")])
def test_folders_of_two_scenes_with_the_same_names_and_other_sizes(names: tuple[str, str], tmp_path: Path) -> None:
    made.write_grid(tmp_path / names[1], made.views(3, 4, 96, 128))
    made.write_grid(tmp_path / names[0], made.views(3, 4, 120, 160)[:, :, ::-1])
    with pytest.raises(UserError, match=f"2 folders: {', '.join(names)}"):
        layouts.describe(tmp_path, AUTO)


@pytest.mark.filterwarnings("error")
def test_folders_of_black_pictures_are_no_copies(tmp_path: Path) -> None:
    for name, px in (("full", 80), ("half", 40)):
        made.write_grid(tmp_path / name, np.zeros((1, 3, px, px, 3), np.uint8))
    with pytest.raises(UserError, match="2 folders: full, half"):
        layouts.describe(tmp_path, AUTO)


def test_a_picture_beside_folders_of_rows(tmp_path: Path) -> None:
    made.write_grid(tmp_path, GRID, "row_{r}/{c}.png")
    made.write(tmp_path / "preview.png", GRID[1, 1])
    source = layouts.describe(tmp_path, AUTO)
    assert (source.rows, source.cols) == (3, 4) and "not used: preview.png" in source.notes


@pytest.mark.parametrize("below", ["old/edited/photo 2.jpg", "old/photo 2.jpg"])
def test_a_picture_beside_no_more_than_one_below_it(below: str, tmp_path: Path) -> None:
    made.write(tmp_path / "photo.jpg", made.texture(96, 128, 1))
    made.write(tmp_path / below, made.texture(96, 128, 2))
    source = layouts.describe(tmp_path, AUTO)
    assert (source.layout, source.files, source.notes) == ("picture", (tmp_path / "photo.jpg",), ())


def test_a_picture_with_a_smaller_copy_below_it(tmp_path: Path) -> None:
    made.write(tmp_path / "photo.jpg", made.texture(96, 128, 1))
    made.write(tmp_path / "thumbs" / "photo.jpg", made.texture(24, 32, 1))
    made.write(tmp_path / "edited" / "photo.jpg", made.texture(96, 128, 2))
    assert layouts.describe(tmp_path, AUTO).layout == "picture"


@pytest.mark.parametrize("orientation", [3, 6, 8])
def test_photographs_of_a_phone_held_upright(orientation: int, tmp_path: Path) -> None:
    grid = made.views(1, 7, 128, 96)
    lying = {3: cv2.ROTATE_180, 6: cv2.ROTATE_90_COUNTERCLOCKWISE, 8: cv2.ROTATE_90_CLOCKWISE}[orientation]
    for n, view in enumerate(grid[0]):
        stored = cv2.imencode(".jpg", cv2.rotate(view[..., ::-1], lying), [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
        (tmp_path / f"IMG_{4026 + n}.JPG").write_bytes(with_exif(stored, orientation))
    source = layouts.describe(tmp_path, AUTO)
    assert (source.rows, source.cols, source.height_px, source.width_px) == (1, 7, 128, 96)
    assert all(np.abs(source.read(0, 0, c).astype(int) - grid[0, c]).mean() < 4 for c in range(7))


def test_numbers_in_brackets_and_capital_endings_are_views_in_their_order(tmp_path: Path) -> None:
    texture = cv2.GaussianBlur(np.random.default_rng(7).integers(0, 255, (120, 400, 3), np.uint8), (0, 0), 3)
    for k in range(16):
        row, col = divmod(k, 4)
        stored = tmp_path / "made.jpg"
        cv2.imwrite(str(stored), texture[20 + 2 * row : 100 + 2 * row, 20 + 2 * col : 200 + 2 * col])
        stored.rename(tmp_path / f"photo ({k + 1}).JPG")
    found = layouts.describe(tmp_path, config.Scene())
    assert (found.layout, found.rows, found.cols) == ("numbered", 4, 4)
    alone = layouts.describe(tmp_path / "photo (1).JPG", config.Scene())
    assert (alone.layout, alone.rows * alone.cols) == ("picture", 1)
