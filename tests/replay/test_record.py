"""Recording: beside a live session, alone, cut off by SIGKILL; played again; JPEGs of a source go
to disk unchanged.
"""

import itertools
import json
import os
import signal
import stat
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import psutil
import pytest
from click.testing import CliRunner

from lfpipe.cli.sequence import record
from lfpipe.errors import UserError
from lfpipe.sequence.folder import Sequence, new_sequence, open_sequence
from lfpipe.sequence.packets import INDEX, encoded
from lfpipe.supervisor.session import Outcome
from tests.support.world import World, runs

SMALL = ("--set", "camera.width_px=320", "--set", "camera.height_px=240")


def capture(world: World) -> Any:
    return world.monitor()["stages"]["capture"]


def frames(out: Path) -> int:
    """How many frames a recording has so far."""
    return (out / INDEX).read_text().count("\n") if (out / INDEX).exists() else 0


@pytest.mark.everyday
def test_a_live_session_is_recorded_without_a_hole(world: World, short: Path, blocks: Path) -> None:
    out = world.root / "rec"
    process = world.shows(
        blocks, *SMALL, camera=f"file:{short}?loop=1&pace=60", preexec_fn=lambda: os.umask(0)
    )

    assert json.loads(world.ctl("--json", "record", "start", out))["path"] == str(out)
    world.wait_for(lambda: capture(world)["metrics"]["recorded"] > 60, "recording")
    assert frames(out) > 60 and capture(world)["metrics"]["unrecorded"] == 0
    world.ctl("record", "stop")
    world.wait_for(lambda: json.loads((out / "manifest.json").read_text())["complete"], "manifest")
    stopped = world.monitor()
    world.pictures(len(world.lines()) + 5)  # the session continues
    said = world.ended(process, signal.SIGINT)
    sequence = open_sequence(out)
    assert f"recorded {len(sequence.packets)} frames" in said
    source = open_sequence(short)
    seqs = [packet.source_seq for packet in sequence.packets]
    for packet in itertools.islice(sequence.packets, 10):
        assert np.array_equal(sequence.frame(packet.seq), source.frame(packet.source_seq % 60))
    stage = stopped["stages"]["capture"]
    let_go, missed = stage["dropped"], stage["metrics"]["unrecorded"]
    assert sequence.lost <= let_go + missed, (
        "every hole is counted, of the source as of the recorder"
    )
    assert missed <= 0.02 * len(seqs)
    assert {stat.S_IMODE(path.stat().st_mode) for path in out.iterdir()} == {
        0o600
    } and stat.S_IMODE(out.stat().st_mode) == 0o700


def test_record_that_ends_before_its_first_frame_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C while the camera starts left nothing, said nothing, and ended with 0."""
    monkeypatch.setattr(
        "lfpipe.cli.sequence.run_session",
        lambda *_: Outcome(reason="interrupted", signum=2),
    )
    words = [str(tmp_path / "walk"), "--camera", "demo"]
    ended = CliRunner().invoke(record, words, standalone_mode=False)
    assert ended.return_value == 1 and "walk: no frame was recorded" in ended.output


def test_a_recording_cut_off_by_sigkill_is_whole_to_its_last_frame(
    world: World, short: Path, blocks: Path
) -> None:
    out = world.root / "rec"
    process = world.start(
        "record", out, "--camera", f"file:{short}?loop=1&pace=60", *SMALL, start_new_session=True
    )
    world.wait_for(lambda: frames(out) > 20, "frames")
    stages = psutil.Process(process.pid).children(recursive=True)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait(60)
    world.wait_for(lambda: not any(runs(stage.pid) for stage in stages), "end of the stages")
    sequence = open_sequence(out)
    assert not sequence.complete and len(sequence.packets) > 20
    assert "cut off" in world.done("sequence", "check", out).stdout
    assert (
        f"replaying its {len(sequence.packets)} whole frames"
        in world.done("replay", out, "--scene", blocks).stderr
    )


def _same(sequence: Sequence, given: list[bytes]) -> bool:
    return all(
        sequence.data(p.seq) == given[p.source_seq % len(given)] and p.codec == "jpeg"
        for p in sequence.packets
    )


def test_jpegs_of_another_size_stay_and_replay_as_they_were_tracked(
    world: World, short: Path, blocks: Path
) -> None:
    folder, out = world.root / "jpegs", world.root / "rec"
    folder.mkdir()
    given = []
    for number, frame in ((k, open_sequence(short).frame(k)) for k in range(12)):
        big = cv2.resize(frame, (400, 300), interpolation=cv2.INTER_CUBIC)
        given.append(
            cv2.imencode(".jpg", big, [cv2.IMWRITE_JPEG_QUALITY, 85 + number % 10])[1].tobytes()
        )
        (folder / f"{number}.jpg").write_bytes(given[-1])
    world.done("record", out, "--camera", f"file:{folder}?loop=0&pace=30", *SMALL)
    recorded = open_sequence(out)
    assert (
        (recorded.width_px, recorded.height_px) == (400, 300)
        and len(recorded.packets) > 3
        and _same(recorded, given)
    )
    assert set(recorded.manifest["checksums"]) == {INDEX}
    runs = []
    for name in ("one", "two"):
        world.done("replay", out, "--scene", blocks, "--out", world.root / name)
        runs.append(json.loads((world.root / name / "report.json").read_text()))
    assert runs[0]["digests"] == runs[1]["digests"]
    assert runs[0]["config"]["camera"]["width_px"] == 320, (
        "the size that was tracked, not that of the JPEGs"
    )


def noisy(folder: Path, short: Path) -> Path:
    """A lossless film of a face with the noise of a webcam, 2 s of 640x480."""
    noise = np.random.default_rng(1)
    with new_sequence(folder, "made", (640, 480), 30.0) as writer:
        for packet in open_sequence(short).packets:
            big = cv2.resize(open_sequence(short).frame(packet.seq), (640, 480))
            frame = np.clip(big + noise.normal(0, 2, big.shape), 0, 255).astype(np.uint8)
            t_ns = packet.t_sensor_ns
            writer.append(encoded(frame), "png", packet.seq, 0, t_ns, t_ns)
    return folder


@pytest.mark.nightly
def test_ten_seconds_of_a_camera_without_jpegs_take_at_most_10_mb(
    world: World, short: Path, blocks: Path
) -> None:
    """They were stored without loss, as 30 to 170 MB."""
    film = noisy(world.root / "film", short)
    camera = ("--camera", f"file:{film}?loop=0&pace=30")
    world.done("record", world.root / "jpeg", *camera)
    jpeg = open_sequence(world.root / "jpeg")
    assert jpeg.codecs == {"jpeg"} and len(jpeg.packets) > 30
    assert sum(packet.bytes for packet in jpeg.packets) * 300 / len(jpeg.packets) < 10e6
    world.done("replay", world.root / "jpeg", "--scene", blocks, "--out", "out")
    report = json.loads((world.root / "out" / "report.json").read_text())
    assert report["counts"]["faces"] > 30


def test_a_live_session_is_recorded_several_times_each_whole(
    world: World, short: Path, blocks: Path
) -> None:
    given = [open_sequence(short).data(k) for k in range(60)]
    outs = [world.root / f"rec{number}" for number in range(3)]

    def begun(out: Path) -> bool:
        try:
            world.ask(cmd="record", path=str(out))
        except UserError:  # the one before is still being written
            return False
        return True

    world.shows(blocks, *SMALL, camera=f"file:{short}?loop=1&pace=60", pictures=3)
    for number, out in enumerate(outs):
        world.wait_for(lambda out=out: begun(out), "recording")
        world.wait_for(lambda out=out: frames(out) > 20, "frames")
        world.ask(cmd="record", path="")
        # the second one follows at once; before the third, so many frames pass without a recording
        if number:
            world.pictures(len(world.lines()) + 120)
    world.wait_for(lambda: all(open_sequence(out).complete for out in outs), "the end of all")
    sequences = [open_sequence(out) for out in outs]
    assert all(_same(sequence, given) for sequence in sequences)
    stage = capture(world)
    assert stage["restarts"] == 0
    assert stage["metrics"]["recorded"] == sum(len(sequence.packets) for sequence in sequences)
    assert stage["metrics"]["unrecorded"] < 30, "frames between two recordings are not missed"
