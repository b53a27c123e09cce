"""Malicious scenes on the command line: `lfpipe scene` ends with code 2, a message and little memory."""

import os
import socket
import struct
import sys
import tempfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest
import scipy.io

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene import layouts
from lfpipe.scene.packing import pack_scene
from tests.hostile_files import PEAK_MB, ended, jpeg_claiming, png_of
from tests.scene import made
from tests.scene.hostile_scenes import GRID, PARAMETERS, film, hci, hci_text

SMALL_JPEG = cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1].tobytes()


def parameters(key: str, value: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        hci(folder)
        lines = [f"{key} = {value}" if line.startswith(key) else line for line in PARAMETERS.splitlines()]
        (folder / "parameters.cfg").write_text("\n".join(lines))
        return folder

    return make


def far_cameras(folder: Path) -> Path:
    for r in range(2):
        for c in range(2):
            made.write(folder / f"out_{r:02d}_{c:02d}_{'-' * r}1e308_{'-' * c}1e308_.png", GRID[r, c])
    return folder


def large_attribute(folder: Path) -> Path:
    hci_text(folder)
    (folder / "attributes.dat").write_text("1e308 //dH\n1e308 //focalLength\n")
    return folder


def sparse(name: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        hci(folder)
        (folder / name).unlink(missing_ok=True)
        (folder / name).touch()
        os.truncate(folder / name, 2 << 40)
        return folder

    return make


def sparse_alone(name: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        (folder / name).touch()
        os.truncate(folder / name, 2 << 40)
        return folder / name

    return make


def one_picture(name: str, data: bytes) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        (folder / name).write_bytes(data)
        return folder / name

    return make


def one_of_the_views(data: bytes) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        made.write_grid(folder, GRID)
        (folder / "view_02_02.png").write_bytes(data)
        return folder

    return make


def claiming_h5(name: str, shape: tuple[int, ...] = (9, 9, 40_000, 40_000, 3), **options: object) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        with h5py.File(folder / name, "w") as file:
            file.create_dataset("LF", shape, np.uint8, **options)
        return folder / name

    return make


def chained_links(folder: Path) -> Path:
    with h5py.File(folder.parent / "secret.h5", "w") as file:
        file["LF"] = GRID
    with h5py.File(folder / "lf.h5", "w") as file:
        file["away"] = h5py.ExternalLink("../secret.h5", "LF")
        file["on the way"] = h5py.SoftLink("/away")
        file["LF"] = h5py.SoftLink("/on the way")
    return folder


def virtual(folder: Path) -> Path:
    with h5py.File(folder.parent / "secret.h5", "w") as file:
        file["LF"] = GRID
    layout = h5py.VirtualLayout(GRID.shape, GRID.dtype)
    layout[:] = h5py.VirtualSource(str(folder.parent / "secret.h5"), "LF", GRID.shape)
    with h5py.File(folder / "lf.h5", "w") as file:
        file.create_virtual_dataset("LF", layout)
    return folder


def chunk_bomb(folder: Path) -> Path:
    """A chunk of 34 kB as 0.5 MB that unpacks to 0.5 GB."""
    with h5py.File(folder / "lf.h5", "w") as file:
        made_here = file.create_dataset("LF", GRID.shape, np.uint8, chunks=GRID.shape, compression="gzip")
        engine = zlib.compressobj(6)
        packed = b"".join(engine.compress(b"\0" * (1 << 24)) for _ in range(32)) + engine.flush()
        made_here.id.write_direct_chunk((0,) * 5, packed)
    return folder


def mat_bomb(name: str) -> Callable[[Path], Path]:
    """0.5 MB that unpack to 0.5 GB, as the light field or beside it."""

    def make(folder: Path) -> Path:
        shape, engine = (3, 3, 4000, 4700, 3), zlib.compressobj(6)
        size = int(np.prod(shape))
        dims = struct.pack("<II", 5, 4 * len(shape)) + struct.pack(f"<{len(shape)}i", *shape) + b"\0" * (-4 * len(shape) % 8)
        head = struct.pack("<IIII", 6, 8, 9, 0) + dims + struct.pack("<HH4s", 1, 2, name.encode()) + struct.pack("<II", 2, size)
        parts = [engine.compress(struct.pack("<II", 14, len(head) + size) + head)]
        parts += [engine.compress(b"\0" * (1 << 24)) for _ in range(size >> 24)] + [engine.compress(b"\0" * (size & 0xFFFFFF))]
        body = b"".join(parts) + engine.flush()
        scipy.io.savemat(folder / "a.mat", {"LF": GRID} if name != "LF" else {})
        with (folder / "a.mat").open("ab") as file:
            file.write(struct.pack("<II", 15, len(body)) + body)
        return folder

    return make


def large_film(folder: Path) -> Path:
    """An AVI whose header says 9000x9000."""
    film(folder, "avi", "FFV1")
    path = folder / "film.avi"
    size = struct.pack("<II", 240, 128)
    data = path.read_bytes()
    assert data.count(size) >= 2
    path.write_bytes(data.replace(size, struct.pack("<II", 9000, 9000)))
    return path


def large_frames(folder: Path) -> Path:
    """An AVI whose header is true, but whose JPEGs claim 20000x20000."""
    film(folder, "avi", "MJPG")
    path = folder / "film.avi"
    path.write_bytes(
        path.read_bytes().replace(
            b"\xff\xc0\x00\x11\x08" + struct.pack(">HH", 128, 240), b"\xff\xc0\x00\x11\x08" + struct.pack(">HH", 20_000, 20_000)
        )
    )
    return path


def playlist(folder: Path) -> Path:
    film(folder, "mkv", "FFV1")
    (folder / "list.mp4").write_text("#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nfilm.mkv\n#EXT-X-ENDLIST\n")
    return folder / "list.mp4"


def concatenation(folder: Path) -> Path:
    film(folder, "mkv", "FFV1")
    (folder / "list.mkv").write_text("ffconcat version 1.0\nfile film.mkv\n")
    return folder / "list.mkv"


ATTACKS: list[tuple[str, Callable[[Path], Path], str]] = [
    ("num_cams_x", parameters("num_cams_x", "1e18"), r"parameters\.cfg: num_cams_x is 1e\+18"),
    ("num_cams_y", parameters("num_cams_y", "99999"), "num_cams_y"),
    ("many cameras", parameters("num_cams_x", "10000"), "views"),
    ("baseline", parameters("baseline_mm", "1e307"), "baseline_mm is 1e[+]307"),
    ("focus", parameters("focus_distance_m", "nan"), "focus_distance_m is nan"),
    ("far cameras", far_cameras, "camera coordinate is -?1e"),
    ("attributes", large_attribute, r"attributes\.dat: dH is 1e\+308"),
    ("2 TB view", sparse("input_Cam004.png"), r"input_Cam004\.png"),
    ("2 TB parameters", sparse("parameters.cfg"), r"parameters\.cfg: has 2199023255552 bytes"),
    ("2 TB map", sparse("gt_disp_lowres.pfm"), r"gt_disp_lowres\.pfm: has 2199023255552 bytes"),
    ("2 TB HDF5", sparse_alone("lf.h5"), r"lf\.h5: has 2199023255552 bytes"),
    ("2 TB .mat", sparse_alone("a.mat"), r"a\.mat: has 2199023255552 bytes"),
    ("2 TB film", sparse_alone("film.mkv"), r"film\.mkv: has 2199023255552 bytes"),
    ("JPEG", one_picture("a.jpg", jpeg_claiming(SMALL_JPEG, 20_000, 20_000)), "20000x20000"),
    ("JPEG among views", one_of_the_views(jpeg_claiming(SMALL_JPEG, 20_000, 20_000)), r"view_02_02\.png.*20000x20000"),
    ("PNG, whole", one_picture("a.png", png_of(16_384, 16_384)), "16384x16384"),
    ("HDF5", claiming_h5("lf.h5"), "0 bytes are stored|views of 40000x40000"),
    ("HDF5 bomb", chunk_bomb, "bytes are stored for"),
    ("HDF5, no end", claiming_h5("lf.h5", (1, 2**40, 32, 32, 3)), r"lf\.h5"),
    ("chain of links", chained_links, "links to another"),
    ("virtual data set", virtual, "stored in other files"),
    ("film, header", large_film, "9000x9000"),
    ("film, frames", large_frames, "film.avi"),
    ("playlist", playlist, "not a readable video"),
    ("concatenation", concatenation, "not a readable video"),
]  # fmt: skip


@pytest.mark.parametrize(("make", "message"), [case[1:] for case in ATTACKS], ids=[case[0] for case in ATTACKS])
def test_an_attack_is_refused_with_little_memory(tmp_path: Path, make: Callable[[Path], Path], message: str) -> None:
    folder = tmp_path / "scene"
    folder.mkdir()
    command = ("info", make(folder), "--set", f"scene.cache_dir={tmp_path / 'cache'}")
    code, out, err, peak_mb = ended([sys.executable, "-m", "lfpipe", "scene", *map(str, command)])
    assert code == 2 and not out, err
    assert "Traceback" not in err
    with pytest.raises(UserError, match=message):
        raise UserError(err)
    assert peak_mb < PEAK_MB


def test_one_large_picture_among_the_views_is_left_out_with_little_memory(tmp_path: Path) -> None:
    folder = tmp_path / "scene"
    folder.mkdir()
    one_of_the_views(png_of(8000, 8000))(folder)
    command = [sys.executable, "-m", "lfpipe", "scene", "info", str(folder), "--set", f"scene.cache_dir={tmp_path / 'cache'}"]
    code, out, err, peak_mb = ended(command)
    assert code == 0 and not err.strip() and peak_mb < PEAK_MB
    assert "8 of 9 files used; the others are view_02_02.png (8000x8000 px)" in " ".join(out.split())


def fifo(path: Path) -> None:
    os.mkfifo(path)


def listening(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made_here:
        made_here.bind(f"/proc/self/cwd/{os.path.relpath(path)}" if len(str(path)) > 100 else str(path))


def endless(path: Path) -> None:
    path.symlink_to("/dev/zero")


@pytest.mark.timeout(60)
@pytest.mark.parametrize("put", [fifo, listening, endless])
@pytest.mark.parametrize("name", ["input_Cam004.png", "parameters.cfg", "gt_disp_lowres.pfm"])
def test_what_is_no_file_neither_blocks_nor_is_read(
    tmp_path: Path, put: Callable[[Path], None], name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    hci(tmp_path / "s")
    (tmp_path / "s" / name).unlink()
    put(tmp_path / "s" / name)
    with pytest.raises(UserError, match=name):
        pack_scene(tmp_path / "s", config.Scene(cache_dir=str(tmp_path / "cache")))


@pytest.mark.timeout(60)
@pytest.mark.parametrize("put", [fifo, endless])
@pytest.mark.parametrize("name", ["scene", "lf.h5", "a.mat", "film.mkv", "a.png"])
def test_a_scene_that_is_no_file(tmp_path: Path, put: Callable[[Path], None], name: str) -> None:
    put(tmp_path / name)
    for layout in ("auto", *layouts.layouts()):
        with pytest.raises(UserError, match="neither a file nor a folder"):
            pack_scene(tmp_path / name, config.Scene(layout=layout, cache_dir=str(tmp_path / "cache")))


@pytest.mark.timeout(60)
def test_things_beside_the_views_do_no_harm(tmp_path: Path) -> None:
    made.write_grid(tmp_path / "s", GRID)
    fifo(tmp_path / "s" / "notes.txt")
    (tmp_path / "s" / "loop").symlink_to("loop")
    (tmp_path / "s" / "locked.txt").touch(mode=0)
    assert pack_scene(tmp_path / "s", config.Scene(cache_dir=str(tmp_path / "cache"))).rows == 3


def test_implausible_truth_counts_as_missing(tmp_path: Path) -> None:
    hci(tmp_path / "s")
    truth = made.middle_disparity(32, 40).copy()
    truth[3, 4], truth[5, 6] = 3e38, -3e38
    made.write_pfm(tmp_path / "s" / "gt_disp_lowres.pfm", truth)
    field = pack_scene(tmp_path / "s", config.Scene(cache_dir=str(tmp_path / "cache")))
    assert (field.disparity_source, field.manifest["disparity"]["truth_views"]) == ("estimated", 0)
    assert -4 < field.disparity_min_px < field.disparity_max_px < 4
    assert any("true disparity" in note and "3e+38" in note for note in field.manifest["notes"])


def test_implausible_depth_counts_as_missing(tmp_path: Path) -> None:
    hci_text(tmp_path)
    (tmp_path / "attributes.dat").write_text("3 //hRes\n3 //vRes\n")
    depth = made.middle_disparity(32, 40).copy()
    depth[3, 4] = 3e38
    (tmp_path / "depth.bin").write_bytes(depth.astype("<f4").tobytes())
    field = pack_scene(tmp_path, config.Scene(cache_dir=str(tmp_path / "cache")))
    assert field.disparity_source == "estimated"
    assert any("true disparity" in note for note in field.manifest["notes"])


@pytest.mark.parametrize("planes", ["grey", "without an axis of colour"])
@pytest.mark.parametrize("layout", ["hci-old", "mat"])
def test_hdf5_of_one_plane(tmp_path: Path, planes: str, layout: str) -> None:
    grid = GRID[..., :1] if planes == "grey" else GRID[..., 0]
    with h5py.File(tmp_path / ("lf.h5" if layout == "hci-old" else "a.mat"), "w") as file:
        file["LF"] = grid[:, ::-1] if layout == "hci-old" else grid.transpose()
    field = pack_scene(tmp_path, config.Scene(cache_dir=str(tmp_path / "cache"), flip="cols" if layout == "hci-old" else "none"))
    assert np.array_equal(field.views[0, :, :, 0], GRID[..., 0])
    assert field.channels == 1


@pytest.mark.parametrize(
    "options",
    [dict(compression="gzip", fletcher32=True, shuffle=True), dict(compression="lzf"), dict(fletcher32=True), dict(chunks=True)],
)
@pytest.mark.parametrize("noise", [False, True])
def test_ways_to_pack_hdf5(tmp_path: Path, options: dict[str, bool], noise: bool) -> None:
    grid = np.random.default_rng(1).integers(0, 255, GRID.shape, np.uint8) if noise else GRID
    with h5py.File(tmp_path / "lf.h5", "w") as file:
        file.create_dataset("LF", data=grid[:, ::-1], **options)
    field = pack_scene(tmp_path, config.Scene(cache_dir=str(tmp_path / "cache"), flip="cols"))
    assert np.array_equal(field.views[0].transpose(0, 1, 3, 4, 2), grid)


ODD_NAMES = [b"\xff\xfe", b"sc\xe9ne", "日本".encode(), b"a b;'\"", b"\x1b[2J\x07"]


@pytest.mark.parametrize("name", ODD_NAMES)
def test_paths_of_any_bytes_work(tmp_path: Path, name: bytes) -> None:
    folder = tmp_path / os.fsdecode(name)
    made.write_grid(tmp_path / "plain", GRID).rename(folder)  # OpenCV alone crashes at such a path
    film(tmp_path, "mkv", "FFV1")
    paths = [folder, (tmp_path / "film.mkv").rename(tmp_path / os.fsdecode(name + b".mkv"))]
    paths.append(tmp_path / os.fsdecode(name + b".png"))
    paths[-1].write_bytes(cv2.imencode(".png", GRID[0, 0])[1].tobytes())
    for end, grid in (("h5", GRID), ("mat", GRID.transpose())):
        with h5py.File(tmp_path / f"made.{end}", "w") as file:
            file["LF"] = grid
        paths.append((tmp_path / f"made.{end}").rename(tmp_path / os.fsdecode(name + b"." + end.encode())))
    code = (
        "import sys; from lfpipe import config; from lfpipe.scene.packing import pack_scene\n"
        "for path in sys.argv[2:]: print(pack_scene(path, config.Scene(cache_dir=sys.argv[1])).rows)"
    )
    cache = os.fsdecode(os.fsencode(tmp_path / "cache") + name)
    done, out, err, _ = ended([sys.executable, "-c", code, cache, *map(str, paths)])
    assert (done, out.split()) == (0, ["3", "2", "1", "3", "3"]), err
    for action in (["info"], ["pack"], ["info", "--json"]):
        command = ["scene", *action, str(folder), "--config", "paper", "--set", f"scene.cache_dir={tmp_path / 'cache'}"]
        done, out, err, _ = ended([sys.executable, "-m", "lfpipe", *command])
        assert done == 0 and "\x1b[2J" not in out + err, err


def test_messages_escape_what_a_terminal_obeys(tmp_path: Path) -> None:
    made.write_grid(tmp_path / "a\x1b[2Jb", GRID)
    (tmp_path / "a\x1b[2Jb" / "view_01_01.png").write_text("none")
    code, _, err, _ = ended([sys.executable, "-m", "lfpipe", "scene", "info", str(tmp_path / "a\x1b[2Jb")])
    assert code == 2 and "a\\x1b[2Jb/view_01_01.png" in err and "\x1b[2J" not in err


@pytest.mark.parametrize("name", ["a\nerror: x", "a\rb"])
def test_a_name_does_not_make_lines_of_its_own(tmp_path: Path, name: str) -> None:
    with pytest.raises(UserError) as refused:
        pack_scene(tmp_path / name, config.Scene(cache_dir=str(tmp_path / "cache")))
    assert len(str(refused.value).splitlines()) == 2


@pytest.fixture
def base() -> Iterator[Path]:
    """A folder, made by root where it is root, who then is nobody: permissions count, as they do for everybody else."""
    with tempfile.TemporaryDirectory() as name:
        base, before = Path(name), os.geteuid()
        base.chmod(0o777)
        if before == 0:
            os.seteuid(65534)
        yield base
        for folder in base.iterdir():
            folder.chmod(0o755)
        os.seteuid(before)


def test_permissions_are_named(base: Path) -> None:
    listed, holding, scene = base / "listed", base / "holding", config.Scene(cache_dir=str(base / "cache"))
    for folder in (listed, holding):
        made.write_grid(folder, GRID)
    listed.chmod(0o444)
    (holding / "view_01_01.png").chmod(0)
    with pytest.raises(UserError, match="listed: search permission is missing"):
        pack_scene(listed, scene)
    with pytest.raises(UserError, match=r"view_01_01\.png: cannot be read: Permission denied"):
        pack_scene(holding, scene)
