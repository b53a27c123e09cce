"""What else lies in people's folders beside a light field, and what is none, for profiling/people_folders.py."""

from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from profiling.people_scenes import FACES, NAMES, Case, Grid, Make, written
from tests.hostile_files import with_exif
from tests.scene import made


def beside(grid: Grid, extra: Callable[[Path], None], name: str = "view_{r:02d}_{c:02d}.jpg") -> Make:
    def make(folder: Path) -> Path:
        made.write_grid(folder, grid, name)
        extra(folder)
        return folder

    return make


def text(name: str) -> Callable[[Path], None]:
    def put(folder: Path) -> None:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(b"x" * 3000)

    return put


def for_each(grid: Grid, name: str, picture: Callable[[Grid], Any] | None) -> Callable[[Path], None]:
    """Another file beside each view: a picture made from it, or bytes."""

    def put(folder: Path) -> None:
        for r, c in product(*map(range, grid.shape[:2])):
            path = folder / name.format(r=r, c=c)
            path.parent.mkdir(exist_ok=True)
            made.write(path, picture(grid[r, c])) if picture else path.write_bytes(b"\0" * 2000)

    return put


def small(view: Any) -> Any:
    return cv2.resize(view, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)


def grey_map(view: Any) -> Any:
    return cv2.GaussianBlur(view[..., 1], (0, 0), 5)


def in_sizes(grid: Grid) -> Make:
    """As reconstruction programs keep their input: images, images_2, images_4."""

    def make(folder: Path) -> Path:
        for k, name in ((1, "images"), (2, "images_2"), (4, "images_4")):
            made.write_grid(folder / name, grid[:, :, ::k, ::k], "IMG_{n:04d}.JPG" if k == 1 else "image{n:03d}.png")
        made.write(folder / "poster.png", made.texture(150, 200, 4))
        return folder

    return make


def lying(grid: Grid) -> Make:
    """As a phone held upright stores them: turned by a quarter, which EXIF says."""

    def make(folder: Path) -> Path:
        for n, (r, c) in enumerate(product(*map(range, grid.shape[:2]))):
            stored = cv2.imencode(".jpg", np.rot90(grid[r, c])[..., ::-1])[1].tobytes()
            (folder / f"IMG_{n + 1200}.JPG").write_bytes(with_exif(stored, 6))
        return folder

    return make


def littered(grid: Grid) -> Iterator[Case]:
    """A 5x5 grid with what else lies in people's folders."""
    extras: dict[str, Callable[[Path], None]] = {
        "README.txt": text("README.txt"),
        "Thumbs.db": text("Thumbs.db"),
        ".DS_Store": text(".DS_Store"),
        "notes.pdf": text("notes.pdf"),
        "._ files of a Mac": for_each(grid, "._view_{r:02d}_{c:02d}.jpg", None),
        "desktop.ini": text("desktop.ini"),
        "Copy of": lambda f: made.write(f / "Copy of view_02_02.jpg", grid[2, 2]),
        "- Copy": lambda f: made.write(f / "view_02_02 - Copy.jpg", grid[2, 2]),
        "(1)": lambda f: made.write(f / "view_02_02 (1).jpg", grid[2, 2]),
        "thumbnails": for_each(grid, "thumb_{r:02d}_{c:02d}.jpg", small),
        "thumbnails behind": for_each(grid, "view_{r:02d}_{c:02d}_t.jpg", small),
        "thumbnails below": for_each(grid, "thumbs/view_{r:02d}_{c:02d}.jpg", small),
        "raw files": for_each(grid, "view_{r:02d}_{c:02d}.CR2", None),
        "raw files below": for_each(grid, "raw/view_{r:02d}_{c:02d}.dng", None),
        "depth maps": for_each(grid, "view_{r:02d}_{c:02d}_depth.png", grey_map),
        "depth maps before": for_each(grid, "depth_{r:02d}_{c:02d}.png", grey_map),
        "depth maps below": for_each(grid, "depth/view_{r:02d}_{c:02d}.png", grey_map),
        "contact sheet": lambda f: made.write(f / "sheet.jpg", made.mosaic(grid[:, :, ::4, ::4])),
        "calibration": lambda f: made.write(f / "calib_01.jpg", made.texture(150, 200, 9)),
        "the same as TIFF": for_each(grid, "view_{r:02d}_{c:02d}.tif", lambda v: v),
        "masks": for_each(grid, "view_{r:02d}_{c:02d}_mask.png", lambda v: (v[..., 1] > 128).astype(np.uint8) * 255),
        "__MACOSX": text("__MACOSX/._view_00_00.jpg"),
        "sidecars": for_each(grid, "view_{r:02d}_{c:02d}.xmp", None),
    }
    for kind, extra in extras.items():
        yield Case("beside", kind, beside(grid, extra), grid)
    yield Case("beside", "in a subfolder", lambda f: [made.write_grid(f / "images", grid), f][1], grid)
    yield Case("beside", "a poster, and the views in three sizes", in_sizes(grid), grid)
    yield Case("beside", "photographs that were stored lying", lying(grid), grid)
    yield Case("beside", "two folders down", lambda f: [made.write_grid(f / "scan" / "png", grid), f][1], grid)
    yield Case(
        "gaps", "two missing", lambda f: written(f, grid, NAMES["uv"], leave_out=lambda r, c: (r, c) in ((0, 1), (3, 3))), grid
    )
    yield Case(
        "gaps", "a corner missing", lambda f: written(f, grid, NAMES["accents"], leave_out=lambda r, c: (r, c) == (0, 0)), grid
    )
    yield Case(
        "gaps", "one of a run missing", lambda f: written(f, grid, NAMES["camera"], leave_out=lambda r, c: (r, c) == (2, 1)), grid
    )
    yield Case("gaps", "a row missing", lambda f: written(f, grid, NAMES["uv"], leave_out=lambda r, c: r == 4), grid[:4])
    yield Case(
        "gaps",
        "one picture of another size",
        lambda f: [written(f, grid, NAMES["uv"]), made.write(f / "u2v2.png", small(grid[2, 2]))][0],
        grid,
    )


def no_light_fields() -> Iterator[Case]:
    def copied(paths: list[Path], name: str) -> Make:
        return lambda f: [[(f / name.format(n=n, stem=p.stem)).write_bytes(p.read_bytes()) for n, p in enumerate(paths)], f][1]

    def frames(video: str, every: int, count: int) -> Make:
        def make(folder: Path) -> Path:
            clip = cv2.VideoCapture(str(next(FACES.rglob(video))))
            for n in range(count * every):
                good, frame = clip.read()
                if good and n % every == 0:
                    cv2.imwrite(str(folder / f"frame{n // every:03d}.jpg"), frame)
            return folder

        return make

    def stub(name: str, start: bytes) -> Make:
        return lambda f: [(f / name).write_bytes(start + b"\0" * 4000), f / name][1]

    if FACES.is_dir():
        yield Case("none", "photographs", copied(sorted((FACES / "no_face").glob("*.jpg")), "IMG_{n:04d}.jpg"))
        yield Case("none", "16 photographs", copied(sorted((FACES / "no_face").glob("*.jpg"))[:16], "{n}.jpg"))
        yield Case("none", "people 10x6", copied(sorted((FACES / "imm").glob("*.jpg")), "{stem}.jpg"))
        yield Case("none", "one person", copied(sorted((FACES / "imm").glob("03*.jpg")), "{stem}.jpg"))
        yield Case("none", "a talking face", frames("franck*", 10, 16))
        yield Case("none", "a turning head", frames("asynchronousx*", 6, 12))
        yield Case("none", "a film with cuts", frames("hamilton*", 12, 9))
    wall = made.texture(240, 320, 5)
    yield Case(
        "none",
        "exposures",
        lambda f: [
            [
                made.write(f / f"DSC_{k}.jpg", np.clip(wall * 2.0**e, 0, 255).astype(np.uint8))
                for k, e in enumerate((-2, -1, 0, 1, 2))
            ],
            f,
        ][1],
    )
    yield Case(
        "none",
        "rotations",
        lambda f: [
            [
                made.write(f / f"r{k}.png", cv2.warpAffine(wall, cv2.getRotationMatrix2D((160, 120), 15 * k, 1), (320, 240)))
                for k in range(8)
            ],
            f,
        ][1],
    )
    yield Case(
        "none",
        "zoom",
        lambda f: [
            [
                made.write(f / f"z{k}.png", cv2.warpAffine(wall, cv2.getRotationMatrix2D((160, 120), 0, 1.15**k), (320, 240)))
                for k in range(8)
            ],
            f,
        ][1],
    )
    yield Case(
        "none",
        "map tiles",
        lambda f: [
            [
                made.write(f / f"15_{y}_{x}.png", made.texture(512, 512, 8)[128 * y : 128 * y + 128, 128 * x : 128 * x + 128])
                for y, x in product(range(4), range(4))
            ],
            f,
        ][1],
    )
    yield Case("none", "icons", lambda f: [[made.write(f / f"icon{k}.png", made.texture(16, 16, k)) for k in range(12)], f][1])
    yield Case(
        "none", "two scenes below", lambda f: [[made.write_grid(f / s, made.views(3, 3)) for s in ("garden", "kitchen")], f][1]
    )
    yield Case(
        "none",
        "two scenes with the same names, of other sizes",
        lambda f: [[made.write_grid(f / s, made.views(3, 3, px, px)) for s, px in (("garden", 96), ("kitchen", 128))], f][1],
    )
    for name, start in {
        "a.heic": b"\0\0\0\x18ftypheic",
        "IMG_1.jpg": b"\0\0\0\x18ftypheic",
        "a.avif": b"\0\0\0\x18ftypavif",
        "a.CR2": b"II*\0\x10\0\0\0CR",
        "a.dng": b"II*\0",
        "a.nef": b"MM\0*",
        "a.psd": b"8BPS",
        "a.pdf": b"%PDF-1.4",
        "a.jxl": b"\xff\x0a",
        "a.exr": b"v/1\x01",
        "a.svg": b"<svg",
        "a.docx": b"PK",
    }.items():
        yield Case("none", f"{name} ({start[:3]!r})", stub(name, start))
    yield Case(
        "none",
        "folder of HEIC",
        lambda f: [[(f / f"IMG_{k}.HEIC").write_bytes(b"\0\0\0\x18ftypheic" + b"\0" * 99) for k in range(9)], f][1],
    )
    yield Case("none", "text files", lambda f: [[(f / f"n{k}.txt").write_text("x") for k in range(9)], f][1])
