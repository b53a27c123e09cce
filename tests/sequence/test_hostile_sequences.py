"""Recorded sequences damaged by chance or on purpose: read to the last frame, or refused by file,
field and value.
"""

import json
import os
import random
import shutil
import stat
import sys
import tempfile
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe import config
from lfpipe.capture.open_source import check_source, open_source
from lfpipe.errors import UserError
from lfpipe.replays.run import about_sequence, replay_config
from lfpipe.sequence import folder as sequences
from lfpipe.sequence.folder import MANIFEST, open_sequence
from lfpipe.sequence.packets import INDEX, PACKETS, TRUTH, read_truth
from tests.support import hostile_files, hostile_sequences
from tests.support.examples import examples
from tests.support.films import write_film
from tests.support.hostile_files import NO_FILES, at
from tests.support.hostile_sequences import put_packets, typed
from tests.support.processes import largest_file, open_umask
from tests.support.refusal import refusal


def opened(folder: Path, out: Path) -> None:
    sequence = open_sequence(folder)
    for index in range(len(sequence.packets)):
        sequence.frame(index)
    replay_config(sequence, None, ())
    json.dumps(about_sequence(sequence), allow_nan=False).encode()


def played(folder: Path, out: Path) -> None:
    camera = config.Camera(width_px=64, height_px=48)
    source = open_source(check_source(f"file:{folder}?loop=1&pace=max", camera).source, camera)
    frame = np.empty((48, 64, 3), np.uint8)
    for _ in range(14):
        source.read(frame)
    source.close()


def scored(folder: Path, out: Path) -> None:
    truth = read_truth(folder)
    assert truth is None or not np.isinf(truth.error_px([[1.0, 2.0], [3.0, 4.0]], 50_000_000))


def cut(folder: Path, out: Path) -> None:
    sequences.cut(open_sequence(folder, verify=False), out, 0.03, 0.15)
    open_sequence(out)


USES: dict[str, Callable[[Path, Path], object]] = {
    "open": opened,
    "play": played,
    "truth": scored,
    "info": lambda folder, out: typed("info", folder, "--json"),
    "check": lambda folder, out: typed("check", folder),
    "cut": cut,
}


@examples(60)
@given(seed=st.integers(0, 2**32))
def test_a_damaged_sequence_is_read_or_refused(whole: Path, seed: int) -> None:
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "seq"
        shutil.copytree(whole, folder)
        rng = random.Random(seed)
        what = hostile_sequences.damage(
            rng, *(folder / name for name in (MANIFEST, INDEX, PACKETS, TRUTH))
        )
        if rng.random() < 0.7:
            hostile_sequences.sign(folder)
        for name, use in USES.items():
            out = Path(parent) / f"out of {name}"
            try:
                use(folder, out)
            except UserError as error:
                assert str(folder) in str(error) and len(str(error)) <= 2000 and error.remedy, (
                    what,
                    name,
                    error,
                )
                assert not list(Path(parent).glob(f"{out.name}*")), "what failed leaves nothing"


def bombs() -> dict[str, tuple[str, bytes]]:
    """(codec, packet) of pictures that are small and claim much, or cost much."""
    jpeg = cv2.imencode(".jpg", hostile_sequences.picture(0))[1].tobytes()
    progressive = cv2.imencode(
        ".jpg", hostile_sequences.picture(0), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]
    )[1].tobytes()
    scan = progressive[progressive.rfind(b"\xff\xda") : -2]
    return {
        "jpeg of 20000x20000": ("jpeg", hostile_files.jpeg_claiming(jpeg, 20_000, 20_000)),
        "jpeg of 63x48": ("jpeg", hostile_files.jpeg_claiming(jpeg, 63, 48)),
        "jpeg of a thousand scans": ("jpeg", progressive[:-2] + scan * 300 + b"\xff\xd9"),
        "jpeg cut off": ("jpeg", jpeg[:600]),
        "png of 20000x20000": ("png", hostile_files.png_of(20_000, 20_000)),
        "png that is a jpeg": ("png", jpeg),
        "jpeg of many segments": ("jpeg", jpeg[:2] + b"\xff\xe5\0\2" * 300_000 + jpeg[2:]),
        "progressive jpeg of 36 million px": (
            "jpeg",
            hostile_files.jpeg_claiming(progressive, 6000, 6000),
        ),
        "jpeg and 200 MB": ("jpeg", jpeg + bytes(110_000_000)),
        "nothing": ("png", b""),
        "raw of another size": ("raw", b"\0" * (64 * 48 * 3 - 1)),
    }


def replace_packet(codec: str, data: bytes, folder: Path) -> None:
    """Frame 3 as data, with lengths and checksums that agree."""
    found = hostile_sequences.packets(folder)
    found[3] = ({**found[3][0], "codec": codec}, data)
    put_packets(folder, found)
    hostile_sequences.sign(folder)


def long_file(name: str, head: bytes, line: bytes, count: int, folder: Path) -> None:
    """The first line of a file, or another head, then count lines, "%d" counted, and one that is
    wrong.
    """
    path = folder / name
    head = head or path.read_bytes().splitlines(keepends=True)[0]
    path.write_bytes(
        head
        + b"".join(line.replace(b"%d", str(number).encode()) for number in range(1, count))
        + b"x\n"
    )


def endless(name: str, start: bytes, folder: Path) -> None:
    """A file of 300 MB that begins so, sparse: who read it whole would need more memory than a
    refusal may.
    """
    (folder / name).write_bytes(start)
    os.truncate(folder / name, 300 << 20)


LINE = (
    b'{"seq": %d, "source_seq": 0, "epoch": 0, "t_sensor_ns": 1000000000%d, "t_read_ns": 0,'
    b' "codec": "raw", "offset": SIZE, "bytes": 0, "crc32": 0}\n'
)


def many_frames(folder: Path) -> None:
    size = json.loads((folder / INDEX).read_text().splitlines()[0])["bytes"]
    long_file(INDEX, b"", LINE.replace(b"SIZE", str(size).encode()), 300_000, folder)


def eyes_only(data: bytes, folder: Path) -> None:
    put_packets(
        folder, [({**line, "codec": "eyes"}, data) for line, _ in hostile_sequences.packets(folder)]
    )
    hostile_sequences.sign(folder)


def large_frames(folder: Path) -> None:
    """Six frames of 45 MB each: what is said of one must not hold it."""
    size = 45_000_000
    zeros = zlib.crc32(bytes(size))
    lines = [line for line, _ in hostile_sequences.packets(folder)]
    changed = [
        {**line, "codec": "jpeg", "offset": seq * size, "bytes": size, "crc32": zeros}
        for seq, line in enumerate(lines)
    ]
    (folder / INDEX).write_text("".join(json.dumps(line) + "\n" for line in changed))
    (folder / PACKETS).write_bytes(b"")
    os.truncate(folder / PACKETS, size * len(lines))
    manifest = json.loads((folder / MANIFEST).read_text())
    (folder / MANIFEST).write_text(json.dumps(manifest | {"width_px": 4000, "height_px": 4000}))
    hostile_sequences.sign(folder)


def damages() -> dict[str, tuple[str, Callable[[Path], object]]]:
    """By name, what the refusal names, and the damage."""
    return {
        **{name: ("frame 3: ", partial(replace_packet, *bomb)) for name, bomb in bombs().items()},
        "manifest of brackets": (MANIFEST, partial(endless, MANIFEST, b"[" * 9999)),
        "index without lines": (INDEX, partial(endless, INDEX, b"x")),
        "index of many frames": (INDEX, many_frames),
        "eyes of brackets": (INDEX, partial(eyes_only, b"[" + b"[]," * 3_000_000 + b"[]]")),
        "few eyes of brackets": ("frame 0", partial(eyes_only, b"[" + b"[]," * 1300 + b"[]]")),
        "large frames, all damaged": ("frame 0", large_frames),
        "truth without lines": (TRUTH, partial(endless, TRUTH, b"t_ns,")),
        "truth of many rows": (
            TRUTH,
            partial(long_file, TRUTH, b"", b"%d,%d,0,0,0,0,1\n", 300_000),
        ),
        "packets cut off": (PACKETS, lambda folder: os.truncate(folder / PACKETS, 20_000)),
        **{
            f"{kind} as {name}": (
                name,
                at(name, NO_FILES[kind]),
            )
            for kind, name in zip(NO_FILES, 3 * (MANIFEST, INDEX, PACKETS, TRUTH), strict=False)
        },
    }


def lfpipe(home: Path, *args: str | Path) -> tuple[int, str, str, float]:
    """Runs the command line in a process of its own; see `hostile_files.ended`."""
    names = ("XDG_CONFIG_HOME", "XDG_CACHE_HOME", "LFPIPE_RUN_DIR")
    env = {
        **os.environ,
        **{name: str(home / "home") for name in names},
        "PYTHONPATH": str(Path(__file__).parents[2]),
    }
    (home / "home").mkdir(mode=0o700, exist_ok=True)
    return hostile_files.ended([sys.executable, "-m", "lfpipe", *map(str, args)], env=env, cwd=home)


def test_every_refusal_is_quick_and_small_and_names_file_or_frame(
    whole: Path, tmp_path: Path
) -> None:
    """All at once: one bad sequence of several hides no other, and the largest memory is that of
    all refusals.
    """
    damaged = damages()
    for number, (_, damage) in enumerate(damaged.values()):
        damage(shutil.copytree(whole, tmp_path / f"d{number}"))
    folders = [tmp_path / f"d{number}" for number in range(len(damaged))]
    code, out, err, peak_mb = lfpipe(
        tmp_path, "sequence", "check", whole, *folders, tmp_path / "gone"
    )
    refusals = err.split("error: ")[1:]
    assert (
        code == 2
        and len(refusals) == len(folders) + 1
        and f"{whole}: 6 frames" in out
        and "Traceback" not in err
    ), err
    for folder, (name, (word, _)), said in zip(folders, damaged.items(), refusals, strict=False):
        assert str(folder) in said and (word in said or "frame" in said) and len(said) <= 2000, (
            name,
            said,
        )
    assert peak_mb <= hostile_files.PEAK_MB


def test_all_broken_frames_are_named_and_those_before_can_be_cut_out(
    whole: Path, tmp_path: Path
) -> None:
    folder = shutil.copytree(whole, tmp_path / "seq")
    put_packets(
        folder,
        [
            (line, data[: -20 * (line["seq"] in (2, 4)) or None])
            for line, data in hostile_sequences.packets(folder)
        ],
    )
    with pytest.raises(UserError, match=r"(?s)frame 2: .*frame 4: .*`lfpipe sequence cut`"):
        typed("check", folder)
    typed("cut", folder, tmp_path / "out", "--to", "0.06")
    part = open_sequence(tmp_path / "out")
    assert (
        all(np.array_equal(part.frame(k), open_sequence(whole).frame(k)) for k in range(2))
        and len(part.packets) == 2
    )


def lossless_video(path: Path, folder: Path) -> Path:
    """The frames of a sequence as a video."""
    sequence = open_sequence(folder)
    return write_film(path, map(sequence.frame, range(len(sequence.packets))), "FFV1", 30.0)


def test_what_shows_a_person_is_for_its_owner_alone(whole: Path, tmp_path: Path) -> None:
    with open_umask():
        sequences.cut(open_sequence(whole), tmp_path / "cut", 0.0, 1.0)
        lossless_video(tmp_path / "video.mkv", whole).chmod(0o600)
        typed("import", tmp_path / "video.mkv", tmp_path / "back", "--truth", whole / TRUTH)
    assert (tmp_path / "back" / TRUTH).read_bytes() == (whole / TRUTH).read_bytes()
    for path in tmp_path.rglob("*"):
        assert stat.S_IMODE(path.stat().st_mode) == (0o700 if path.is_dir() else 0o600), path


def test_nothing_that_is_there_is_overwritten_and_nothing_half_stays(
    whole: Path, tmp_path: Path
) -> None:
    (tmp_path / "mine.csv").write_text("mine")
    (tmp_path / "folder").mkdir()
    (tmp_path / "notes.avi").write_text("no video")
    lossless_video(tmp_path / "good.mkv", whole)
    before = sorted(path.name for path in tmp_path.iterdir())

    def refused(*args: str | Path) -> None:
        refusal(typed, *args)
        assert sorted(path.name for path in tmp_path.iterdir()) == before, args

    for args in (
        ("cut", whole, tmp_path / "folder"),
        ("cut", whole, "/proc/none/x"),
        ("import", tmp_path / "notes.avi", tmp_path / "new"),
        ("import", tmp_path / "good.mkv", tmp_path / "folder"),
        ("import", "/dev/zero", tmp_path / "new"),
        ("import", tmp_path / "good.mkv", tmp_path / "new", "--truth", tmp_path / "mine.csv"),
        ("import", "http://127.0.0.1:9/x.avi", tmp_path / "new"),
    ):
        refused(*args)
    for room in (0, 4000):  # of a full disk
        with largest_file(room):
            refused("cut", whole, tmp_path / "new")
            refused("import", tmp_path / "good.mkv", tmp_path / "new")
    assert (tmp_path / "mine.csv").read_text() == "mine" and not list(
        (tmp_path / "folder").iterdir()
    )


def test_a_link_out_of_the_folder_is_not_followed(whole: Path, tmp_path: Path) -> None:
    for name in (MANIFEST, INDEX, PACKETS, TRUTH):
        folder = shutil.copytree(whole, tmp_path / name)
        (folder / name).rename(folder / "kept")
        (folder / name).symlink_to("kept")
        open_sequence(folder)
        (folder / name).unlink()
        (folder / name).symlink_to(whole / name)
        assert f"{name}: a link to " in str(refusal(open_sequence, folder))
    (tmp_path / "link").symlink_to(whole)
    open_sequence(tmp_path / "link")  # what a person names is followed
