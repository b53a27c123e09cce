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

from lfpipe.sequence.folder import Sequence, open_sequence
from lfpipe.sequence.packets import INDEX
from tests.support.world import World, runs

SMALL = ("--set", "camera.width_px=320", "--set", "camera.height_px=240")


def capture(world: World) -> Any:
    return world.monitor()["stages"]["capture"]


def frames(out: Path) -> int:
    """How many frames a recording has so far."""
    return (out / INDEX).read_text().count("\n") if (out / INDEX).exists() else 0


def test_a_live_session_is_recorded_without_a_hole(world: World, short: Path, blocks: Path) -> None:
    out = world.root / "rec"
    process = world.shows(
        blocks, *SMALL, camera=f"file:{short}?loop=1&pace=60", preexec_fn=lambda: os.umask(0)
    )

    assert json.loads(world.ctl("--json", "record", "start", out))["path"] == str(out)
    world.wait_for(lambda: capture(world)["metrics"]["recorded"] > 60, "recording")
    assert frames(out) > 60 and capture(world)["metrics"]["unrecorded"] == 0
    assert world.ask(cmd="record", path="")["ok"]
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
