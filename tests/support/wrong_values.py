"""Valid files of every kind that lfpipe reads, with wrong values in their structure: sizes, counts,
offsets and kinds, not noise. Each is read in a process of its own, as the packer would.

`python -m tests.support.wrong_values 10000` tries so many, and prints what came of them by kind.
"""

import argparse
import faulthandler
import io
import json
import os
import random
import re
import resource
import shutil
import signal
import struct
import sys
import tempfile
import time
import traceback
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import scipy.io
from PIL import Image

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.host.limits import MemoryLimit
from lfpipe.scene.packer import MEMORY_BYTES
from lfpipe.scene.packing import pack_scene
from lfpipe.sequence.folder import FILES
from tests.scene import heic, made
from tests.support import hostile_files, hostile_sequences
from tests.support.films import write_film
from tests.support.stereo_files import DISPARITY, described, indexed

VIEWS = made.views(2, 2, 48, 64)
LEFT, RIGHT = made.views(1, 2, 96, 128, 4.0, -2.0)[0]
CPU_S = 20  # of one input
HUGE = (0, 1, 2, 3, 7, 8, 127, 128, 255, 256, 32767, 65535, 8192, 65536, 1 << 24)
WIDE = (
    *HUGE,
    (1 << 31) - 1,
    1 << 31,
    (1 << 32) - 1,
    1 << 32,
    1 << 40,
    (1 << 63) - 1,
    (1 << 64) - 1,
)
Fields = Iterator[tuple[int, int]]  # where there are numbers: (begin, end)


def jpeg_fields(data: bytes) -> Fields:
    """The bodies of the segments of all JPEGs in data."""
    for match in re.finditer(rb"\xff[\xc0-\xcf\xda-\xdf\xe0-\xef](..)", data, re.DOTALL):
        length = int.from_bytes(match[1])
        if length < 4000:
            yield match.start() + 2, match.start() + 2 + length


def png_fields(data: bytes) -> Fields:
    at = 8
    while at + 8 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        if kind != b"IDAT":
            yield at + 8, at + 8 + length
        at += 12 + length


def box_fields(data: bytes) -> Fields:
    """The beginnings of the boxes of a file of boxes (AVIF, HEIC, MP4)."""
    for match in re.finditer(
        rb"ftyp|meta|hdlr|pitm|iloc|iinf|infe|iprp|ipco|ipma|ispe|pixi|av1C|hvcC|colr|grpl|ster"
        rb"|mvhd|tkhd|mdhd|stsd|stts|stsz|stsc|stco|avc1|mp4v|esds|iref",
        data,
    ):
        yield match.start() - 4, min(len(data), match.end() + 48)


def tiff_fields(data: bytes) -> Fields:
    order = "<" if data[:2] == b"II" else ">"
    at = struct.unpack_from(order + "I", data, 4)[0]
    count = struct.unpack_from(order + "H", data, at)[0]
    yield 4, 8
    yield at, at + 2 + 12 * count + 4


def head_fields(most: int, data: bytes) -> Fields:
    yield 4, min(most, len(data))


def riff_fields(data: bytes) -> Fields:
    for match in re.finditer(rb"RIFF|VP8.|ANIM|ANMF|ALPH|avih|strh|strf|indx|idx1|movi|00dc", data):
        yield match.end(), min(len(data), match.end() + 40)


def matroska_fields(data: bytes) -> Fields:
    for match in re.finditer(
        rb"\x16\x54\xae\x6b|\xae|\xe0|\xb0|\xba|\x1f\x43\xb6\x75", data[:2000]
    ):
        yield match.end(), min(len(data), match.end() + 12)


def with_wrong_number(rng: random.Random, data: bytes, fields: list[tuple[int, int]]) -> bytes:
    """data with one number in one of these places changed."""
    begin, end = rng.choice(fields or [(0, len(data))])
    size = rng.choice((1, 2, 4, 4, 8))
    at = rng.randrange(begin, max(begin + 1, end - size + 1))
    order = rng.choice(("little", "big"))
    old = int.from_bytes(data[at : at + size], order)  # type: ignore[arg-type]
    new = rng.choice((*WIDE, old + 1, old - 1, old * 2, old // 2, old ^ 1)) % (1 << 8 * size)
    return data[:at] + new.to_bytes(size, order) + data[at + size :]  # type: ignore[arg-type]


def with_checksums(data: bytes) -> bytes:
    """A PNG whose checksums agree."""
    out = bytearray(data[:8])
    at = 8
    while at + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        body = data[at + 8 : at + 8 + length]
        out += hostile_files.png_chunk(kind, body)
        at += 12 + length
    return bytes(out)


def numbers_in(data: bytes, name: str) -> list[tuple[int, int]]:
    """Where a file has numbers, by its beginning."""
    if data.startswith(b"\xff\xd8"):
        return list(jpeg_fields(data))
    if data.startswith(b"\x89PNG"):
        return list(png_fields(data))
    if data[4:8] in (b"ftyp", b"moov", b"free"):
        return list(box_fields(data))
    if data.startswith((b"II*", b"MM\0")):
        return list(tiff_fields(data))
    if data.startswith(b"RIFF"):
        return list(riff_fields(data))
    if data.startswith(b"\x1aE"):
        return list(matroska_fields(data))
    return list(
        head_fields({".h5": 4000, ".mat": 1500, ".npy": 10}.get(Path(name).suffix, 60), data)
    )


def encoded(picture: np.ndarray, ending: str, *options: int) -> bytes:
    return bytes(cv2.imencode(ending, picture[..., ::-1], options)[1])


def by_pillow(kind: str, pictures: list[np.ndarray], **more: Any) -> bytes:
    file = io.BytesIO()
    first, *others = map(Image.fromarray, pictures)
    if others:
        more |= {"save_all": True, "append_images": others}
    first.save(file, kind, **more)
    return file.getvalue()


def numpy_file(**arrays: np.ndarray) -> bytes:
    file = io.BytesIO()
    if list(arrays) == ["alone"]:
        np.save(file, arrays["alone"])
    else:
        np.savez(file, allow_pickle=False, **arrays)
    return file.getvalue()


def matlab_file() -> bytes:
    file = io.BytesIO()
    cells = np.array([[np.arange(3.0)], ["text"]], dtype=object)
    scipy.io.savemat(file, {"LF": VIEWS, "LFMetadata": {"a": 1.0}, "cells": cells})
    return file.getvalue()


def hdf5_file(folder: Path, name: str, rng: random.Random) -> None:
    with h5py.File(folder / name, "w") as file:
        views = VIEWS if name.endswith("h5") else VIEWS.transpose()
        chunks = tuple(max(1, side // rng.choice((1, 2))) for side in views.shape)
        file.create_dataset("LF", data=views, chunks=chunks, compression="gzip")
        file["GT_DEPTH"] = np.ones((2, 2, 48, 64), np.float32)
        file.attrs.update(
            {"dH": rng.choice((0.5, np.nan, 1e308, "x", [1, 2])), "focalLength": 20.0}
        )
        if rng.random() < 0.3:
            raw = rng.choice((b"\xff\xfe", b"a\xc3", b" ", b"L" * 3000))
            h5py.h5g.create(file.id, raw)
        if rng.random() < 0.1:
            file.attrs["shift"] = np.array([b"\xff"], dtype="S1")


def cameras(rng: random.Random) -> str:
    frames = [
        {"file_path": f"images/{k}.png", "transform_matrix": np.eye(4).tolist()} for k in range(4)
    ]
    tree: Any = {"camera_angle_x": 0.7, "w": 64, "h": 48, "fl_x": 60.0, "frames": frames}
    for _ in range(rng.randrange(3)):
        tree = hostile_files.damaged_tree(rng, tree)
    return hostile_files.json_text(tree)


PAIR = [encoded(LEFT, ".jpg"), encoded(RIGHT, ".jpg")]
PROGRESSIVE = (cv2.IMWRITE_JPEG_PROGRESSIVE, 1)
ALPHA = np.dstack([LEFT, LEFT[..., 0]])


@cache
def whole_files() -> dict[str, bytes]:
    """A valid file of each kind, by name."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        bgr = [np.hstack([LEFT, RIGHT])[..., ::-1]] * 3
        films = {"f.mp4": "mp4v", "f.avi": "MJPG", "f.mkv": "FFV1"}
        made_films = {
            name: write_film(place / name, bgr, codec, 12.0).read_bytes()
            for name, codec in films.items()
        }
        spatial = heic.write(place / "x.heic", [LEFT, RIGHT], (b"ster", 1, 2)).read_bytes()
    return {
        "a.jpg": PAIR[0],
        "p.jpg": encoded(LEFT, ".jpg", *PROGRESSIVE),
        "turned.jpg": hostile_files.with_exif(PAIR[0], 6),
        "a.png": encoded(LEFT, ".png"),
        "alpha.png": by_pillow("PNG", [ALPHA]),
        "moving.png": by_pillow("PNG", [LEFT, RIGHT]),
        "a.tif": encoded(LEFT, ".tif"),
        "deflate.tif": by_pillow("TIFF", [LEFT, RIGHT], compression="tiff_deflate"),
        "a.webp": encoded(LEFT, ".webp"),
        "moving.webp": by_pillow("WEBP", [LEFT, RIGHT]),
        "a.avif": by_pillow("AVIF", [LEFT]),
        "moving.avif": by_pillow("AVIF", [LEFT, RIGHT]),
        "x.heic": spatial,
        "a.gif": by_pillow("GIF", [LEFT, RIGHT]),
        "a.bmp": encoded(LEFT, ".bmp"),
        "a.ppm": encoded(LEFT, ".ppm"),
        "x.mpo": indexed(PAIR, [DISPARITY] * 2),
        "numbered.mpo": indexed(PAIR, [DISPARITY] * 2, [2, 1]),
        "x.jps": described(encoded(np.hstack([LEFT, RIGHT]), ".jpg"), 2, 4),
        "v.npy": numpy_file(alone=VIEWS),
        "v.npz": numpy_file(views=VIEWS, disparity=np.zeros((2, 2, 48, 64), np.float32)),
        "old.mat": matlab_file(),
        **made_films,
    }


def file_of(name: str, rng: random.Random, folder: Path) -> Path:
    """One of those files with a few wrong numbers."""
    data = whole_files()[name]
    members = {"": data}
    if name.endswith(".npz"):
        with zipfile.ZipFile(io.BytesIO(data)) as held:
            members = {member: held.read(member) for member in held.namelist()}
    member = rng.choice(list(members))
    fields = numbers_in(members[member], name)
    for _ in range(rng.choice((1, 1, 2, 4))):
        if name.endswith((".npy", ".npz")) and rng.random() < 0.8:
            text = rng.choice(("2, 2", "48", "64", "3)", "|u1", "<f4", "False"))
            new = str(rng.choice((*WIDE, "-1", "()", "|O", "<U9", "1,", "True", "1e9"))).encode()
            members[member] = members[member].replace(text.encode(), new, 1)
        else:
            members[member] = with_wrong_number(rng, members[member], fields)
    path = folder / name
    if name.endswith(".npz"):
        with zipfile.ZipFile(path, "w") as out:
            for inner, body in members.items():
                out.writestr(inner, body)
    else:
        path.write_bytes(with_checksums(members[""]) if name.endswith(".png") else members[""])
    return path


def hdf5(name: str, rng: random.Random, folder: Path) -> Path:
    hdf5_file(folder, name, rng)
    path = folder / name
    if rng.random() < 0.7:
        fields = [(0, min(4000, path.stat().st_size))]
        path.write_bytes(with_wrong_number(rng, path.read_bytes(), fields))
    return path


NAMES = (
    "view_{}_{}.png",
    "input_Cam{:03}.png",
    "out_{}_{}_{}_{}_.png",
    "x_qs{}x{}a{}.png",
    "grid_{}x{}.png",
    "{}.png",
    "a_{}_{}_{}_{}.jpg",
    "frame{}f{}.png",
    "00{}_{}.ppm",
)
WORDS = (
    "0",
    "00",
    "-1",
    "1",
    "2",
    "9",
    "99",
    "100",
    "65536",
    "9" * 18,
    "9" * 40,
    "1e9",
    "0.0",
    "٣",
)


def names(rng: random.Random, folder: Path) -> Path:
    """Views whose names hold wrong numbers."""
    form = rng.choice(NAMES)
    for view in VIEWS.reshape(-1, 48, 64, 3)[: rng.choice((1, 2, 4, 4))]:
        made.write(folder / re.sub(r"\{[^}]*\}", lambda _: rng.choice(WORDS), form), view)
    inside = sorted(folder.iterdir())
    return inside[0] if rng.random() < 0.4 else folder


def described_folder(rng: random.Random, folder: Path) -> Path:
    """Views with files of values beside them."""
    made.write_grid(folder, VIEWS)
    settings = {"layout": "numbered", "grid": "2x2", "flip": "rows", "gamma": 2.2}
    key = rng.choice(list(settings))
    value = rng.choice((*hostile_files.TOML_TEXTS, "'0x0'", "'99999x1'", "'quilt'", "-1", "1e308"))
    (folder / "lightfield.toml").write_text(f"[scene]\n{key} = {value}\n")
    (folder / "transforms.json").write_text(cameras(rng), errors="replace")
    return folder


def benchmark(rng: random.Random, folder: Path) -> Path:
    made.write_grid(folder, VIEWS, "input_Cam{n:03d}.png")
    keys = ("num_cams_x", "num_cams_y", "baseline_mm", "focus_distance_m", "focal_length_mm")
    lines = [f"{key} = {rng.choice((2, 2, *WORDS))}" for key in keys]
    (folder / "parameters.cfg").write_text("[extrinsics]\n" + "\n".join(lines) + "\n")
    return folder


def poses(rng: random.Random, folder: Path) -> Path:
    for k in range(4):
        made.write(folder / "images" / f"{k}.png", VIEWS[divmod(k, 2)])
    (folder / "transforms.json").write_text(cameras(rng), errors="replace")
    return folder


def sequence(rng: random.Random, folder: Path) -> Path:
    path = hostile_sequences.made_sequence(folder / "seq")
    hostile_sequences.damage(rng, *(path / name for name in ("manifest.json", *FILES)))
    if rng.random() < 0.7:
        hostile_sequences.sign(path)
    return path


Make = Callable[[random.Random, Path], Path]


def kinds() -> dict[str, Make]:
    """What writes a wrong input into an empty folder, and returns the path to open."""
    return {
        **{name: partial(file_of, name) for name in whole_files()},
        **{name: partial(hdf5, name) for name in ("lf.h5", "new.mat")},
        "names": names,
        "lightfield.toml": described_folder,
        "parameters.cfg": benchmark,
        "transforms.json": poses,
        "sequence": sequence,
    }


def read(path: Path, cache_dir: Path) -> str:
    """What comes of opening path: "opened", "refused", or what went wrong."""
    try:
        if path.name == "seq":
            hostile_sequences.typed("check", path)
        else:
            pack_scene(path, config.Scene(cache_dir=str(cache_dir)))
    except UserError as error:
        if not (error.message and error.remedy):
            return f"a refusal without a remedy: {error}"
        return "refused"
    except MemoryError:
        return "refused"  # by the child's last resort
    return "opened"


def apart(work: Callable[[], str]) -> str:
    """What work returns in a process of its own with the packer's limits; or how that ends."""
    there, back = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(there)
        resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        faulthandler.disable()
        for output in (1, 2):  # what libraries print of damage
            os.dup2(os.open(os.devnull, os.O_RDWR), output)
        signal.alarm(6 * CPU_S)
        try:
            with MemoryLimit(MEMORY_BYTES):
                said = work()
        except BaseException:
            said = traceback.format_exc()
        os.write(back, said[-3000:].encode("utf-8", "backslashreplace"))
        os._exit(0)
    os.close(back)
    with os.fdopen(there, "rb") as pipe:
        said = pipe.read().decode()
    _, status, used = os.wait4(child, 0)
    code = os.waitstatus_to_exitcode(status)
    if code in (-signal.SIGSEGV, -signal.SIGABRT, -signal.SIGBUS, -signal.SIGFPE):
        return f"crashed inside a library (signal {-code})"  # which the packer's parent says
    peak_mb = used.ru_maxrss / 1024
    slow = " slowly" if used.ru_utime > CPU_S / 2 else ""
    return said + slow if code == 0 and peak_mb < 1400 else f"ended with {code}, {peak_mb:.0f} MB"


def tried(kind: str, seed: int, base: Path) -> str:
    """What comes of one wrong input. Whatever it is, it leaves no file."""
    rng = random.Random(f"{kind} {seed}")
    inside = base / "in"
    cache_dir = base / "cache"
    inside.mkdir()
    try:
        path = kinds()[kind](rng, inside)
        before = sorted(inside.rglob("*"))
        said = apart(lambda: read(path, cache_dir))
        if sorted(inside.rglob("*")) != before:
            said = f"left a file: {set(inside.rglob('*')) - set(before)}"
        packs = [each for each in cache_dir.glob("scenes/*") if each.is_dir()]
        if said.startswith("refused") and packs:
            said = f"left a pack: {packs}"
    finally:
        shutil.rmtree(inside)
        shutil.rmtree(cache_dir, ignore_errors=True)
    return said


GOOD = ("opened", "refused", "crashed inside a library")


def many(count: int, seed: int = 0, only: str = "") -> tuple[Counter[str], list[str]]:
    """(how many came to what, by kind; what is wrong) of so many wrong inputs."""
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    cv2.setNumThreads(1)
    found: Counter[str] = Counter()
    wrong = []
    known = [kind for kind in kinds() if only in kind]
    with tempfile.TemporaryDirectory() as base:
        for number in range(count):
            kind = known[number % len(known)]
            begin_s = time.monotonic()
            said = tried(kind, seed + number // len(known), Path(base))
            found[f"{kind}: {said.splitlines()[-1][:60] if said else said}"] += 1
            if not said.startswith(GOOD):
                took_s = time.monotonic() - begin_s
                wrong.append(f"{kind} {seed + number // len(known)} ({took_s:.1f} s): {said}")
    return found, wrong


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("count", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="")
    words = parser.parse_args()
    counted, faults = many(words.count, words.seed, words.only)
    print(json.dumps({"found": counted, "wrong": faults}, indent=1))
    sys.exit(bool(faults))
