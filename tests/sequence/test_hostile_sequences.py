"""Recorded sequences damaged by chance or on purpose: read to the last frame, or refused by file, field and value."""

import json
import os
import random
import resource
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfpipe import config
from lfpipe.capture.open_source import check_source, open_source
from lfpipe.errors import UserError
from lfpipe.files.safe_files import LineFile
from lfpipe.files.trace import TraceFile
from lfpipe.replays.report import about_sequence
from lfpipe.replays.run import replay_config
from lfpipe.sequence import edit
from lfpipe.sequence.eyes import EYES, TRUTH, read_truth
from lfpipe.sequence.folder import MANIFEST, open_sequence
from lfpipe.sequence.packets import INDEX, PACKETS, encoded
from tests import hostile_files, hostile_sequences
from tests.hostile_files import NO_FILES

Use = Callable[[Path, Path], object]


def opened(folder: Path, out: Path) -> None:
    sequence = open_sequence(folder)
    for index in range(len(sequence.packets)):
        sequence.frame(index)
    replay_config(sequence, None, ())
    json.dumps(about_sequence(sequence), allow_nan=False).encode()


def played(folder: Path, out: Path) -> None:
    camera = config.Camera(width_px=64, height_px=48)
    source, frame = (
        open_source(check_source(f"file:{folder}?loop=1&pace=max", camera).text, camera),
        np.empty((48, 64, 3), np.uint8),
    )
    for _ in range(14):
        source.read(frame)
    source.close()


def scored(folder: Path, out: Path) -> None:
    truth = read_truth(folder)
    assert truth is None or np.isfinite(truth.error_px([[1.0, 2.0], [3.0, 4.0]], 50_000_000) or 0.0)


def cut(folder: Path, out: Path) -> None:
    edit.cut(open_sequence(folder, verify=False), out, 0.03, 0.15)
    open_sequence(out)


USES: dict[str, Use] = {
    "open": opened,
    "play": played,
    "truth": scored,
    "info": lambda folder, out: hostile_sequences.typed("info", folder, "--json"),
    "check": lambda folder, out: hostile_sequences.typed("check", folder),
    "cut": cut,
    "export": lambda folder, out: edit.export(open_sequence(folder), out.with_suffix(".mkv")),
}


@settings(max_examples=60)
@given(seed=st.integers(0, 2**32))
def test_a_damaged_sequence_is_read_or_refused(whole: Path, seed: int) -> None:
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "seq"
        shutil.copytree(whole, folder)
        what = hostile_sequences.damage(random.Random(seed), folder)
        for name, use in USES.items():
            out = Path(parent) / f"out of {name}"
            try:
                use(folder, out)
            except UserError as error:
                assert str(folder) in str(error), (what, name, error)
                assert len(str(error)) <= 2000 and error.remedy
                assert not list(Path(parent).glob(f"{out.name}*")), "what failed leaves nothing"


def eyes_packet(**changes: object) -> bytes:
    """A line of the mouse's eyes."""
    points = [[340.0, 240.0], [300.0, 240.0]]
    return json.dumps({"source_seq": 1, "face": 1, "raw_px": points, "filtered_px": points, "apart_px": 40.0} | changes).encode()


def eyes_only(out: Path, *packets: bytes) -> Path:
    """A recording of the mouse."""
    shutil.copytree(hostile_sequences.made_sequence(out.with_name("frames")), out)
    lines = [line for line, _ in hostile_sequences.packets(out)]
    hostile_sequences.put_packets(out, [({**line, "codec": "eyes"}, data) for line, data in zip(lines, packets, strict=True)])
    hostile_sequences.sign(out)
    return out


def test_eyes_in_place_of_frames_are_finite_and_whole(tmp_path: Path) -> None:
    good, nan = [eyes_packet(source_seq=k) for k in range(5)], float("nan")
    for bad in (b"", b"[1]", b"{}", eyes_packet(face=2), eyes_packet(raw_px=[[nan, 0], [0, 0]]), eyes_packet(apart_px=1e300)):
        sequence = open_sequence(eyes_only(tmp_path / "seq", *good, bad))
        assert sequence.eyes(4)["apart_px"] == 40 and sequence.eyes(4)["raw_px"][0].tolist() == [340, 240]
        for use in (
            partial(sequence.eyes, 5),
            partial(sequence.frame, 5),
            partial(hostile_sequences.typed, "check", sequence.path),
        ):
            with pytest.raises(UserError, match="frame 5"):
                use()
        shutil.rmtree(tmp_path / "seq"), shutil.rmtree(tmp_path / "frames")


def bombs() -> dict[str, tuple[str, bytes]]:
    """(codec, packet) of pictures that are small and claim much, or cost much."""
    jpeg = cv2.imencode(".jpg", hostile_sequences.picture(0))[1].tobytes()
    png = encoded(hostile_sequences.picture(0), fast=False)[1]
    progressive = cv2.imencode(".jpg", hostile_sequences.picture(0), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    scan = progressive[progressive.rfind(b"\xff\xda") : -2]
    return {
        "jpeg of 20000x20000": ("jpeg", hostile_files.jpeg_claiming(jpeg, 20_000, 20_000)),
        "jpeg of 65535x65535": ("jpeg", hostile_files.jpeg_claiming(progressive, 65_535, 65_535)),
        "jpeg of 63x48": ("jpeg", hostile_files.jpeg_claiming(jpeg, 63, 48)),
        "jpeg of a thousand scans": ("jpeg", progressive[:-2] + scan * 300 + b"\xff\xd9"),
        "jpeg cut off": ("jpeg", jpeg[:600]),
        "png of 20000x20000": ("png", hostile_files.png_of(20_000, 20_000)),
        "png of 2000000000x1": ("png", hostile_files.png_of(2_000_000_000, 1, body=b"")),
        "png cut off": ("png", png[:-300]),
        "png that is a jpeg": ("png", jpeg),
        "jpeg that is a png": ("jpeg", png),
        "bmp": ("png", cv2.imencode(".bmp", hostile_sequences.picture(0))[1].tobytes()),
        "nothing": ("png", b""),
        "raw of another size": ("raw", b"\0" * (64 * 48 * 3 - 1)),
    }


def replaced_packet(folder: Path, codec: str, data: bytes) -> None:
    """Frame 3 as data, with lengths and checksums that agree."""
    found = hostile_sequences.packets(folder)
    found[3] = ({**found[3][0], "codec": codec}, data)
    hostile_sequences.put_packets(folder, found)
    hostile_sequences.sign(folder)


def endless(start: bytes) -> Callable[[Path], None]:
    """A file of 300 MB that begins so, sparse: who read it whole would need more memory than a refusal may."""

    def write(path: Path) -> None:
        path.write_bytes(start)
        os.truncate(path, 300 << 20)

    return write


def many_frames(path: Path) -> None:
    """An index of 300,000 good lines, the last of which is not the next one."""
    line = json.loads(path.read_text().splitlines()[0])
    lines = ({**line, "seq": seq, "t_sensor_ns": seq, "offset": 0, "bytes": 0} for seq in range(300_000))
    with path.open("w") as file:
        file.writelines(json.dumps(each) + "\n" for each in lines)
        file.write("{}\n")


def many_rows(path: Path) -> None:
    head = path.read_text().splitlines()[0]
    with path.open("w") as file:
        file.write(head + "\n")
        file.writelines(f"{n},{n},0,0,0,0,1\n" for n in range(300_000))
        file.write("x\n")


LARGE: dict[str, tuple[str, Callable[[Path], None]]] = {
    "manifest of brackets": (MANIFEST, endless(b"[" * 9999)),
    "index without lines": (INDEX, endless(b"x")),
    "index of many frames": (INDEX, many_frames),
    "truth without lines": (TRUTH, endless(b"t_ns,")),
    "truth of many rows": (TRUTH, many_rows),
    "eyes without lines": (EYES, endless(b"[")),
    "packets cut off": (PACKETS, lambda path: os.truncate(path, 20_000)),
    **{
        f"{kind} as {name}": (name, NO_FILES[kind])
        for kind, name in zip(NO_FILES, 3 * (MANIFEST, INDEX, PACKETS, TRUTH), strict=False)
    },
}


def test_every_refusal_is_quick_and_small_and_names_file_or_frame(whole: Path, tmp_path: Path) -> None:
    """All at once: one bad sequence of several hides no other, and the largest memory is that of all refusals."""
    named = {}
    for number, (name, (codec, data)) in enumerate(bombs().items()):
        named[tmp_path / f"b{number}"] = (name, "frame 3: ")
        shutil.copytree(whole, tmp_path / f"b{number}")
        replaced_packet(tmp_path / f"b{number}", codec, data)
    for number, (name, (file, put)) in enumerate(LARGE.items()):
        named[tmp_path / f"l{number}"] = (name, f"/{file}")
        shutil.copytree(whole, tmp_path / f"l{number}")
        put(tmp_path / f"l{number}" / file)
    code, out, err, peak_mb = lfpipe(tmp_path, "check", whole, *named, tmp_path / "gone")
    refusals = err.split("error: ")[1:]
    assert code == 2 and len(refusals) == len(named) + 1 and f"{whole}: 6 frames" in out and "Traceback" not in err, err
    for (folder, (name, word)), refusal in zip(named.items(), refusals, strict=False):
        assert str(folder) in refusal and (word in refusal or "frame" in refusal) and len(refusal) <= 2000, (name, refusal)
    assert peak_mb <= hostile_files.PEAK_MB


def lfpipe(home: Path, *args: str | Path, room: str = "sequence", **more: Any) -> tuple[int, str, str, float]:
    """Runs the command line in a process of its own; see `hostile_files.ended`."""
    names = ("XDG_CONFIG_HOME", "XDG_CACHE_HOME", "XDG_RUNTIME_DIR")
    env = {**os.environ, **{name: str(home / "home") for name in names}, "PYTHONPATH": str(Path(__file__).parents[2])}
    env["PYTHONIOENCODING"] = "utf-8:strict"
    (home / "home").mkdir(mode=0o700, exist_ok=True)
    words = [sys.executable, "-m", "lfpipe", *([room] if room else []), *map(str, args)]
    return hostile_files.ended(words, env=env, cwd=home, **more)


def test_a_name_of_any_bytes_is_a_name(whole: Path, tmp_path: Path) -> None:
    folders = [tmp_path / os.fsdecode(name) for name in (b"\xff\xfe", b"a\x1b[31mb", b"new\nline", "日本".encode())]
    for folder in folders:
        shutil.copytree(whole, folder)
        edit.cut(open_sequence(folder), tmp_path / "part", 0, 1)
        open_sequence(tmp_path / "part")
        shutil.rmtree(tmp_path / "part")
    for args in (("info", *folders), ("check", *folders), ("info", "--json", *folders)):
        code, out, err, _ = lfpipe(tmp_path, *args)
        assert code == 0 and out and not err, (args, err)


def test_all_broken_frames_are_named_and_those_before_can_be_cut_out(whole: Path, tmp_path: Path) -> None:
    folder = tmp_path / "seq"
    shutil.copytree(whole, folder)
    found = hostile_sequences.packets(folder)
    for seq in (2, 4):
        found[seq] = (found[seq][0], found[seq][1][:-20])
    hostile_sequences.put_packets(folder, found)
    with pytest.raises(UserError, match=r"(?s)frame 2: .*frame 4: .*`lfpipe sequence cut`"):
        hostile_sequences.typed("check", folder)
    hostile_sequences.typed("cut", folder, tmp_path / "out", "--to", "0.06")
    part = open_sequence(tmp_path / "out")
    assert [np.array_equal(part.frame(k), open_sequence(whole).frame(k)) for k in range(2)] == [True, True]


def modes(path: Path) -> dict[str, int]:
    """Of a file or folder and of all within, by name."""
    return {each.name: stat.S_IMODE(each.stat().st_mode) for each in (path, *path.rglob("*"))}


def test_what_shows_a_person_is_for_its_owner_alone(whole: Path, tmp_path: Path) -> None:
    umask = os.umask(0)
    try:
        sequence = open_sequence(whole)
        edit.cut(sequence, tmp_path / "cut", 0.0, 1.0)
        table = edit.export(sequence, tmp_path / "video.mkv")
        hostile_sequences.typed("import", tmp_path / "video.mkv", tmp_path / "back", "--truth", whole / TRUTH)
        TraceFile(tmp_path / "trace.jsonl", pytest.fail).close()
        LineFile(tmp_path / "lines").close()
    finally:
        os.umask(umask)
    for name in ("cut", "back"):
        found = modes(tmp_path / name)
        assert found.pop(name) == 0o700 and set(found.values()) == {0o600} and len(found) >= 4
    for path in (table, tmp_path / "video.mkv", tmp_path / "trace.jsonl", tmp_path / "lines"):
        assert modes(path) == {path.name: 0o600}


def test_nothing_that_is_there_is_overwritten_and_nothing_half_stays(whole: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.csv").write_text("mine")
    (tmp_path / "folder").mkdir()
    (tmp_path / "notes.avi").write_text("no video")
    bad_truth = tmp_path / "truth.csv"
    bad_truth.write_text("t_ns,left_x_px,left_y_px,right_x_px,right_y_px\n0,nan,1,1,1\n")
    edit.export(open_sequence(whole), tmp_path / "good.mkv")
    before = sorted(path.name for path in tmp_path.iterdir())
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)

    def refused(*args: str | Path) -> None:
        with pytest.raises(UserError) as caught:
            hostile_sequences.typed(*args)
        assert caught.value.remedy and sorted(path.name for path in tmp_path.iterdir()) == before, args

    for args in (
        ("export", whole, tmp_path / "mine.mkv"),
        ("export", whole, tmp_path / "gone" / "v.mkv"),
        ("cut", whole, tmp_path / "folder"),
        ("cut", whole, "/proc/none/x"),
        ("cut", whole, tmp_path / "new", "--from", "nan"),
        ("import", tmp_path / "notes.avi", tmp_path / "new"),
        ("import", tmp_path / "good.mkv", tmp_path / "folder"),
        ("import", tmp_path / "good.mkv", tmp_path / "new", "--truth", bad_truth),
        ("import", tmp_path / "good.mkv", tmp_path / "new", "--truth", tmp_path / "gone"),
        ("import", "/dev/zero", tmp_path / "new"),
        ("import", tmp_path, tmp_path / "new"),
        ("import", "http://127.0.0.1:9/x.avi", tmp_path / "new"),
    ):
        refused(*args)
    for room in (0, 1000, 4000):  # of a full disk
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
        try:
            refused("cut", whole, tmp_path / "new")
            refused("import", tmp_path / "good.mkv", tmp_path / "new")
            refused("export", whole, tmp_path / "new.mkv")
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert (tmp_path / "mine.csv").read_text() == "mine" and not list((tmp_path / "folder").iterdir())


@pytest.mark.live
def test_a_session_that_comes_to_a_broken_frame_names_it(whole: Path, tmp_path: Path) -> None:
    shutil.copytree(whole, tmp_path / "seq")
    replaced_packet(tmp_path / "seq", *bombs()["jpeg of 20000x20000"])
    view = tmp_path / "scene" / "view_00_00.png"
    view.parent.mkdir()
    view.write_bytes(encoded(hostile_sequences.picture(0), fast=False)[1])
    shutil.copy(view, view.with_name("view_00_01.png"))
    for codes, args in (
        ((2,), ("replay", tmp_path / "seq", "--scene", view.parent)),
        ((1, 2), ("up", view.parent, "--camera", f"file:{tmp_path / 'seq'}?loop=0", "--display", "none")),  # tried again first
        ((1, 2), ("record", tmp_path / "rec", "--camera", f"file:{tmp_path / 'seq'}?loop=0")),
    ):
        code, _, err, peak_mb = lfpipe(tmp_path, *args, room="")
        assert code in codes and "seq: frame 3: " in err and "Traceback" not in err, (args, err)
        assert peak_mb <= hostile_files.PEAK_MB, args


def test_a_link_out_of_the_folder_is_not_followed(whole: Path, tmp_path: Path) -> None:
    folder = tmp_path / "seq"
    for name in (MANIFEST, INDEX, PACKETS, TRUTH, EYES):
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(whole, folder)
        (folder / name).unlink()
        (folder / name).symlink_to(whole / name)
        with pytest.raises(UserError, match=f"{name}: a link to "):
            open_sequence(folder)
        shutil.copy(whole / name, folder / "kept")
        (folder / name).unlink()
        (folder / name).symlink_to("kept")
        open_sequence(folder)
    (tmp_path / "link").symlink_to(whole)
    open_sequence(tmp_path / "link")  # what a person names is followed
