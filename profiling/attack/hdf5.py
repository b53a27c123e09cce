"""HDF5 and MATLAB files with hostile shapes, types, links and attributes."""

import contextlib
import random
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.io

SHAPES: tuple[tuple[int, ...], ...] = (
    (), (0,), (3, 3), (3, 3, 24, 32), (3, 3, 24, 32, 1), (3, 3, 24, 32, 2), (3, 3, 24, 32, 4), (3, 3, 24, 32, 5),
    (0, 3, 24, 32, 3), (3, 3, 0, 0, 3), (9, 9, 20_000, 20_000, 3), (1, 1, 20_000, 20_000, 3), (20_000, 20_000, 24, 32, 3),
    (1, 1, 1, 1, 1), (100, 100, 1, 1, 3), (2**31, 1, 1, 1, 3), (3, 3, 24, 32, 3, 1), (3, 32, 24, 3, 3), (1,) * 30,
    (1, 1, 30_000, 30_000),
)  # fmt: skip
TYPES: tuple[Any, ...] = (
    "u1", ">u2", "<u4", "u8", "i1", "<i8", "<f2", "<f4", ">f8", "?", "c16", "S5", [("a", "u1"), ("b", "f4")],
    h5py.string_dtype(), h5py.vlen_dtype(np.uint8),
)  # fmt: skip
KEYS = ("LF", "LF", "LF", "lf", "LightField", "GT_DEPTH", "other")
VALUES: tuple[Any, ...] = (
    0.0, float("nan"), float("inf"), 1e307, 1e-320, -1.0, 2**63, "text", b"\xff", [], [1.0, 2.0], np.zeros((2, 2)), True,
    h5py.Empty("f4"),
)  # fmt: skip


def _place(rng: random.Random, file: Any, key: str) -> None:
    """Puts something at key."""
    match rng.randrange(9):
        case 0:
            file[key] = rng.choice((h5py.SoftLink(f"/{key}"), h5py.SoftLink("/nowhere"), h5py.SoftLink("/")))
        case 1:
            file[key] = h5py.ExternalLink(rng.choice(("/etc/passwd", "../x.h5", "\xff")), "LF")
        case 2:
            file.create_group(key)["LF"] = np.zeros(3)
        case 3:
            layout = h5py.VirtualLayout((3, 3, 24, 32, 3), "u1")
            layout[:] = h5py.VirtualSource(rng.choice((".", "/dev/zero", "other.h5")), "LF", (3, 3, 24, 32, 3))
            file.create_virtual_dataset(key, layout)
        case 4:
            file.create_dataset(key, (3, 3, 24, 32, 3), "u1", external=[("/dev/zero", 0, h5py.h5f.UNLIMITED)])
        case 5 | 6:
            shape = rng.choice(SHAPES)
            file.create_dataset(
                key, shape, rng.choice(TYPES), **({"chunks": True, "compression": "gzip"} if shape and 0 not in shape else {})
            )
        case 7:
            values = np.full((3, 3, 24, 32, 3), rng.choice((np.nan, np.inf, -1.0, 1e30, 0.5)), rng.choice(("<f4", "<f8", "<f2")))
            file[key] = values
        case _:
            chunk = rng.choice(((1, 1, 4096, 4096, 3), (1, 1, 8192, 8192, 3)))  # a kilobyte that unpacks to a hundred megabytes
            made = file.create_dataset(key, (3, 3, *chunk[2:]), "u1", chunks=chunk, compression="gzip", compression_opts=9)
            if rng.random() < 0.1:
                made[0, 0] = 7


def damaged_hdf5(rng: random.Random, path: Path) -> None:
    """An array file with something else in it; where it is no HDF5, a new one takes its place."""
    if path.suffix == ".mat" and rng.random() < 0.5:
        return _mat(rng, path)
    with (
        contextlib.suppress(OSError, ValueError, TypeError, RuntimeError, KeyError),
        h5py.File(path, "a" if h5py.is_hdf5(path) else "w") as file,
    ):
        for key in list(file):
            if rng.random() < 0.6:
                del file[key]
        for name in ("dH", "focalLength", "shift", "hRes"):
            if rng.random() < 0.4:
                file.attrs[name] = rng.choice(VALUES)
        key = rng.choice(KEYS)
        if key in file:
            del file[key]
        _place(rng, file, key)
    return None


def _mat(rng: random.Random, path: Path) -> None:
    """A file of MATLAB 5 with another kind of LF."""
    things: tuple[Any, ...] = (
        np.zeros((3, 3, 24, 32, 3), rng.choice(("u1", "<u2", "<f4", "<i4", "c16"))), np.array(["a", "b"], object), {"a": 1.0},
        "text", np.zeros((0, 0)), np.full((3, 3, 24, 32), np.nan), np.zeros((300, 300), np.uint8),
        np.zeros((1, 1, 6000, 6000), np.uint8), np.full((3, 3, 24, 32, 3), 1e308),
    )  # fmt: skip
    scipy.io.savemat(path, {rng.choice(KEYS): rng.choice(things)}, do_compression=rng.random() < 0.5)


def hostile_array_file(rng: random.Random, scene: Path) -> None:
    """One more file beside the views, of a layout that takes precedence."""
    path = scene / rng.choice(("lf.h5", "a.mat"))
    path.touch()
    damaged_hdf5(rng, path)
