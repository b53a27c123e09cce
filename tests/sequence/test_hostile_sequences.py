"""Recorded sequences damaged by chance or on purpose: read to the last frame, or refused by file, field and value."""

import functools
import json
import os
import random
import resource
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from lfpipe import config
from lfpipe.capture.open_source import check_source, open_source
from lfpipe.cli import cli
from lfpipe.errors import UserError
from lfpipe.files.line_file import LineFile
from lfpipe.files.trace import TraceFile
from lfpipe.replays.report import about_sequence
from lfpipe.replays.run import replay_config
from lfpipe.sequence import edit
from lfpipe.sequence.eyes import read_truth
from lfpipe.sequence.folder import EYES, MANIFEST, TRUTH, open_sequence
from lfpipe.sequence.packets import INDEX, PACKETS, encoded
from tests import hostile_files, hostile_sequences
from tests.hostile_files import NO_FILES


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return hostile_sequences.made_sequence(tmp_path_factory.mktemp("sequences") / "whole")


def opened(folder: Path, out: Path) -> None:
    sequence = open_sequence(folder)
    for index in range(len(sequence.packets)):
        sequence.frame(index)
    replay_config(sequence, None, ())
    json.dumps(about_sequence(sequence), allow_nan=False).encode()


def played(folder: Path, out: Path) -> None:
    camera = config.Camera(width_px=64, height_px=48)
    name = check_source(f"file:{folder}?loop=1&pace=max", camera).text
    source, frame = open_source(name, camera), np.empty((48, 64, 3), np.uint8)
    for _ in range(14):
        source.read(frame)
    source.close()


def scored(folder: Path, out: Path) -> None:
    truth = read_truth(folder)
    if truth is not None:
        assert np.isfinite(truth.error_px([[1.0, 2.0], [3.0, 4.0]], 50_000_000) or 0.0)


def typed(*args: str) -> Callable[[Path, Path], None]:
    """A command as a person types it; SEQ and OUT stand for the paths."""

    def run(folder: Path, out: Path) -> None:
        words = [{"SEQ": str(folder), "OUT": str(out)}.get(arg, arg.replace("OUT", str(out))) for arg in args]
        found = CliRunner().invoke(cli, words)
        if found.exception is not None and not isinstance(found.exception, SystemExit):
            raise found.exception
        if args[1] == "cut" and found.exit_code == 0:
            open_sequence(out)

    return run


USES: dict[str, Callable[[Path, Path], None]] = {
    "open": opened,
    "play": played,
    "truth": scored,
    "info": typed("sequence", "info", "SEQ"),
    "info as JSON": typed("sequence", "info", "SEQ", "--json"),
    "check": typed("sequence", "check", "SEQ"),
    "cut": typed("sequence", "cut", "SEQ", "OUT", "--from", "0.03", "--to", "0.15"),
    "export": typed("sequence", "export", "SEQ", "OUT.mkv"),
}


@settings(max_examples=100)
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


def replaced_packet(folder: Path, codec: str, data: bytes) -> None:
    """Frame 3 as data, with lengths and checksums that agree."""
    found = hostile_sequences.packets(folder)
    found[3] = ({**found[3][0], "codec": codec}, data)
    hostile_sequences.put_packets(folder, found)
    hostile_sequences.sign(folder)


@functools.cache
def bombs() -> dict[str, tuple[str, bytes]]:
    """(codec, packet) of pictures that are small and claim much, or cost much."""
    jpeg = cv2.imencode(".jpg", hostile_sequences.picture(0))[1].tobytes()
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
        "png cut off": ("png", encoded(hostile_sequences.picture(0), fast=False)[1][:-300]),
        "png that is a jpeg": ("png", jpeg),
        "jpeg that is a png": ("jpeg", encoded(hostile_sequences.picture(0), fast=False)[1]),
        "bmp": ("png", cv2.imencode(".bmp", hostile_sequences.picture(0))[1].tobytes()),
        "nothing": ("png", b""),
        "raw of another size": ("raw", b"\0" * (64 * 48 * 3 - 1)),
    }


@pytest.mark.parametrize("name", sorted(bombs()))
def test_a_frame_that_claims_too_much_is_refused_by_its_number_and_costs_nothing(whole: Path, tmp_path: Path, name: str) -> None:
    shutil.copytree(whole, tmp_path / "seq")
    replaced_packet(tmp_path / "seq", *bombs()[name])
    code, _, err, peak_mb = lfpipe(tmp_path, "sequence", "check", tmp_path / "seq")
    assert code == 2 and "seq: frame 3: " in err and "Traceback" not in err, err
    assert peak_mb <= hostile_files.PEAK_MB


def test_all_broken_frames_are_named_and_those_before_can_be_cut_out(whole: Path, tmp_path: Path) -> None:
    folder = tmp_path / "seq"
    shutil.copytree(whole, folder)
    found = hostile_sequences.packets(folder)
    for seq in (2, 4):
        found[seq] = (found[seq][0], found[seq][1][:-20])
    hostile_sequences.put_packets(folder, found)
    with pytest.raises(UserError, match=r"(?s)frame 2: .*frame 4: .*`lfpipe sequence cut` copies the frames before it"):
        typed("sequence", "check", "SEQ")(folder, tmp_path / "out")
    typed("sequence", "cut", "SEQ", "OUT", "--to", "0.06")(folder, tmp_path / "out")
    part = open_sequence(tmp_path / "out")
    assert [np.array_equal(part.frame(k), open_sequence(whole).frame(k)) for k in range(2)] == [True, True]


def lfpipe(home: Path, *args: str | Path, encoding: str = "utf-8", **more: Any) -> tuple[int, str, str, float]:
    """Runs the command line in a process of its own; see `hostile_files.ended`."""
    names = ("XDG_CONFIG_HOME", "XDG_CACHE_HOME", "XDG_RUNTIME_DIR")
    env = {**os.environ, **{name: str(home / "home") for name in names}, "PYTHONPATH": str(Path(__file__).parents[2])}
    env["PYTHONIOENCODING"] = encoding
    (home / "home").mkdir(mode=0o700, exist_ok=True)
    return hostile_files.ended([sys.executable, "-m", "lfpipe", *map(str, args)], env=env, cwd=home, **more)


def without_end(line: bytes) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        with path.open("wb") as file:
            for _ in range(200):
                file.write(line * (1_000_000 // len(line)))

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
        file.writelines(f"{n},{n},0,0,0,0,1\n" for n in range(1_000_000))
        file.write("x\n")


LARGE: dict[str, tuple[str, Callable[[Path], None]]] = {
    "manifest of lists": (MANIFEST, without_end(b"[],")),
    "manifest of brackets": (MANIFEST, without_end(b"[")),
    "index without lines": (INDEX, without_end(b"x")),
    "index of empty lines": (INDEX, without_end(b"\n")),
    "index of many frames": (INDEX, many_frames),
    "truth without lines": (TRUTH, without_end(b"1,")),
    "truth of many rows": (TRUTH, many_rows),
    "eyes without lines": (EYES, without_end(b"[")),
    **{f"{kind} as {name}": (name, put) for kind, put in NO_FILES.items() for name in (MANIFEST, INDEX, PACKETS, TRUTH)},
}


@pytest.mark.parametrize("name", sorted(LARGE))
def test_a_refusal_is_quick_small_and_names_the_file(whole: Path, tmp_path: Path, name: str) -> None:
    shutil.copytree(whole, tmp_path / "seq")
    file, put = LARGE[name]
    put(tmp_path / "seq" / file)
    code, _, err, peak_mb = lfpipe(tmp_path, "sequence", "check", tmp_path / "seq", timeout_s=20)
    assert code == 2 and err.startswith("error: ") and "Traceback" not in err and len(err) <= 2000, err[:3000]
    assert file in err or "frame" in err, err
    assert peak_mb <= hostile_files.PEAK_MB


def test_one_bad_sequence_of_several_hides_no_other(whole: Path, tmp_path: Path) -> None:
    for name in ("a", "b", "c"):
        shutil.copytree(whole, tmp_path / name)
    (tmp_path / "a" / MANIFEST).write_text("{")
    for command in ("info", "check"):
        paths = [tmp_path / name for name in ("a", "b", "gone", "c")]
        code, out, err, _ = lfpipe(tmp_path, "sequence", command, *paths)
        assert code == 2 and err.count("error: ") == 2 and f"{tmp_path / 'gone'}: no such folder" in err
        assert f"{tmp_path / 'b'}: 6 frames" in out and f"{tmp_path / 'c'}: 6 frames" in out
    code, out, _, _ = lfpipe(tmp_path, "sequence", "info", "--json", tmp_path / "b", tmp_path / "c")
    assert code == 0 and [json.loads(line)["frames"] for line in out.splitlines()] == [6, 6]


def modes(path: Path) -> dict[str, int]:
    """Of a file or folder and of all within, by name."""
    return {each.name: stat.S_IMODE(each.stat().st_mode) for each in (path, *path.rglob("*"))}


def test_what_shows_a_person_is_for_its_owner_alone(whole: Path, tmp_path: Path) -> None:
    umask = os.umask(0)
    try:
        sequence = open_sequence(whole)
        edit.cut(sequence, tmp_path / "cut", 0.0, 1.0)
        table = edit.export(sequence, tmp_path / "video.mkv")
        edit.from_video(tmp_path / "video.mkv", tmp_path / "back", whole / TRUTH)
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
    (tmp_path / "notes.mkv").write_text("no video")
    bad_truth = tmp_path / "truth.csv"
    bad_truth.write_text("t_ns,left_x_px,left_y_px,right_x_px,right_y_px\n0,nan,1,1,1\n")
    edit.export(open_sequence(whole), tmp_path / "good.mkv")
    before = sorted(path.name for path in tmp_path.iterdir())
    for args in (
        ("export", whole, tmp_path / "mine.mkv"),
        ("export", whole, tmp_path / "notes.mkv"),
        ("export", whole, tmp_path / "gone" / "v.mkv"),
        ("cut", whole, tmp_path / "folder"),
        ("cut", whole, tmp_path / "mine.csv"),
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
        found = CliRunner().invoke(cli, ["sequence", *map(str, args)]).exception
        assert isinstance(found, UserError) and found.remedy, (args, found)
        assert sorted(path.name for path in tmp_path.iterdir()) == before, args
    assert (tmp_path / "mine.csv").read_text() == "mine" and not list((tmp_path / "folder").iterdir())


@pytest.mark.parametrize("room", [0, 1000, 4000])
def test_a_full_disk_leaves_what_was_there(whole: Path, tmp_path: Path, room: int) -> None:
    edit.export(open_sequence(whole), tmp_path / "good.mkv")
    (tmp_path / "home").mkdir(mode=0o700)
    before = sorted(path.name for path in tmp_path.iterdir())
    full = {"preexec_fn": lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))}
    for args in (("cut", whole, "new"), ("import", "good.mkv", "new"), ("export", whole, "new.mkv")):
        code, out, err, _ = lfpipe(tmp_path, "sequence", *args, **full)
        assert code == 2 and "error: " in err and "Traceback" not in err, (args, out, err)
        assert sorted(path.name for path in tmp_path.iterdir()) == before, args


def test_a_cut_without_an_end_is_JSON_for_every_reader(whole: Path, tmp_path: Path) -> None:
    typed("sequence", "cut", "SEQ", "OUT")(whole, tmp_path / "cut")

    def refuse(word: str) -> None:
        raise AssertionError(word)

    manifest = json.loads((tmp_path / "cut" / MANIFEST).read_text(), parse_constant=refuse)
    assert manifest["cut_from"]["end_s"] == pytest.approx(5 / 30, abs=1e-3)
    assert len(open_sequence(tmp_path / "cut").packets) == 6


@pytest.mark.parametrize("name", [b"\xff\xfe", b"a\x1b[31mb", b"new\nline", "日本".encode()])
def test_a_name_of_any_bytes_is_a_name(whole: Path, tmp_path: Path, name: bytes) -> None:
    folder = tmp_path / os.fsdecode(name)
    shutil.copytree(whole, folder)
    for args in (("info", folder), ("check", folder), ("info", "--json", folder), ("cut", folder, tmp_path / "part")):
        code, out, err, _ = lfpipe(tmp_path, "sequence", *args, encoding="utf-8:strict")
        assert code == 0 and out and not err, (args, err)
    open_sequence(tmp_path / "part")
    code, _, err, _ = lfpipe(tmp_path, "sequence", "cut", folder, folder)
    assert code == 2 and "already exists" in err and "Traceback" not in err
    code, _, err, _ = lfpipe(tmp_path, "sequence", "export", folder, folder.with_suffix(".mkv"))
    assert code in (0, 2) and "Traceback" not in err, err


@pytest.mark.live
@pytest.mark.parametrize("name", ["jpeg of 20000x20000", "png cut off"])
def test_a_session_that_comes_to_a_broken_frame_names_it(whole: Path, tmp_path: Path, name: str) -> None:
    shutil.copytree(whole, tmp_path / "seq")
    replaced_packet(tmp_path / "seq", *bombs()[name])
    view = tmp_path / "scene" / "view_00_00.png"
    view.parent.mkdir()
    view.write_bytes(encoded(hostile_sequences.picture(0), fast=False)[1])
    shutil.copy(view, view.with_name("view_00_01.png"))
    for codes, args in (
        ((2,), ("replay", tmp_path / "seq", "--scene", view.parent)),
        ((1, 2), ("up", view.parent, "--camera", f"file:{tmp_path / 'seq'}?loop=0", "--display", "none")),  # tried again first
        ((1, 2), ("record", tmp_path / "rec", "--camera", f"file:{tmp_path / 'seq'}?loop=0")),
    ):
        code, _, err, peak_mb = lfpipe(tmp_path, *args)
        assert code in codes and "seq: frame 3: " in err and "Traceback" not in err, (args, err)
        assert peak_mb <= hostile_files.PEAK_MB, args


def test_a_link_out_of_the_folder_is_not_followed(whole: Path, tmp_path: Path) -> None:
    folder = tmp_path / "seq"
    for name in (MANIFEST, INDEX, PACKETS, TRUTH, EYES):
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(whole, folder)
        (folder / name).unlink()
        (folder / name).symlink_to(whole / name)
        with pytest.raises(UserError, match=f"{name}: a link to .*outside of the folder"):
            open_sequence(folder)
        shutil.copy(whole / name, folder / "kept")
        (folder / name).unlink()
        (folder / name).symlink_to("kept")
        open_sequence(folder)
    (tmp_path / "link").symlink_to(whole)
    open_sequence(tmp_path / "link")  # what a person names is followed
