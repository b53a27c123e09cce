"""Small scenes of every layout and format, and what may be wrong with them, made from a seed.

Plain functions of `random.Random` and of paths, so that tests and attack harnesses share them.
"""

import os
import random
import re
import struct
from collections.abc import Callable
from pathlib import Path

import cv2
import h5py
import numpy as np
import scipy.io

from tests.hostile_files import NO_FILES, damaged_bytes
from tests.scene import made

GRID = made.views(3, 3, 32, 40)
PARAMETERS = (
    "[intrinsics]\nfocal_length_mm = 100\nimage_resolution_x_px = 40\nimage_resolution_y_px = 32\nsensor_size_mm = 35\n"
    "[extrinsics]\nnum_cams_x = 3\nnum_cams_y = 3\nbaseline_mm = 25\nfocus_distance_m = 4.25\n"
)
NUMBERS = (
    "0", "-1", "1e18", "1e-300", "1e307", "-1e308", "1e400", "nan", "inf", "9" * 400, "99999", "0x10", "1_0", "", "x", "3e38",
)  # fmt: skip
INTEGERS = (0, 1, 255, 20_000, 65_535, 1 << 24, (1 << 31) - 1, 1 << 31, (1 << 32) - 1, 1 << 40, (1 << 63) - 1)


def hci(folder: Path) -> None:
    """Views, parameters and true disparity."""
    made.write_grid(folder, GRID, "input_Cam{n:03d}.png")
    (folder / "parameters.cfg").write_text(PARAMETERS)
    made.write_pfm(folder / "gt_disp_lowres.pfm", made.middle_disparity(32, 40))


def hci_text(folder: Path) -> None:
    """The first HCI data set as text."""
    made.write_grid(folder / "lf", GRID, "{r:02d}_{c:02d}.png")
    values = {"hRes": 3, "vRes": 3, "dH": 0.5, "shift": 3, "focalLength": 20}
    (folder / "attributes.dat").write_text("".join(f"{value:e} //{name}\n" for name, value in values.items()))
    (folder / "depth.bin").write_bytes((10 / (made.middle_disparity(32, 40) + 3)).astype("<f4").tobytes())


def hci_old(folder: Path, **options: object) -> None:
    """The first HCI data set as HDF5."""
    with h5py.File(folder / "lf.h5", "w") as file:
        file.create_dataset("LF", data=GRID[:, ::-1], **options)
        file.attrs.update({"dH": 0.5, "focalLength": 20.0, "shift": 3.0})
        file["GT_DEPTH"] = np.broadcast_to((10 / (made.middle_disparity(32, 40) + 3)).astype(np.float32), (3, 3, 32, 40))


def stanford(folder: Path) -> None:
    """Camera coordinates in the names."""
    for r in range(3):
        for c in range(3):
            made.write(folder / f"out_{r:02d}_{c:02d}_{-300 - 8.5 * r:.3f}_{1100 - 8.6 * c:.3f}_.png", GRID[r, c])


def jpeg_pleno(folder: Path) -> None:
    """10-bit PPM."""
    for r in range(3):
        for c in range(3):
            made.write_ppm(folder / f"{r:03d}_{c:03d}.ppm", GRID[r, c].astype(np.uint16) * 4, 1023)


def matlab(folder: Path) -> None:
    """A compressed .mat file of the old kind."""
    scipy.io.savemat(folder / "a.mat", {"LF": GRID}, do_compression=True)


def matlab_73(folder: Path) -> None:
    """A .mat file that is HDF5."""
    with h5py.File(folder / "a.mat", "w", userblock_size=512) as file:
        file.create_dataset("LF", data=GRID.transpose(), chunks=(1, 40, 32, 3, 3), compression="gzip")


def film(folder: Path, end: str, codec: str) -> None:
    """A light-field video of one file."""
    frame = made.mosaic(made.views(2, 3, 64, 80))
    writer = cv2.VideoWriter(str(folder / f"film.{end}"), cv2.VideoWriter.fourcc(*codec), 12.0, (frame.shape[1], frame.shape[0]))
    for _ in range(2):
        writer.write(frame)
    writer.release()


def pictures(end: str) -> Callable[[Path], None]:
    """A grid of picture files of one format."""
    return lambda folder: void(made.write_grid(folder, GRID, "view_{r:02d}_{c:02d}." + end))


def one(name: str) -> Callable[[Path], None]:
    """A mosaic of views under some name."""
    return lambda folder: made.write(folder / name, made.mosaic(made.views(2, 3, 64, 80)))


def void(_: object) -> None:
    """Nothing."""


SCENES: dict[str, Callable[[Path], None]] = {
    "hci": hci, "hci-text": hci_text, "hci-old": hci_old, "stanford": stanford, "jpeg-pleno": jpeg_pleno,
    "hci-old in chunks": lambda folder: hci_old(folder, chunks=(1, 1, 32, 40, 3), compression="gzip"),
    "mat": matlab, "mat 7.3": matlab_73,
    **{f"views, {end}": pictures(end) for end in ("png", "jpg", "bmp", "tif", "webp", "ppm")},
    "mosaic": one("atlas.png"), "mosaic, jpg": one("atlas.jpg"), "quilt": one("a_qs3x2.png"), "eslf": one("a_eslf.png"),
    "film, mkv": lambda folder: film(folder, "mkv", "FFV1"), "film, avi": lambda folder: film(folder, "avi", "MJPG"),
    "film, mp4": lambda folder: film(folder, "mp4", "mp4v"),
    "numbered": lambda folder: void(made.write_grid(folder, GRID[:1], "v{n}.png")),
}  # fmt: skip


def scene_path(folder: Path) -> Path:
    """What is given to lfpipe: the folder, or the video in it."""
    return next((path for path in folder.iterdir() if path.name.startswith("film.")), folder)


def damage(rng: random.Random, folder: Path) -> str:
    """Does something to one file of a scene; says what."""
    files = [path for path in folder.rglob("*") if path.is_file() and not path.is_symlink() and path.stat().st_size < 10_000_000]
    if not files:
        return "nothing"
    path = rng.choice(sorted(files))
    kind = rng.choice(("bytes", "start", "integer", "number", "name", "no file", "claim"))
    data = path.read_bytes()
    if kind == "bytes":
        path.write_bytes(damaged_bytes(rng, data))
    elif kind == "start":
        path.write_bytes(damaged_bytes(rng, data[:200]) + data[200:])
    elif kind == "integer":
        form = rng.choice(("<H", ">H", "<I", ">I", "<Q", ">Q"))
        value = rng.choice(INTEGERS) & ((1 << 8 * struct.calcsize(form)) - 1)
        at = rng.randrange(min(len(data), rng.choice((100, 1000, 10**9)))) if data else 0
        path.write_bytes(data[:at] + struct.pack(form, value) + data[at + struct.calcsize(form) :])
    elif kind == "number":
        found = list(re.finditer(rb"-?\d+(\.\d+)?(e[+-]?\d+)?", data[:2000]))
        if found:
            spot = rng.choice(found)
            path.write_bytes(data[: spot.start()] + rng.choice(NUMBERS).encode() + data[spot.end() :])
    elif kind == "name":
        new = re.sub(r"\d+", lambda part: rng.choice((part[0], *NUMBERS, "\x1b[2J", "\udcff", "\n", "٣"))[:40], path.name)
        path.rename(path.with_name(new or "x"))
    elif kind == "no file":
        word = rng.choice(sorted(set(NO_FILES) - {"directory"}))
        NO_FILES[word](path)
        kind = word
    else:
        for _ in range(3):
            at = rng.randrange(max(1, len(data) - 8))
            data = data[:at] + rng.randbytes(rng.randrange(1, 8)) + data[at:]
        path.write_bytes(data)
    return f"{kind} of {os.fsencode(path.name)!r}"
