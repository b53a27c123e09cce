"""Hostile scenes through the packer's door: each is refused by name or opens, with little memory;
no traceback, no hang.

Many of them go through one process, which has the packer's limits.
"""

import io
import json
import os
import random
import re
import shutil
import struct
import sys
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import scipy.io

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.host.files import MemoryLimit
from lfpipe.scene import layouts
from lfpipe.scene.analysis import analyse_scene
from lfpipe.scene.packer import MEMORY_BYTES
from lfpipe.scene.packing import pack_scene
from tests.scene import heic, made
from tests.scene.test_pictures import PORTRAIT, jpeg, mpo
from tests.scene.test_poses import posed
from tests.scene.writers import (
    HCI,
    Make,
    film,
    gif,
    grid,
    h5,
    one,
    stanford,
    together,
)
from tests.support.hostile_files import (
    NO_FILES,
    PEAK_MB,
    at,
    damaged_bytes,
    ended,
    jpeg_claiming,
    png_of,
)
from tests.support.stereo_files import DISPARITY, indexed

CHECKOUT = Path(__file__).parents[2]
GRID = made.views(3, 3, 32, 40)
FRAME = made.mosaic(made.views(2, 3, 64, 80))
FLAT = np.ones((32, 40), np.float32)
DEPTH = 10 / (made.middle_disparity(32, 40) + 3)
PARAMETERS = (
    "[extrinsics]\nnum_cams_x = 3\nnum_cams_y = 3\nbaseline_mm = 25\nfocus_distance_m = 4.25\n"
)


def hci(**parameters: str) -> Make:
    text = PARAMETERS
    for key, value in parameters.items():
        text = re.sub(f"{key} = .*", f"{key} = {value}", text)
    truth = partial(made.write, rgb=made.middle_disparity(32, 40))
    return together(grid(GRID, HCI, parameters_cfg=text), at("gt_disp_lowres.pfm", truth))


def old_hci(name: str = "lf.h5", values: np.ndarray = GRID[:, ::-1], **options: Any) -> Make:
    return h5(values, name, depth=DEPTH.astype(np.float32), **options)


def saved(save: Callable[..., None], *values: Any, **more: Any) -> bytes:
    file = io.BytesIO()
    save(file, *values, **more)
    return file.getvalue()


ARRAY = saved(np.save, GRID)


SCENES: dict[str, Make] = {
    "hci": hci(),
    "hci-old": old_hci(),
    "stanford": stanford(GRID, "out_{r:02d}_{c:02d}_{y:.3f}_{x:.3f}_.png"),
    "mat": together(
        lambda folder: scipy.io.savemat(folder / "a.mat", {"LF": GRID}, do_compression=True)
    ),
    "mat 7.3": old_hci("a.mat", GRID.transpose(), chunks=(1, 40, 32, 3, 3), compression="gzip"),
    **{
        f"views, {end}": grid(GRID, "view_{r:02d}_{c:02d}." + end)
        for end in ("png", "jpg", "tif", "webp")
    },
    **{name: one(name, FRAME) for name in ("atlas.png", "a_qs3x2.png", "a_eslf.png")},
    **{
        f"film, {end}": film([FRAME] * 2, f"film.{end}", codec)
        for end, codec in (("mkv", "FFV1"), ("avi", "MJPG"), ("mp4", "mp4v"))
    },
    "numbered": grid(GRID[:1], "v{n}.png"),
    "portrait": one("a.jpg", PORTRAIT),
    "pair": one("a.mpo", mpo(GRID[0, 0], GRID[0, 1])),
    "wiggle": gif(GRID[0]),
    "poses": lambda folder: posed(folder, GRID, range(9)),
    "described": together(
        grid(GRID), one("lightfield.toml", b"[scene]\ngrid = '3x3'\ngamma = 2.2\n")
    ),
    "index of pictures": one(
        "b.mpo", indexed([jpeg(view) for view in GRID[0, :2]], [DISPARITY] * 2)
    ),
    "spatial": lambda folder: heic.write(folder / "x.heic", list(GRID[0, :2]), (b"ster", 1, 2)),
    "array": one("v.npy", ARRAY),
}


def beside(make: Make, name: str, size: int) -> Make:
    """A scene in which one file has that size, without any bytes."""
    return together(make, one(name, b""), at(name, partial(os.truncate, length=size)))


def replaced(old: bytes, new: bytes, codec: str) -> Make:
    """A film in which some bytes are others."""

    def make(folder: Path) -> Path:
        path = film([FRAME] * 2, "film.avi", codec)(folder)
        assert old in path.read_bytes()
        path.write_bytes(path.read_bytes().replace(old, new))
        return path

    return make


def chained_links(folder: Path) -> Path:
    with h5py.File(folder / "lf.h5", "w") as file:
        file["away"] = h5py.ExternalLink("../secret.h5", "LF")
        file["LF"] = h5py.SoftLink("/away")
    return folder


def virtual(folder: Path) -> Path:
    layout = h5py.VirtualLayout(GRID.shape, GRID.dtype)
    layout[:] = h5py.VirtualSource(str(folder.parent / "secret.h5"), "LF", GRID.shape)
    with h5py.File(folder / "lf.h5", "w") as file:
        file.create_virtual_dataset("LF", layout)
    return folder


def chunk_bomb(folder: Path) -> Path:
    """A chunk of 34 kB as 0.5 MB that unpacks to 0.5 GB."""
    with h5py.File(folder / "lf.h5", "w") as file:
        data = file.create_dataset(
            "LF", GRID.shape, np.uint8, chunks=GRID.shape, compression="gzip"
        )
        engine = zlib.compressobj(6)
        head, part = engine.compress(b""), engine.compress(bytes(1 << 24))
        part += engine.flush(zlib.Z_FULL_FLUSH)
        packed = head + 32 * part + b"\3\0" + ((32 << 24) % 65521 << 16 | 1).to_bytes(4)
        data.id.write_direct_chunk((0,) * 5, packed)
    return folder


def array_of(*shape: int) -> Make:
    """Claims to hold so many values."""
    return together(
        lambda f: h5py.File(f / "lf.h5", "w").create_dataset("LF", shape, np.uint8).file.close()
    )


ARRAYS = {  # and the message about each
    "short.npy": (ARRAY[:500], r"short\.npy"),
    "cut.npy": (ARRAY[:50], r"cut\.npy"),
    "empty.npy": (b"", r"empty\.npy"),
    "objects.npy": (saved(np.save, np.array([{"a": 1}], object)), r"objects\.npy"),
    "nan.npy": (saved(np.save, np.full((1, 2, 64, 64), np.nan, np.float32)), "contains NaN"),
    "text.npz": (b"PK\3\4 nothing", r"text\.npz"),
    "other.npz": (saved(np.savez, a=np.zeros(3), b=np.zeros(3)), "no array 'views'"),
    "small.npz": (saved(np.savez, views=np.zeros(3)), "axes of sizes"),
}
SMALL_JPEG = cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1].tobytes()
FRAME_HEADER = b"\xff\xc0\x00\x11\x08"
HUGE = 2 << 40
PLAYLIST = b"#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nfilm.avi\n#EXT-X-ENDLIST\n"
# and what is said of it: nothing where a number that cannot be is passed over
ATTACKS: dict[str, tuple[Make, str]] = {
    "far too many columns": (hci(num_cams_x="1e18"), "^$"),
    "many cameras": (hci(num_cams_x="10000"), "views"),
    "focus": (hci(focus_distance_m="nan"), "^$"),
    "far cameras": (stanford(GRID, "out_{r:02d}_{c:02d}_1e308_-1e308_.png"), "^$"),
    "true disparity": (
        together(hci(), at("gt_disp_lowres.pfm", partial(made.write, rgb=3e8 * FLAT))),
        r"up to 3e\+08 px",
    ),
    **{
        f"2 TB, {name}": (beside(hci(), name, HUGE), name)
        for name in ("input_Cam004.png", "parameters.cfg", "gt_disp_lowres.pfm")
    },
    **{
        f"2 TB, {name}": (beside(together(), name, HUGE), name)
        for name in ("lf.h5", "a.mat", "film.mkv")
    },
    **{name: (one(name, data), said) for name, (data, said) in ARRAYS.items()},
    "JPEG": (one("a.jpg", jpeg_claiming(SMALL_JPEG, 20_000, 20_000)), "20000x20000"),
    "PNG, whole": (lambda f: one("a.png", png_of(16_384, 16_384))(f), "16384x16384"),
    "HDF5, large views": (array_of(9, 9, 40_000, 40_000, 3), "views have 40000x40000"),
    "HDF5, no end": (array_of(1, 2**40, 32, 32, 3), r"lf\.h5"),
    "HDF5, truncated": (
        together(lambda f: os.truncate(old_hci()(f), 4000)),
        "not a readable HDF5 file",
    ),
    "HDF5 bomb": (chunk_bomb, "bytes are stored for"),
    "chain of links": (chained_links, "stored in another"),
    "virtual data set": (virtual, "stored in another"),
    "film, header": (
        replaced(struct.pack("<II", 240, 128), struct.pack("<II", 9000, 9000), "FFV1"),
        "9000x9000",
    ),
    "film, frames": (
        replaced(
            FRAME_HEADER + struct.pack(">HH", 128, 240), FRAME_HEADER + b"\x4e\x20\x4e\x20", "MJPG"
        ),
        r"film\.avi",
    ),
    "playlist": (
        lambda f: [film([FRAME] * 2, "film.avi")(f), one("list.mp4", PLAYLIST)(f)][1],
        "not a readable video",
    ),
}


def opened(path: Path, scene: config.Scene) -> str:
    """What lfpipe says of a scene, "" where it opens."""
    try:
        source = analyse_scene(path, scene).source
        for place in {(0, 0), (source.rows // 2, source.cols // 2)} - source.missing:
            assert source.read(0, *place).shape[:2] == (source.height_px, source.width_px)
    except UserError as error:
        assert error.message and error.remedy
        return str(error)
    return ""


NUMBERS = (
    "0",
    "-1",
    "1e18",
    "1e-300",
    "-1e308",
    "1e400",
    "nan",
    "inf",
    "9" * 400,
    "99999",
    "0x10",
    "",
    "x",
    "\x1b[2J",
    "\n",
    "٣",
)


def damage(rng: random.Random, folder: Path) -> None:
    """Does something to one file of a scene: to its bytes, to numbers in its bytes, text or name,
    or puts no file in its place.
    """
    whole = [path for path in folder.rglob("*") if path.is_file() and not path.is_symlink()]
    files = sorted(path for path in whole if path.stat().st_size < 10_000_000)
    if not files:
        return
    path = rng.choice(files)
    data = path.read_bytes()
    head = rng.choice((200, 10**9))
    numbers = list(re.finditer(rb"-?\d+(\.\d+)?(e[+-]?\d+)?", data[:2000]))
    start, end = rng.choice(numbers).span() if numbers else (0, 0)
    new = re.sub(r"\d+", lambda part: rng.choice((part[0], *NUMBERS, "\udcff"))[:40], path.name)
    kind = rng.randrange(5)
    if kind <= 1:
        path.write_bytes(damaged_bytes(rng, data[:head]) + data[head:])
    elif kind == 2:
        path.write_bytes(data[:start] + rng.choice(NUMBERS).encode() + data[end:])
    elif kind == 3:
        path.rename(path.with_name(new or "x"))
    else:
        # of 4 GB as much is read as a TIFF may have
        NO_FILES[rng.choice(sorted(set(NO_FILES) - {"directory", "4 GB"}))](path)


def all_attacks(base: Path) -> dict[str, str]:
    """For the process of the test below: what is said of each attack."""
    with h5py.File(base / "secret.h5", "w") as file:
        file["LF"] = GRID
    said = {}
    for name, (make, _) in ATTACKS.items():
        (base / name).mkdir()
        said[name] = opened(make(base / name), config.Scene())
    return said


def all_damage(base: Path) -> dict[str, str]:
    """For the process of the test below: the messages about damaged scenes, opened with any
    setting. Whatever they are, no file is left beside them.
    """
    said = {}
    for name, seed in ((name, seed) for name in SCENES for seed in range(5)):
        rng = random.Random(f"{name} {seed}")
        folder = base / "scene"
        folder.mkdir()
        SCENES[name](folder)
        for _ in range(rng.choice((1, 1, 2))):
            damage(rng, folder)
        layout = "auto" if rng.random() < 0.8 else rng.choice(sorted(layouts.layouts()))
        grid = rng.choice(("",) * 12 + ("3x3", "1x1", "9999x9999", "100x200"))
        path = next((path for path in folder.iterdir() if path.name.startswith("film.")), folder)
        print(name, seed, file=sys.stderr, flush=True)  # the last one is the culprit
        before = sorted(folder.rglob("*"))
        said[f"{name} {seed}"] = opened(path, config.Scene(layout=layout, grid=grid))
        assert sorted(folder.rglob("*")) == before
        shutil.rmtree(folder)
    return said


def in_the_packer(what: str, base: Path) -> dict[str, str]:
    """The answer of a function of this file, from a process with the packer's limit of memory."""
    code = f"from tests.scene import test_hostile; test_hostile.answer({what!r}, {str(base)!r})"
    done, out, err, peak_mb = ended([sys.executable, "-c", code], timeout_s=110, cwd=CHECKOUT)
    assert done == 0, err[-2000:]
    assert peak_mb < PEAK_MB
    return dict(json.loads(out))


def answer(what: str, base: str) -> None:
    with MemoryLimit(MEMORY_BYTES):
        print(json.dumps(globals()[what](Path(base))))


def test_attacks_are_refused_by_name_with_little_memory(tmp_path: Path) -> None:
    said = in_the_packer("all_attacks", tmp_path)
    assert [name for name, (_, word) in ATTACKS.items() if not re.search(word, said[name])] == []


def test_damaged_scenes_are_refused_or_open_with_little_memory(tmp_path: Path) -> None:
    said = list(in_the_packer("all_damage", tmp_path).values())
    assert 10 < said.count("") < len(said) - 10  # some damage is harmless, and some is not


def test_the_command_refuses_with_code_2_and_escapes_what_a_terminal_obeys(tmp_path: Path) -> None:
    folder = made.write_grid(tmp_path / "a\x1b[2Jb", GRID)
    (folder / "view_01_01.png").write_text("none")
    command = [
        sys.executable,
        "-m",
        "lfpipe",
        "scene",
        "info",
        str(folder),
        "--set",
        f"scene.cache_dir={tmp_path / 'cache'}",
    ]
    code, out, err, peak_mb = ended(command)
    assert (code, out) == (2, "") and "Traceback" not in err and peak_mb < PEAK_MB
    assert "a\\x1b[2Jb/view_01_01.png" in err and "\x1b[2J" not in err


@pytest.mark.timeout(60)
@pytest.mark.parametrize("kind", ["fifo", "endless device"])
def test_what_is_no_file_neither_blocks_nor_is_read(tmp_path: Path, kind: str) -> None:
    for name in ("input_Cam004.png", "parameters.cfg", "gt_disp_lowres.pfm"):
        (tmp_path / name).mkdir()
        hci()(tmp_path / name)
        NO_FILES[kind](tmp_path / name / name)
        assert name in opened(tmp_path / name, config.Scene())
    for name in ("scene", "lf.h5", "a.mat", "film.mkv", "a.png"):
        (tmp_path / "alone").mkdir(exist_ok=True)
        NO_FILES[kind](tmp_path / "alone" / name)
        for layout in ("auto", *layouts.layouts()):
            assert "neither a file nor a folder" in opened(
                tmp_path / "alone" / name, config.Scene(layout=layout)
            )


def test_paths_of_any_bytes_work(tmp_path: Path, scene_config: config.Scene) -> None:
    for name in (b"\xff\xfe", b"sc\xe9ne", "日本".encode(), b"a b;'\"", b"\x1b[2J\x07"):
        # OpenCV alone crashes at such a path
        base = made.write_grid(tmp_path / "x", GRID).rename(tmp_path / os.fsdecode(name))
        beside = (
            film([FRAME] * 2, "x.mkv", "FFV1"),
            one("x.png", GRID[0, 0]),
            h5(GRID, "x.h5"),
            h5(GRID.transpose(), "x.mat"),
        )
        written = [make(tmp_path) for make in beside]
        paths = [path.rename(base.with_name(base.name + path.suffix)) for path in written]
        rows = [analyse_scene(path, config.Scene()).source.rows for path in (base, *paths)]
        assert rows == [3, 2, 1, 3, 3]
    pack_scene(base, config.Scene(cache_dir=scene_config.cache_dir + os.fsdecode(b"-\xff")))


@pytest.mark.parametrize("name", ["", "view_01_01.png"])
def test_permissions_are_named(tmp_path: Path, as_nobody: list[str], name: str) -> None:
    locked = made.write_grid(tmp_path / "views", GRID) / name
    locked.chmod(0o444 if locked.is_dir() else 0)
    words = ["-m", "lfpipe", "scene", "info", str(tmp_path / "views")]
    code, _, err, _ = ended([*as_nobody, sys.executable, *words])
    locked.chmod(0o755)
    assert code == 2 and str(locked) in err and "cannot be read: Permission denied" in err
